"""Effects of the detector's electronics: gain, offset, and digital counts of limited range."""

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
    """Line integrals of the signal gain I + offset, as of an imperfectly calibrated detector.

    Raises ``RegtorchError`` unless ``gain`` is positive and neither ``offset`` nor ``gain_rms`` is negative.

    Args:
        line_integrals: The image.
        gain: Mean gain of the detector.
        offset: Dark signal, as a share of the open beam.
        gain_rms: Relative deviation of the pixels' gain from the mean.
        generator: Source of random numbers.
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
    """Counts of ``bits`` bits, linear in the intensity, and the line integrals read from them.

    An intensity of ``full_scale`` (share of the open beam) or more gives the highest count, 2^bits - 1, as in
    overexposed air. A count of 0 is read as 0.5. I0 stays that of the open beam: p = -log(full_scale count / highest).
    Raises ``RegtorchError`` unless ``bits`` is 1 to 16 and ``full_scale`` is positive.
    """
    if not 1 <= bits <= 16:
        raise RegtorchError(f"{bits} bits: expected 1 to 16")
    if not 0 < full_scale < math.inf:
        raise RegtorchError(f"full scale of {full_scale:g} of the open beam: expected a positive share")
    highest = 2**bits - 1
    counts = (torch.exp(-line_integrals.double()) * (highest / full_scale)).round().clamp(0, highest)
    read = math.log(highest / full_scale) - counts.clamp(min=0.5).log()
    return counts.int(), read.to(line_integrals)
