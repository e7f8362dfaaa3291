"""What a study found, as one HTML file; drawn from its tables alone, without torch."""

from experiments.common.report.page import report

__all__ = ["report"]
