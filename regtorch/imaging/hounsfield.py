"""HU to linear attenuation, and the boxes that enclose the attenuating voxels."""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.errors import RegtorchError
from regtorch.imaging.volume import Volume

AIR_HU = -1000.0

BODY_HU = -300.0
"""Separates the patient (denser) from air; fat has about -100 HU."""

BONE_HU = 100.0
"""The paper's threshold T; soft tissue has less than 80 HU, bone more than 150."""

MU_WATER_PER_MM = 0.02
"""Attenuation of water at about 60 keV, the mean energy of a usual beam."""


def attenuation(
    volume: Volume, *, threshold_hu: float | None = BONE_HU, mu_water_per_mm: float = MU_WATER_PER_MM
) -> Volume:
    """Convert HU to mu = mu_water (1 + HU/1000) per mm.

    Values at or below -1000 HU become 0, because scanners pad with as little as -3024. Values below ``threshold_hu``
    become 0 too: by default only bone remains, as in the paper. None keeps all tissue. Raises ``RegtorchError`` if the
    volume is not in HU, if ``mu_water_per_mm`` is not positive, or if nothing attenuates.
    """
    if volume.unit != "HU":
        raise RegtorchError(f"{volume.name}: values in {volume.unit}, expected HU")
    if not mu_water_per_mm > 0:
        raise RegtorchError(f"mu_water of {mu_water_per_mm} per mm: expected a positive number")
    data = volume.data.mul(mu_water_per_mm / -AIR_HU).add_(mu_water_per_mm).clamp_(min=0)
    if threshold_hu is not None:
        data.masked_fill_(volume.data < threshold_hu, 0)
    if float(data.amax()) == 0:
        raise _nothing_attenuates(volume, threshold_hu)
    return volume.with_data(data, unit="per_mm")


def bone_contrast(bone: Volume, *, threshold_hu: float | None = BONE_HU) -> Volume:
    """Contrast of bone: its ``attenuation`` minus the attenuation of tissue at the threshold.

    Bone in a body displaces soft tissue, so a radiograph shows only the difference. Nothing is subtracted without a
    threshold or with the threshold of air.
    """
    soft = 0.0 if threshold_hu is None else max(0.0, MU_WATER_PER_MM * (1 - threshold_hu / AIR_HU))
    return bone.with_data(bone.data.sub(soft).clamp_(min=0)) if soft > 0 else bone


def crop_to_anatomy(volume: Volume, *, threshold_hu: float | None = BONE_HU) -> Volume:
    """Crop a CT in HU to the voxels that attenuate above the threshold, with a margin of one voxel.

    The origin of the ``ct`` frame stays. The result is a view of the CT's own voxels. Raises ``RegtorchError`` if the
    volume is not in HU or nothing attenuates.
    """
    if volume.unit != "HU":
        raise RegtorchError(f"{volume.name}: values in {volume.unit}, expected HU")
    least = -torch.inf if threshold_hu is None else threshold_hu
    if not (box := _box(volume, lambda hu: (hu > AIR_HU) & (hu >= least))):
        raise _nothing_attenuates(volume, threshold_hu)
    around = [(max(0, low - 1), min(n, high + 2)) for (low, high), n in zip(box, volume.data.shape, strict=True)]
    (k0, k1), (j0, j1), (i0, i1) = around
    first = torch.tensor([i0, j0, k0, 1], dtype=torch.float64)
    patient_from_voxel = volume.patient_from_voxel.clone()
    patient_from_voxel[:, 3] = volume.patient_from_voxel @ first
    return volume.on_grid(volume.data[k0:k1, j0:j1, i0:i1], patient_from_voxel)


def corners_ct(ct: Volume, above_hu: float) -> Float[Tensor, "8 3"]:
    """Corners, in the ``ct`` frame (mm), of the box around all voxels above a threshold.

    If no voxel is above it, the corners are those of the whole CT.
    """
    box = _box(ct, lambda hu: hu > above_hu) or [(0, n - 1) for n in ct.data.shape]
    corners = torch.cartesian_prod(*(torch.tensor(ends, dtype=torch.float64) for ends in reversed(box)))
    in_patient = corners @ ct.patient_from_voxel[:3, :3].mT + ct.patient_from_voxel[:3, 3]
    return in_patient - ct.origin_patient_mm


def _box(ct: Volume, inside: Callable[[Tensor], Tensor]) -> list[tuple[int, int]]:
    """First and last index along k, j and i of the voxels ``inside``; an empty list if there are none.

    ``inside`` takes HU. If it holds for one value, it must hold for every denser one.
    """
    across = ct.data.amax(0)
    highest = ct.data.flatten(1).amax(1), across.amax(1), across.amax(0)
    found = [inside(line).nonzero().flatten() for line in highest]
    return [(int(places[0]), int(places[-1])) for places in found] if len(found[0]) else []


def _nothing_attenuates(volume: Volume, threshold_hu: float | None) -> RegtorchError:
    limit = AIR_HU if threshold_hu is None else max(threshold_hu, AIR_HU)
    return RegtorchError(
        f"{volume.name}: no voxel over {limit:g} HU (the highest has {float(volume.data.max()):g} HU), "
        "expected a CT in HU with bone in it"
    )
