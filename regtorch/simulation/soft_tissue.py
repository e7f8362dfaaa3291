"""Soft tissue that breathing and posture moved since the CT, about bones that stayed where they were."""

import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn.functional import avg_pool3d, grid_sample, interpolate

from regtorch.errors import RegtorchError
from regtorch.imaging import Volume

_WAVES = 48
_NODES_PER_WAVE = 12
"""Nodes of the field's grid per wavelength: between them it is interpolated to 3 % at worst."""
_TISSUE_HU = -300.0
"""Denser voxels outside bone are soft tissue; the rest is lung and air."""
_SLAB = 16


def move_soft_tissue(
    ct: Volume,
    *,
    rms_mm: float = 8.0,
    wavelength_mm: float = 120.0,
    bone_hu: float = 150.0,
    rim_mm: float = 2.0,
    generator: torch.Generator,
) -> Volume:
    """The CT (HU) with all but its bones warped by a smooth random field of ``rms_mm`` RMS length over the body.

    The field is a sum of plane waves, each ``wavelength_mm`` to twice that long. Bone is everything over ``bone_hu``,
    with holes up to ``rim_mm`` closed: it keeps its values exactly, and so does soft tissue within ``rim_mm`` of it.
    Before the warp the soft tissue around it is continued into where it is, so that none of the bone moves along.
    """
    if ct.unit != "HU" or ct.data.ndim != 3:
        raise RegtorchError(f"{ct.name}: expected one volume in HU")
    if not (0 <= rms_mm < math.inf and 0 < wavelength_mm < math.inf and 0 <= rim_mm < math.inf):
        raise RegtorchError(
            f"soft tissue moved {rms_mm:g} mm at a wavelength of {wavelength_mm:g} mm, {rim_mm:g} mm off the bones: "
            "expected a positive wavelength and neither of the others below 0"
        )
    field = _displacement(ct, rms_mm, wavelength_mm, generator)
    radii = [round(rim_mm / mm) for mm in ct.spacing_mm.flip(0).tolist()]
    grown = _dilated(ct.data > bone_hu, radii)
    bone = ~_dilated(~grown, radii)
    around = ~_dilated(~_dilated(grown, radii), radii)
    moved = _warp(_fill(ct.data, around, ct.name), field)
    # The lung beside a rib is not kept: between the rib and the chest wall that moved it would be a slit of air.
    kept = around.logical_and_(ct.data > _TISSUE_HU).logical_or_(bone)
    return ct.with_data(torch.where(kept, ct.data, moved))


def _displacement(
    ct: Volume, rms_mm: float, wavelength_mm: float, generator: torch.Generator
) -> Float[Tensor, "3 kc jc ic"]:
    """Displacements (i, j, k) in voxels on a coarse grid whose first and last nodes are the volume's corners."""
    direction, amplitude = torch.randn(2, _WAVES, 3, generator=generator, dtype=torch.float64)
    uniform, phase = torch.rand(2, _WAVES, generator=generator, dtype=torch.float64)
    per_mm = 2 * math.pi / (wavelength_mm * (1 + uniform))
    waves = direction / direction.norm(dim=1, keepdim=True) * per_mm[:, None]
    spacing = ct.spacing_mm.flip(0).tolist()
    step = wavelength_mm / _NODES_PER_WAVE
    axes = [
        torch.linspace(0, n - 1, max(2, math.ceil((n - 1) * mm / step) + 1), dtype=torch.float64)
        for n, mm in zip(ct.data.shape, spacing, strict=True)
    ]
    k, j, i = torch.meshgrid(*axes, indexing="ij")
    centred = torch.stack([i, j, k], -1) @ ct.patient_from_voxel[:3, :3].mT
    centred += ct.patient_from_voxel[:3, 3] - ct.origin_patient_mm
    moved = torch.cos(centred @ waves.mT + 2 * math.pi * phase) @ amplitude
    body = ct.data[k.round().long(), j.round().long(), i.round().long()] > _TISSUE_HU
    body = body.cpu()
    squared = moved.square().sum(-1)
    rms = (squared[body] if bool(body.any()) else squared).mean().sqrt()
    in_voxels = moved * (rms_mm / rms) @ torch.linalg.inv(ct.patient_from_voxel[:3, :3]).mT
    return in_voxels.movedim(-1, 0).to(ct.data)


def _dilated(mask: Bool[Tensor, "d h w"], radii: list[int]) -> Bool[Tensor, "d h w"]:
    """By a box of ``radii`` voxels to either side; nothing comes in over the border."""
    for axis, radius in enumerate(radii):
        grown, size = mask.clone(), mask.shape[axis]
        for shift in range(1, min(radius, size - 1) + 1):
            grown.narrow(axis, shift, size - shift).logical_or_(mask.narrow(axis, 0, size - shift))
            grown.narrow(axis, 0, size - shift).logical_or_(mask.narrow(axis, shift, size - shift))
        mask = grown
    return mask


def _fill(data: Float[Tensor, "d h w"], bone: Bool[Tensor, "d h w"], name: str) -> Float[Tensor, "d h w"]:
    """Soft tissue in the place of bone: its average over the smallest block, 2^n voxels wide, that holds any.

    Lung is not continued: next to a rib that stays, the tissue that comes from within it leaves no gap.
    """
    known = (data > _TISSUE_HU) & ~bone
    if not bool(known.any()):
        raise RegtorchError(f"{name}: bone and air only, expected soft tissue to move")
    levels = [(data * known, known.to(data))]
    while not bool((levels[-1][1] > 0).all()):
        block = [min(2, n) for n in levels[-1][0].shape]
        levels.append(tuple(avg_pool3d(x[None], block, ceil_mode=True)[0] for x in levels[-1]))
    total, weight = levels.pop()
    filled = total / weight
    for total, weight in reversed(levels):
        finer = interpolate(filled[None, None], size=total.shape, mode="trilinear", align_corners=False)[0, 0]
        filled = torch.where(weight > 0, total / weight.clamp(min=1e-12), finer)
    return torch.where(bone, filled, data)


def _warp(data: Float[Tensor, "d h w"], field: Float[Tensor, "3 kc jc ic"]) -> Float[Tensor, "d h w"]:
    """data(x + field(x)), slab by slab; beyond its border the volume goes on as it ends."""
    shape = data.shape
    size = data.new_tensor(shape[::-1])
    planes = interpolate(field, size=shape[1:], mode="bilinear", align_corners=True)
    at = torch.linspace(0, field.shape[1] - 1, shape[0], dtype=torch.float64).to(data.device)
    below = at.long().clamp(max=field.shape[1] - 2)
    above = (at - below).to(data)
    j, i = torch.meshgrid(*(torch.arange(n).to(data) for n in shape[1:]), indexing="ij")
    moved = torch.empty_like(data)
    for first in range(0, shape[0], _SLAB):
        slab = slice(first, min(first + _SLAB, shape[0]))
        k = torch.arange(slab.start, slab.stop).to(data)[:, None, None]
        shift = torch.lerp(planes[:, below[slab]], planes[:, below[slab] + 1], above[slab][:, None, None])
        place = torch.stack([i + shift[0], j + shift[1], k + shift[2]], -1)
        grid = (2 * place + 1) / size - 1
        moved[slab] = grid_sample(data[None, None], grid[None], padding_mode="border", align_corners=False)[0, 0]
    return moved
