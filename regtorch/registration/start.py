"""Where the search begins and how far it goes: view and protocol, no calibration (section 2.2.2 of the paper)."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.errors import RegtorchError
from regtorch.geometry import (
    X_OBJ,
    Y_OBJ,
    Z_OBJ,
    Z_S,
    Detector,
    pixel_from_patient,
    project,
    world_from_ct,
    world_from_patient_axes,
)
from regtorch.imaging import Volume
from regtorch.imaging.hounsfield import BODY_HU, corners_ct

SDD_MM = 1000.0
"""Source-detector distance where nothing tells it, as in the paper."""

SEARCH = (75.0, 75.0, 150.0, 150.0, 150.0, 150.0, *(math.radians(12),) * 3)
"""Half the range searched about the start, in mm and rad. Declared here: the paper's Table 1 is lost."""

Point2 = tuple[float, float]
Point3 = tuple[float, float, float]


def initial_parameters(
    ct: Volume,
    detector: Detector,
    view: str,
    *,
    sdd_mm: float | None = None,
    landmark_patient_mm: Point3 | None = None,
    landmark_image: Point2 | None = None,
) -> Float[Tensor, "9"]:
    """Source over the detector's centre, no rotation, the patient against the detector, x and y from one landmark.

    A landmark is a point of the CT (LPS mm) and the (column, row) where it is seen in the image (from the source);
    without one the centre of the CT is put over the detector's centre. ``sdd_mm`` is 1000 unless told.
    """
    sdd_mm = SDD_MM if sdd_mm is None else sdd_mm
    if not 0 < sdd_mm < math.inf:
        raise RegtorchError(f"SDD of {sdd_mm:g} mm: expected a positive distance")
    axes = world_from_patient_axes(view)
    parameters = torch.zeros(9, dtype=torch.float64)
    parameters[Z_S] = sdd_mm
    parameters[Z_OBJ] = -float((corners_ct(ct, BODY_HU) @ axes.mT)[:, 2].min())
    check_in_front(ct, parameters, view)
    if (landmark_patient_mm is None) != (landmark_image is None):
        raise RegtorchError("a landmark in only one of CT and radiograph: expected it in both or in neither")
    if landmark_patient_mm is not None and landmark_image is not None:
        _check_inside(ct, detector, landmark_patient_mm, landmark_image)
        point = torch.tensor([landmark_patient_mm], dtype=torch.float64)
        wanted = torch.tensor(landmark_image, dtype=torch.float64)
        matrix = pixel_from_patient(parameters, detector, view, ct.origin_patient_mm)
        depth = sdd_mm - float(parameters[Z_OBJ] + axes[2] @ (point[0] - ct.origin_patient_mm))
        miss = (wanted - project(matrix, point)[0]) * detector.pixel_mm * depth / sdd_mm
        parameters[[X_OBJ, Y_OBJ]] = miss * torch.tensor([1.0, -1.0])
    return parameters


def check_in_front(ct: Volume, parameters: Float[Tensor, "9"], view: str) -> None:
    """Raises ``RegtorchError`` unless the whole patient is on the detector's side of the source."""
    height = (corners_ct(ct, BODY_HU) @ world_from_ct(parameters, view)[:3, :3].mT)[:, 2] + parameters[Z_OBJ]
    if not float(height.max()) < float(parameters[Z_S]):
        raise RegtorchError(
            f"SDD of {float(parameters[Z_S]):g} mm: in this {view} view {ct.name} reaches {float(height.max()):g} mm "
            "from the detector, expected the source beyond it"
        )


def _check_inside(ct: Volume, detector: Detector, point: Point3, pixel: Point2) -> None:
    column, row = pixel
    if not (-0.5 <= column <= detector.columns - 0.5 and -0.5 <= row <= detector.rows - 0.5):
        raise RegtorchError(
            f"landmark at (column, row) ({column:g}, {row:g}): expected it inside the image of "
            f"{detector.columns} x {detector.rows} pixels"
        )
    if not bool(ct.holds(torch.tensor([point], dtype=torch.float64))):
        raise RegtorchError(f"landmark at {point} mm (LPS): expected it inside {ct.name}")
