"""Digitally reconstructed radiographs: ``render`` and the projectors behind it."""

from regtorch.drr.render import render

__all__ = ["render"]
