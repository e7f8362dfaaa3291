"""Digitally reconstructed radiographs (DRRs): ``render`` and its projectors."""

from regtorch.drr.rendering import render, render_with_jacobian

__all__ = ["render", "render_with_jacobian"]
