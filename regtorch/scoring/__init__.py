"""Projection and similarity in one: poses in, gradient correlation and its normal equations out."""

from regtorch.scoring.score import gradient_correlations, normal_equations

__all__ = ["gradient_correlations", "normal_equations"]
