"""Robust weights: pixels of a radiograph that a DRR does not explain count less."""

import torch
from jaxtyping import Float
from kornia.filters import gaussian_blur2d
from torch import Tensor

from regtorch.similarity.gradients import gradient_weight, image_gradients

_NOTHING = 1e-6
"""Share of the energy that is rounding and no residual."""


def explained_weight(
    moving: Float[Tensor, "h w"],
    fixed: Float[Tensor, "h w"],
    weight: Float[Tensor, "h w"],
    *,
    width_px: float = 1.5,
    floor: float = 0.03,
) -> Float[Tensor, "h w"]:
    """Robust weights: ``weight`` times floor / (floor + e), with the relative residual energy e about each pixel.

    The moving image's gradients are fitted to the fixed image's by least squares. The squared residuals, averaged about
    each pixel and divided by their mean over the image, are e. They estimate the variance of gradients that no pose
    explains: wires, letters, moved organs, few photons. Weights by inverse variance are one step of iteratively
    reweighted least squares. Equal residuals leave the weights in proportion.

    Args:
        moving: DRR of the pose.
        fixed: fixed image.
        weight: present weights of the pixels.
        width_px: standard deviation of the Gaussian that averages residuals, in pixels.
        floor: a smaller floor makes weights fall faster with the residual.
    """
    tiny = torch.finfo(weight.dtype).tiny
    counts = gradient_weight(weight)  # excludes gradients at the edge of a mask
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
