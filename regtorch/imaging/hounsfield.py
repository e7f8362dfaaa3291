"""HU to linear attenuation, and the boxes of attenuating voxels."""

from collections.abc import Callable

import torch
from jaxtyping import Float
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
    if float(data.amax()) == 0:
        raise _nothing_attenuates(volume, threshold_hu)
    return volume.with_data(data, unit="per_mm")


def bone_contrast(bone: Volume, *, threshold_hu: float | None = BONE_HU) -> Volume:
    """Bone as ``attenuation`` leaves it above a threshold, less the attenuation of tissue just at the threshold: bone's
    contrast.

    Bones in a body displace soft tissue, and a radiograph shows them by the difference. Without a threshold, or with
    one of air, nothing is taken off.
    """
    soft = 0.0 if threshold_hu is None else max(0.0, MU_WATER_PER_MM * (1 - threshold_hu / AIR_HU))
    return bone.with_data(bone.data.sub(soft).clamp_(min=0)) if soft > 0 else bone


def crop_to_anatomy(volume: Volume, *, threshold_hu: float | None = BONE_HU) -> Volume:
    """The box of the voxels that ``attenuation`` leaves of a CT in HU, and one voxel around it; the ``ct`` origin
    stays.

    A view of the CT's own voxels.
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
    """Corners, in the ``ct`` frame (mm), of the box around all voxels over a threshold; of the CT if none is."""
    box = _box(ct, lambda hu: hu > above_hu) or [(0, n - 1) for n in ct.data.shape]
    corners = torch.cartesian_prod(*(torch.tensor(ends, dtype=torch.float64) for ends in reversed(box)))
    in_patient = corners @ ct.patient_from_voxel[:3, :3].mT + ct.patient_from_voxel[:3, 3]
    return in_patient - ct.origin_patient_mm


def _box(ct: Volume, inside: Callable[[Tensor], Tensor]) -> list[tuple[int, int]]:
    """First and last index along k, j and i of the voxels that are ``inside`` by their HU, as all denser ones are;
    nothing if none."""
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
