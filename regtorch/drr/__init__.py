"""Digitally reconstructed radiographs: ``render`` and the projectors behind it."""

from regtorch.drr.rendering import render, render_with_jacobian

__all__ = ["render", "render_with_jacobian"]
