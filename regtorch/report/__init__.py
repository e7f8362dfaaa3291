"""What a study found, as one HTML file; drawn from its tables alone, without torch."""

from regtorch.report.page import report

__all__ = ["report"]
