"""The CT: a grid of values and its position in the patient."""

from dataclasses import dataclass, replace
from typing import Literal

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from regtorch.errors import RegtorchError


@dataclass(frozen=True)
class Volume:
    """Voxel values and their position in the patient.

    Args:
        data: Values [k, j, i], or [c, k, j, i] for c classes of tissue.
        patient_from_voxel: Maps (i, j, k, 1) to LPS mm (float64, CPU); its axes are orthogonal.
        origin_patient_mm: Origin of the ``ct`` frame, the centre of the CT in its file (LPS mm). Cropping and
            coarsening keep it, so the nine parameters keep their meaning.
        unit: ``"HU"`` or, after ``attenuation``, ``"per_mm"``.
        name: Name of the CT in messages.
        slice_thickness_mm: Slice thickness from a DICOM series; it may be smaller than the distance of the slices.
        sharpness: Interpolation along i, j, k. With 1, values change linearly from voxel centre to voxel centre. With
            s, they change linearly over the middle 1/s of that distance, and voxels are constant elsewhere.
        warnings: Faults found while reading, one line each.
    """

    data: Float[Tensor, "*c d h w"]
    patient_from_voxel: Float[Tensor, "4 4"]
    origin_patient_mm: Float[Tensor, "3"]
    unit: Literal["HU", "per_mm"] = "HU"
    name: str = "volume"
    slice_thickness_mm: float | None = None
    sharpness: tuple[float, float, float] = (1.0, 1.0, 1.0)
    warnings: tuple[str, ...] = ()

    @classmethod
    def from_grid(
        cls,
        data: Float[Tensor, "*c d h w"],
        patient_from_voxel: Float[Tensor, "4 4"],
        name: str = "volume",
        slice_thickness_mm: float | None = None,
        warnings: tuple[str, ...] = (),
    ) -> "Volume":
        """A whole CT in HU; its centre becomes the origin of the ``ct`` frame."""
        patient_from_voxel = patient_from_voxel.double()
        last = torch.tensor([n - 1.0 for n in data.shape[:-4:-1]], dtype=torch.float64)
        origin = patient_from_voxel[:3, :3] @ (last / 2) + patient_from_voxel[:3, 3]
        return cls(data, patient_from_voxel, origin, "HU", name, slice_thickness_mm, warnings=warnings)

    @property
    def spacing_mm(self) -> Float[Tensor, "3"]:
        """Voxel size in mm along i, j, k."""
        return self.patient_from_voxel[:3, :3].norm(dim=0)

    @property
    def grid(self) -> Float[Tensor, "2 3"]:
        """The voxels as a projector needs them: size in mm and ``sharpness``, each along i, j, k."""
        return torch.stack([self.spacing_mm, torch.tensor(self.sharpness, dtype=torch.float64)])

    @property
    def along_body(self) -> int:
        """The voxel axis, i, j or k (0, 1, 2), nearest to the patient's axis from feet to head."""
        return int((self.patient_from_voxel[2, :3] / self.spacing_mm).abs().argmax())

    @property
    def voxel_from_ct(self) -> Float[Tensor, "4 4"]:
        """Maps the ``ct`` frame (mm from the centre of the CT, along patient axes) to (i, j, k)."""
        patient_from_ct = torch.eye(4, dtype=torch.float64)
        patient_from_ct[:3, 3] = self.origin_patient_mm
        return torch.linalg.inv(self.patient_from_voxel) @ patient_from_ct

    def holds(self, points_mm: Float[Tensor, "n 3"]) -> Bool[Tensor, " n"]:
        """Whether each point (LPS mm) lies in a voxel."""
        homogeneous = torch.cat([points_mm.double(), torch.ones(len(points_mm), 1, dtype=torch.float64)], dim=1)
        voxels = (homogeneous @ torch.linalg.inv(self.patient_from_voxel).mT)[:, :3]
        size = torch.tensor(self.data.shape[:-4:-1])
        return ((voxels >= -0.5) & (voxels <= size - 0.5)).all(1)

    def with_data(self, data: Float[Tensor, "*c d h w"], **changes: object) -> "Volume":
        """The same grid with other values. Raises ``RegtorchError`` for values of another shape."""
        if data.shape != self.data.shape:
            raise RegtorchError(f"{self.name}: values of shape {tuple(data.shape)}, expected {tuple(self.data.shape)}")
        return replace(self, data=data, **changes)

    def to(self, device: str) -> "Volume":
        """The volume on a device: ``cpu``, ``cuda`` or ``cuda:N``. Raises ``RegtorchError`` if it is not available."""
        if device != "cpu" and not (device.partition(":")[0] == "cuda" and torch.cuda.is_available()):
            raise RegtorchError(f"device {device!r}: expected cpu, or cuda where torch finds a GPU")
        return replace(self, data=self.data.to(device))

    def on_grid(self, data: Float[Tensor, "*c d h w"], patient_from_voxel: Float[Tensor, "4 4"]) -> "Volume":
        """Other values on another grid in the same patient; the origin of the ``ct`` frame stays."""
        return replace(self, data=data, patient_from_voxel=patient_from_voxel)

    def with_edges(self, width_mm: float) -> "Volume":
        """The same voxels, constant except for linear transitions of ``width_mm`` between neighbours.

        Thick slices of a scanner and Siddon's method correspond to such voxels. An axis with voxels smaller than
        ``width_mm`` stays linear from centre to centre; infinity makes all axes so. Raises ``RegtorchError`` unless
        ``width_mm`` is positive.
        """
        if not width_mm > 0:
            raise RegtorchError(f"{self.name}: edges of {width_mm} mm, expected a positive width")
        return replace(self, sharpness=tuple(max(1.0, size / width_mm) for size in self.spacing_mm.tolist()))
