"""Exact area averaging onto a coarser grid, one axis at a time: both pyramids are made by it."""

import math
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.errors import RegtorchError
from regtorch.imaging.hounsfield import AIR_HU
from regtorch.imaging.volume import Volume


def overlaps(old: int, new: int, ratio: float) -> Float[Tensor, "new old"]:
    """How much of each new cell each old cell fills, for ``new`` cells of ``ratio`` old ones about the same centre.

    Rows sum to 1 where the old grid reaches, to less at a border where it does not.
    """
    edges = (torch.arange(new + 1, dtype=torch.float64) - new / 2) * ratio + old / 2
    cells = torch.arange(old, dtype=torch.float64)
    shared = torch.minimum(edges[1:, None], cells + 1) - torch.maximum(edges[:-1, None], cells)
    return shared.clamp(min=0) / ratio


def coarsen(volume: Volume, spacing_mm: float, *, least_ratio: float = 1.0) -> Volume:
    """Averages onto voxels of ``spacing_mm`` along each axis that is finer, about the same centre; linear along these.

    An axis whose voxels would not become more than ``least_ratio`` times as large stays as it is.

    The count is rounded up, with air around the volume, so that its mass is kept and nothing at its border is lost.
    """
    if not 0 < spacing_mm < math.inf:
        raise RegtorchError(f"voxels of {spacing_mm} mm: expected a positive size")
    data = volume.data if volume.unit == "per_mm" else volume.data - AIR_HU
    voxel_from_coarse = torch.eye(4, dtype=torch.float64)
    # Slices first: that pass is a plain weighted sum and leaves least for the two matrix products.
    for axis, old_mm in zip((-3, -2, -1), volume.spacing_mm.flip(0).tolist(), strict=True):
        ratio, old = spacing_mm / old_mm, data.shape[axis]
        if ratio <= least_ratio + 1e-9:
            continue
        new = math.ceil(old / ratio - 1e-9)
        data = _average(data, axis, overlaps(old, new, ratio).to(data))
        voxel_from_coarse[-1 - axis, -1 - axis] = ratio
        voxel_from_coarse[-1 - axis, 3] = (old - 1) / 2 - ratio * (new - 1) / 2
    if volume.unit == "HU":
        data = data + AIR_HU
    coarse = volume.on_grid(data, volume.patient_from_voxel @ voxel_from_coarse)
    ratios = voxel_from_coarse.diagonal()[:3].tolist()
    sharpness = tuple(1.0 if ratio > 1 else s for ratio, s in zip(ratios, volume.sharpness, strict=True))
    return replace(coarse, sharpness=sharpness)


def _average(data: Float[Tensor, "*c d h w"], axis: int, weights: Float[Tensor, "new old"]) -> Float[Tensor, "..."]:
    if axis == -2:
        return weights @ data
    if axis == -1:
        return data @ weights.mT
    slices = []
    for row in weights:
        used = row.nonzero().flatten()
        first, last = int(used[0]), int(used[-1]) + 1
        slices.append(torch.einsum("k,...khw->...hw", row[first:last], data[..., first:last, :, :]))
    return torch.stack(slices, dim=-3)
