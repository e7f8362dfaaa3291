"""True geometries of the simulation, drawn about a default; drawn again where too little is in the image."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.errors import RegtorchError
from regtorch.geometry import Detector, pixel_from_patient, project, world_from_ct
from regtorch.imaging import Volume, attenuation, coarsen

_TRIES = 100
_GRID_MM = 6.0
_TRUNCATED = torch.special.ndtr(torch.tensor([-3.0, 3.0], dtype=torch.float64))


@dataclass(frozen=True)
class Geometries:
    """Normal errors, truncated at three standard deviations (``deviations``; mm, rad), about ``default`` (mm, rad).

    A draw counts if all of ``bone`` (mm, ``ct`` frame) lies between detector and source, and if at least
    ``least_targets`` of ``targets`` (LPS mm) are in the image.
    """

    default: Float[Tensor, "9"]
    deviations: Float[Tensor, "9"]
    detector: Detector
    view: str
    bone: Float[Tensor, "n 3"]
    targets: Float[Tensor, "m 3"]
    origin_patient_mm: Float[Tensor, "3"]
    least_targets: int

    def draw(self, seed: int) -> tuple[Float[Tensor, "9"], int]:
        """The true parameters of a seed, and the number of draws before them that did not count.

        Raises ``RegtorchError`` after a hundred such draws.
        """
        generator = torch.Generator().manual_seed(seed)
        low, high = _TRUNCATED
        for redrawn in range(_TRIES):
            share = torch.rand(9, generator=generator, dtype=torch.float64)
            parameters = self.default + self.deviations * torch.special.ndtri(low + share * (high - low))
            if self._counts(parameters):
                return parameters, redrawn
        raise RegtorchError(
            f"deviations, {self.view}, seed {seed}: none of {_TRIES} geometries has the bones between detector and "
            f"source and {self.least_targets} targets in the image, expected smaller ones or another default"
        )

    def _counts(self, parameters: Float[Tensor, "9"]) -> bool:
        height = self.bone @ world_from_ct(parameters, self.view)[2, :3] + parameters[5]
        if float(height.min()) <= 0 or float(height.max()) >= float(parameters[2]):
            return False
        matrix = pixel_from_patient(parameters, self.detector, self.view, self.origin_patient_mm)
        last = torch.tensor([self.detector.columns - 1, self.detector.rows - 1])
        pixels = project(matrix, self.targets)
        return int(((pixels >= 0) & (pixels <= last)).all(1).sum()) >= self.least_targets


def bone_voxels(ct: Volume) -> Float[Tensor, "n 3"]:
    """Middles (mm, ``ct`` frame) of all voxels of 6 mm that have bone in them."""
    coarse = coarsen(attenuation(ct), _GRID_MM)
    index = coarse.data.nonzero().flip(1).double()
    in_patient = index @ coarse.patient_from_voxel[:3, :3].mT + coarse.patient_from_voxel[:3, 3]
    return in_patient - ct.origin_patient_mm


def centred(default: Float[Tensor, "9"], point_mm: Float[Tensor, "3"], view: str) -> Float[Tensor, "9"]:
    """``default`` with the patient moved across, so that a point (mm, ``ct`` frame) is where the CT's centre was."""
    moved = default.clone()
    moved[3:5] -= (world_from_ct(default, view)[:3, :3] @ point_mm)[:2]
    return moved


def misplacement(
    initial: Float[Tensor, "9"], true: Float[Tensor, "9"], marker_mm: Float[Tensor, "3"], view: str
) -> dict[str, float]:
    """Columns of figure 2: the projection of a marker (mm, ``ct`` frame), and a square about it as the start has it.

    ``marker_x_mm`` and ``marker_y_mm`` are its true projection (mm, ``world``). The square of 40 mm about it lies in
    the patient so that truly it is parallel to the detector. ``corner1_x_mm`` to ``corner4_y_mm`` are where the
    initial parameters project its corners, less the marker's true projection: misplaced, and skewed by rotations.
    """
    place, start = world_from_ct(true, view), world_from_ct(initial, view)
    marker = place[:3, :3] @ marker_mm + place[:3, 3]
    corners = marker + torch.tensor([[-20, 20, 0], [20, 20, 0], [20, -20, 0], [-20, -20, 0]], dtype=torch.float64)
    thought = (corners - place[:3, 3]) @ place[:3, :3] @ start[:3, :3].mT + start[:3, 3]
    seen = _on_detector(true, marker[None])[0]
    row = dict(zip(("marker_x_mm", "marker_y_mm"), seen.tolist(), strict=True))
    for number, offset in enumerate((_on_detector(initial, thought) - seen).tolist(), 1):
        row |= {f"corner{number}_{axis}_mm": value for axis, value in zip("xy", offset, strict=True)}
    return row


def _on_detector(parameters: Float[Tensor, "9"], points: Float[Tensor, "n 3"]) -> Float[Tensor, "n 2"]:
    """Where rays from the source through points (mm, ``world``) meet the plane of the detector."""
    source = parameters[:3]
    return source[:2] + (points[:, :2] - source[:2]) * source[2] / (source[2] - points[:, 2:])
