"""Quantum noise of a radiograph."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.errors import RegtorchError


def add_quantum_noise(
    line_integrals: Float[Tensor, "*b h w"], photons: float, generator: torch.Generator
) -> Float[Tensor, "*b h w"]:
    """Replace line integrals L by log(photons / n), where n is a Poisson count with mean ``photons`` exp(-L).

    A count of 0 is taken as 1. Raises ``RegtorchError`` unless ``photons``, per pixel of the open beam, is at least 1
    and finite.
    """
    if not 1 <= photons < math.inf:
        raise RegtorchError(f"{photons:g} photons per pixel: expected at least 1")
    counts = torch.poisson(photons * torch.exp(-line_integrals.double()), generator=generator)
    return (math.log(photons) - counts.clamp(min=1).log()).to(line_integrals)
