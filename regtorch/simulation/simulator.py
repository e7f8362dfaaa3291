"""A radiograph of a CT from a geometry drawn at random, and the truth about it (section 2.3.1 of the paper)."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch import __version__
from regtorch.drr import render
from regtorch.errors import RegtorchError
from regtorch.geometry import Detector, parameters_to_dict, pixel_from_patient, project, world_from_ct
from regtorch.imaging import BONE_HU, Volume, attenuation
from regtorch.imaging.hounsfield import BODY_HU, corners_ct, crop_to_anatomy
from regtorch.imaging.points import spread_points
from regtorch.simulation.noise import add_quantum_noise

RANGES = (25.0, 25.0, 50.0, 25.0, 25.0, 50.0, *(math.radians(5),) * 3)
"""Half ranges of the nine parameters (mm, rad) about the protocol's."""

DETECTOR = Detector(500, 500, 0.7)

_TARGETS = 16
_DRAWS = 100


@dataclass(frozen=True)
class Simulation:
    """``image``: line integrals seen from the source. ``targets`` (LPS mm) are the ones in the image."""

    image: Float[Tensor, "h w"]
    parameters: Float[Tensor, "9"]
    detector: Detector
    view: str
    pixel_from_patient: Float[Tensor, "3 4"]
    targets: dict[str, tuple[float, float, float]]
    seed: int

    def to_dict(self) -> dict[str, Any]:
        """As written to ``truth.json``: plain values, mm and degrees."""
        return {
            "parameters": parameters_to_dict(self.parameters),
            "view": self.view,
            "mirrored": False,
            "detector": {
                "rows": self.detector.rows,
                "columns": self.detector.columns,
                "pixel_mm": self.detector.pixel_mm,
            },
            "pixel_from_patient": self.pixel_from_patient.tolist(),
            "targets_patient_mm": {name: list(point) for name, point in self.targets.items()},
            "seed": self.seed,
            "version": __version__,
        }


def draw_parameters(
    middle: Float[Tensor, "9"], half_range: Float[Tensor, "9"], generator: torch.Generator
) -> Float[Tensor, "9"]:
    """Nine parameters (mm, rad), each uniform within its half range of the middle."""
    uniform = 2 * torch.rand(9, generator=generator, dtype=torch.float64) - 1
    return middle.double() + uniform * half_range.double()


def draw_geometry(
    ct: Volume, middle: Float[Tensor, "9"], half_range: Float[Tensor, "9"], view: str, generator: torch.Generator
) -> Float[Tensor, "9"]:
    """``draw_parameters``, until the bones lie before the detector and the patient before the source, each as a box.

    The first draw is kept if it will do. Raises ``RegtorchError`` after 100 that will not.
    """
    bone, body = corners_ct(ct, BONE_HU), corners_ct(ct, BODY_HU)
    for _ in range(_DRAWS):
        parameters = draw_parameters(middle, half_range, generator)
        row = world_from_ct(parameters, view)[2]
        bone_z, body_z = (corners @ row[:3] + row[3] for corners in (bone, body))
        if float(bone_z.min()) >= 0 and float(body_z.max()) < float(parameters[2]):
            return parameters
    raise RegtorchError(
        f"{ct.name}: in all of {_DRAWS} geometries drawn for this {view} view bone is behind the detector or the "
        "patient reaches the source, expected smaller ranges or a longer SDD"
    )


def simulate(
    ct: Volume,
    parameters: Float[Tensor, "9"],
    view: str = "PA",
    *,
    detector: Detector = DETECTOR,
    threshold_hu: float | None = None,
    photons: float | None = None,
    targets: Mapping[str, tuple[float, float, float]] | None = None,
    seed: int = 0,
) -> Simulation:
    """Render a radiograph by Siddon's method, from the whole CT or its voxels above ``threshold_hu``.

    ``photons`` per pixel of the open beam adds quantum noise, drawn from ``seed``. ``targets`` (LPS mm) default to
    points spread over the bones; raises ``RegtorchError`` when the image shows none of them.
    """
    parameters = parameters.double()
    if detector.centre_mm != (0.0, 0.0):
        raise RegtorchError(f"detector centred on {detector.centre_mm} mm, expected a whole one, on (0, 0)")
    named = dict(targets) if targets else bone_points(ct)
    attenuating = attenuation(crop_to_anatomy(ct, threshold_hu=threshold_hu), threshold_hu=threshold_hu)
    image = render(attenuating, parameters, detector, view, method="siddon")
    if photons is not None:
        image = add_quantum_noise(image, photons, torch.Generator().manual_seed(seed))
    matrix = pixel_from_patient(parameters, detector, view, ct.origin_patient_mm)
    pixels = project(matrix, torch.tensor(list(named.values()), dtype=torch.float64))
    inside = ((pixels >= 0) & (pixels <= torch.tensor([detector.columns - 1, detector.rows - 1]))).all(1).tolist()
    shown = {name: point for (name, point), seen in zip(named.items(), inside, strict=True) if seen}
    if not shown:
        raise RegtorchError(f"{ct.name}: none of {len(named)} targets is in the image, expected at least one")
    return Simulation(image, parameters, detector, view, matrix, shown, seed)


def bone_points(ct: Volume) -> dict[str, tuple[float, float, float]]:
    """Targets (LPS mm) spread over the bones, for a CT where nobody named any."""
    points = spread_points(attenuation(ct), _TARGETS).tolist()
    return {f"bone {number}": (x, y, z) for number, (x, y, z) in enumerate(points, 1)}
