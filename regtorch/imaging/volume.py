"""The CT: a grid of values with its place in the patient."""

from dataclasses import dataclass, replace
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.errors import RegtorchError


@dataclass(frozen=True)
class Volume:
    """Voxel values ``data[k, j, i]``, or ``data[c, k, j, i]`` for c classes of tissue, and their place in the patient.

    ``patient_from_voxel`` (float64, CPU) maps (i, j, k, 1) to LPS millimetres; its axes are orthogonal.
    ``origin_patient_mm`` is the origin of the ``ct`` frame, the centre of the CT as stored in its file: cropping and
    coarsening leave it where it is, so that the nine parameters keep their meaning. ``unit`` is ``"HU"`` or, after
    ``attenuation``, ``"per_mm"``. ``name`` says in messages where it came from. ``slice_thickness_mm`` is the DICOM
    series' own; slices may be thinner than their distance. ``warnings`` are the reader's. ``sharpness`` (along i, j, k)
    is how to read between voxels: with 1 a value changes into the next one linearly from centre to centre. With s it
    does so on the middle 1/s of that way, and voxels are constant elsewhere.
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
        """A whole CT in HU, whose centre becomes the origin of its ``ct`` frame."""
        patient_from_voxel = patient_from_voxel.double()
        last = torch.tensor([n - 1.0 for n in data.shape[:-4:-1]], dtype=torch.float64)
        origin = patient_from_voxel[:3, :3] @ (last / 2) + patient_from_voxel[:3, 3]
        return cls(data, patient_from_voxel, origin, "HU", name, slice_thickness_mm, warnings=warnings)

    @property
    def spacing_mm(self) -> Float[Tensor, "3"]:
        """Voxel size along i, j, k."""
        return self.patient_from_voxel[:3, :3].norm(dim=0)

    @property
    def grid(self) -> Float[Tensor, "2 3"]:
        """A projector's knowledge of the voxels along i, j, k: their size in mm, and ``sharpness``."""
        return torch.stack([self.spacing_mm, torch.tensor(self.sharpness, dtype=torch.float64)])

    @property
    def along_body(self) -> int:
        """Which voxel axis, i, j or k (0, 1, 2), is nearest to the patient's from feet to head."""
        return int((self.patient_from_voxel[2, :3] / self.spacing_mm).abs().argmax())

    @property
    def voxel_from_ct(self) -> Float[Tensor, "4 4"]:
        """From mm about the centre of the CT, along patient axes, to (i, j, k)."""
        patient_from_ct = torch.eye(4, dtype=torch.float64)
        patient_from_ct[:3, 3] = self.origin_patient_mm
        return torch.linalg.inv(self.patient_from_voxel) @ patient_from_ct

    def with_data(self, data: Float[Tensor, "*c d h w"], **changes: object) -> "Volume":
        """The same grid with other values."""
        if data.shape != self.data.shape:
            raise RegtorchError(f"{self.name}: values of shape {tuple(data.shape)}, expected {tuple(self.data.shape)}")
        return replace(self, data=data, **changes)

    def to(self, device: str) -> "Volume":
        """With its values there: ``cpu``, ``cuda`` or ``cuda:N``. Raises ``RegtorchError`` where there is no such."""
        if device != "cpu" and not (device.partition(":")[0] == "cuda" and torch.cuda.is_available()):
            raise RegtorchError(f"device {device!r}: expected cpu, or cuda where torch finds a GPU")
        return replace(self, data=self.data.to(device))

    def on_grid(self, data: Float[Tensor, "*c d h w"], patient_from_voxel: Float[Tensor, "4 4"]) -> "Volume":
        """Values on another grid in the same patient; the origin of the ``ct`` frame stays."""
        return replace(self, data=data, patient_from_voxel=patient_from_voxel)

    def with_edges(self, width_mm: float) -> "Volume":
        """The same voxels, but constant up to edges of ``width_mm`` between them, where they are larger than that.

        So a scanner's thick slices, or Siddon's method, see them; infinity makes them linear from centre to centre.
        """
        if not width_mm > 0:
            raise RegtorchError(f"{self.name}: edges of {width_mm} mm, expected a positive width")
        return replace(self, sharpness=tuple(max(1.0, size / width_mm) for size in self.spacing_mm.tolist()))
