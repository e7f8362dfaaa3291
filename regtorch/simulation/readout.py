"""The detector's electronics: gain, offset, and a count of limited range."""

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor

from regtorch.errors import RegtorchError


def add_gain_and_offset(
    line_integrals: Float[Tensor, "*b h w"],
    *,
    gain: float = 1.0,
    offset: float = 0.0,
    gain_rms: float = 0.005,
    generator: torch.Generator,
) -> Float[Tensor, "*b h w"]:
    """Line integrals of a signal gain I + offset: the rest of both in a badly calibrated detector.

    ``gain`` is that of the whole detector, about which pixels scatter by the share ``gain_rms``; ``offset`` is a dark
    signal, as a share of the open beam.
    """
    if not (0 < gain < math.inf and 0 <= offset < math.inf and 0 <= gain_rms < math.inf):
        raise RegtorchError(
            f"gain {gain:g}, offset {offset:g}, scatter of the gain {gain_rms:g}: "
            "expected a positive gain and neither of the others below 0"
        )
    scatter = torch.randn(line_integrals.shape[-2:], generator=generator, dtype=torch.float64)
    pixels = gain * (1 + gain_rms * scatter).clamp(min=0.01)
    signal = pixels.to(line_integrals.device) * torch.exp(-line_integrals.double()) + offset
    return -signal.clamp(min=torch.finfo(torch.float64).tiny).log().to(line_integrals)


def digitise(
    line_integrals: Float[Tensor, "*b h w"], *, bits: int = 12, full_scale: float = 1.0
) -> tuple[Int[Tensor, "*b h w"], Float[Tensor, "*b h w"]]:
    """Counts of ``bits`` bits, linear in the intensity, and the line integrals that one reads off them.

    An intensity of ``full_scale`` (of the open beam) or more gives the highest count, 2^bits - 1, as overexposed air
    does; a count of 0 is read as half a one. Both stay on I0 of the open beam: p = -log(full_scale count / highest).
    """
    if not 1 <= bits <= 16:
        raise RegtorchError(f"{bits} bits: expected 1 to 16")
    if not 0 < full_scale < math.inf:
        raise RegtorchError(f"full scale of {full_scale:g} of the open beam: expected a positive share")
    highest = 2**bits - 1
    counts = (torch.exp(-line_integrals.double()) * (highest / full_scale)).round().clamp(0, highest)
    read = math.log(highest / full_scale) - counts.clamp(min=0.5).log()
    return counts.int(), read.to(line_integrals)
