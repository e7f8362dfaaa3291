"""Poses in, sums of gradient images out: few images with their derivatives are there at a time, in the GPU's cache."""

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.drr import triton as drr
from regtorch.similarity import triton as similarity
from regtorch.similarity.gram import FixedGradients

_PIXELS_AT_ONCE = 1 << 24


def gram(
    data: Float[Tensor, "d h w"],
    rays: Float[Tensor, "b 12"],
    ray_jacobian: Float[Tensor, "b 12 p"] | None,
    grid: Float[Tensor, "2 3"],
    fixed: FixedGradients,
    method: str,
) -> tuple[Float[Tensor, "b 2 m m+2"], Float[Tensor, " b"]]:
    """``similarity.gram.gradient_gram`` of DRRs and, unless None, of their derivatives."""
    place = grid, *fixed.root.shape, method
    if ray_jacobian is None:
        return similarity.gradient_gram(drr.project(data, rays, *place)[:, 0], *fixed)
    at_once = max(1, _PIXELS_AT_ONCE // ((1 + ray_jacobian.shape[2]) * fixed.root.numel()))
    found = []
    for some in zip(rays.split(at_once), ray_jacobian.split(at_once), strict=True):
        found.append(similarity.gradient_grams(drr.project_as_one(data, *some, *place)[:, 0], *fixed))
    grams, magnitudes = zip(*found, strict=True)
    return torch.cat(grams), torch.cat(magnitudes)
