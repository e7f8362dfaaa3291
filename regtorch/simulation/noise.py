"""Quantum noise."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.errors import RegtorchError


def add_quantum_noise(
    line_integrals: Float[Tensor, "*b h w"], photons: float, generator: torch.Generator
) -> Float[Tensor, "*b h w"]:
    """Line integrals as counted: Poisson of ``photons`` exp(-L) per pixel, logarithm taken; no count stands for one."""
    if not 1 <= photons < math.inf:
        raise RegtorchError(f"{photons:g} photons per pixel: expected at least 1")
    counts = torch.poisson(photons * torch.exp(-line_integrals.double()), generator=generator)
    return (math.log(photons) - counts.clamp(min=1).log()).to(line_integrals)
