"""The results of a study as one HTML file, drawn from its tables alone; needs no torch."""

from experiments.common.report.page import report

__all__ = ["report"]
