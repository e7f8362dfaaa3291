"""Which pixels of a radiograph a DRR explains, and how little the others should count."""

import torch
from jaxtyping import Float
from kornia.filters import gaussian_blur2d
from torch import Tensor

from regtorch.similarity.gradients import gradient_weight, image_gradients

_NOTHING = 1e-6
"""Share of the energy that counts as no residual: rounding."""


def explained_weight(
    moving: Float[Tensor, "h w"],
    fixed: Float[Tensor, "h w"],
    weight: Float[Tensor, "h w"],
    *,
    width_px: float = 1.5,
    floor: float = 0.03,
) -> Float[Tensor, "h w"]:
    """``weight`` times floor / (floor + e), e the residual of the gradients' energy about a pixel over its mean.

    The moving image's gradients are fitted to the fixed image's by least squares. Their residual is squared and
    averaged over ``width_px`` (standard deviation). It is the variance that a pixel's gradients have for a reason that
    no pose can mend: a wire, a letter, an organ that has moved, few photons. Weighing by its inverse is one step of
    iteratively reweighted least squares; where all is explained alike, all counts alike.
    """
    tiny = torch.finfo(weight.dtype).tiny
    counts = gradient_weight(weight)  # beside a mask gradients are those of its edge
    total = counts.sum().clamp_min(tiny)
    energy, whole = torch.zeros_like(fixed), 0
    for m, f in zip(image_gradients(moving[None]), image_gradients(fixed[None]), strict=True):
        m, f = (g[0] - (g[0] * counts).sum() / total for g in (m, f))
        gain = (m * f * counts).sum() / (m.square() * counts).sum().clamp_min(tiny)
        energy += (f - gain * m).square() * counts
        whole = whole + (f.square() * counts).sum() / total
    size = 2 * int(3 * width_px) + 1
    mean = torch.maximum(energy.sum() / total, _NOTHING * whole).clamp_min(tiny)
    both = torch.stack([energy, counts])[:, None]
    energy, nearby = gaussian_blur2d(both, (size, size), (width_px, width_px), "replicate")[:, 0]
    return weight * floor / (floor + energy / nearby.clamp_min(1e-6) / mean)
