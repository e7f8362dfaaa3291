"""HU to linear attenuation, and the boxes of what attenuates."""

from dataclasses import replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from regtorch.errors import RegtorchError
from regtorch.imaging.volume import Volume

AIR_HU = -1000.0

BODY_HU = -300.0
"""The patient lies above, air below; fat has about -100."""

BONE_HU = 100.0
"""The paper's threshold T: soft tissue lies below 80 HU, bone above 150."""

MU_WATER_PER_MM = 0.02
"""Of water at about 60 keV, a usual beam's mean energy."""


def attenuation(
    volume: Volume, *, threshold_hu: float | None = BONE_HU, mu_water_per_mm: float = MU_WATER_PER_MM
) -> Volume:
    """mu = mu_water (1 + HU/1000) per mm, 0 from -1000 HU down (scanners pad with -3024) and below ``threshold_hu``.

    ``threshold_hu`` leaves bone by default, as the paper does; None keeps everything.
    """
    if volume.unit != "HU":
        raise RegtorchError(f"{volume.name}: values in {volume.unit}, expected HU")
    if not mu_water_per_mm > 0:
        raise RegtorchError(f"mu_water of {mu_water_per_mm} per mm: expected a positive number")
    data = volume.data.mul(mu_water_per_mm / -AIR_HU).add_(mu_water_per_mm).clamp_(min=0)
    if threshold_hu is not None:
        data.masked_fill_(volume.data < threshold_hu, 0)
    if not bool(data.any()):
        limit = AIR_HU if threshold_hu is None else max(threshold_hu, AIR_HU)
        raise RegtorchError(
            f"{volume.name}: no voxel over {limit:g} HU (the highest has {float(volume.data.max()):g} HU), "
            "expected a CT in HU with bone in it"
        )
    return volume.with_data(data, unit="per_mm")


def tissue_classes(
    volume: Volume, *, limits_hu: tuple[float, ...] = (BONE_HU,), mu_water_per_mm: float = MU_WATER_PER_MM
) -> Volume:
    """``attenuation`` of all tissue, split into classes [c, d, h, w] at limits in HU: soft tissue and bone by default.

    The classes sum to the whole; a voxel of exactly a limit belongs to the denser class.
    """
    whole = attenuation(volume, threshold_hu=None, mu_water_per_mm=mu_water_per_mm)
    limits = volume.data.new_tensor(sorted(limits_hu))
    number = torch.bucketize(volume.data, limits, right=True)
    classes = torch.stack([torch.where(number == c, whole.data, 0) for c in range(len(limits) + 1)])
    return replace(whole, data=classes)


def crop_to_anatomy(volume: Volume) -> Volume:
    """The box of all voxels that attenuate and one voxel around it where there is one; the ``ct`` origin stays."""
    if volume.unit != "per_mm":
        raise RegtorchError(f"{volume.name}: values in {volume.unit}, expected an attenuation per mm")
    nonzero = (volume.data != 0).reshape(-1, *volume.data.shape[-3:]).any(0)
    if not (box := _box(nonzero)):
        raise RegtorchError(f"{volume.name}: nothing attenuates, expected some anatomy")
    around = [(max(0, low - 1), min(n, high + 2)) for (low, high), n in zip(box, nonzero.shape, strict=True)]
    (k0, k1), (j0, j1), (i0, i1) = around
    first = torch.tensor([i0, j0, k0, 1], dtype=torch.float64)
    patient_from_voxel = volume.patient_from_voxel.clone()
    patient_from_voxel[:, 3] = volume.patient_from_voxel @ first
    return volume.on_grid(volume.data[..., k0:k1, j0:j1, i0:i1].contiguous(), patient_from_voxel)


def corners_ct(ct: Volume, above_hu: float) -> Float[Tensor, "8 3"]:
    """Corners, in the ``ct`` frame (mm), of the box around all voxels over a threshold; of the CT if none is."""
    box = _box(ct.data > above_hu) or [(0, n - 1) for n in ct.data.shape]
    corners = torch.cartesian_prod(*(torch.tensor(ends, dtype=torch.float64) for ends in reversed(box)))
    in_patient = corners @ ct.patient_from_voxel[:3, :3].mT + ct.patient_from_voxel[:3, 3]
    return in_patient - ct.origin_patient_mm


def _box(voxels: Bool[Tensor, "d h w"]) -> list[tuple[int, int]]:
    """First and last index along k, j and i of the voxels that are true; nothing if none is."""
    if not bool(voxels.any()):
        return []
    along = (voxels.any(2).any(1), voxels.any(2).any(0), voxels.any(1).any(0))
    return [(int(found[0]), int(found[-1])) for found in (line.nonzero().flatten() for line in along)]
