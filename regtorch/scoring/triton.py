"""Poses in, sums of gradient images out: a bounded number of images and derivatives is there at a time."""

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.drr import triton as drr
from regtorch.similarity import triton as similarity
from regtorch.similarity.gram import FixedGradients

_PIXELS_AT_ONCE = 1 << 26


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
    images = 1 if ray_jacobian is None else 1 + ray_jacobian.shape[2]
    at_once = max(1, _PIXELS_AT_ONCE // max(1, images * fixed.root.numel()))
    found = []
    for first in range(0, max(1, len(rays)), at_once):
        some = rays[first : first + at_once]
        if ray_jacobian is None:
            found.append(similarity.gradient_gram(drr.project(data, some, *place)[:, 0], *fixed))
        else:
            both = drr.project_as_one(data, some, ray_jacobian[first : first + at_once], *place)
            found.append(similarity.gradient_grams(both[:, 0], *fixed))
    grams, magnitudes = zip(*found, strict=True)
    return torch.cat(grams), torch.cat(magnitudes)
