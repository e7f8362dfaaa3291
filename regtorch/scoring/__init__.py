"""Projection and similarity in one pass: gradient correlation of poses, and its normal equations."""

from regtorch.scoring.score import gradient_correlations, normal_equations

__all__ = ["gradient_correlations", "normal_equations"]
