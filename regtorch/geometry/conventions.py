"""Poses in the conventions of other tools: one convention inside, named ones at the border.

Each function takes the nine parameters [*b, 9] (mm, rad), a detector, a view and the CT's centre (LPS mm). It returns
the other tool's numbers. Its docstring names frame, units and flips.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.geometry.detector import Detector
from regtorch.geometry.parameters import X_S, Z_S
from regtorch.geometry.projection import world_from_ct


class RtkProjection(NamedTuple):
    """Arguments of RTK's ``AddProjection``, LPS mm: source, detector's centre, directions of columns and of rows."""

    source: Float[Tensor, "*b 3"]
    detector: Float[Tensor, "*b 3"]
    columns: Float[Tensor, "*b 3"]
    rows: Float[Tensor, "*b 3"]


class Camera(NamedTuple):
    """A camera in the source: patient (LPS mm) from camera, and (column, row) in pixels from (x/z, y/z).

    The camera's x goes along columns, its y along rows and its z to the detector. Pixels count from the image's upper
    left corner, so that the first one's centre is (0.5, 0.5).
    """

    patient_from_camera: Float[Tensor, "*b 4 4"]
    pixel_from_camera: Float[Tensor, "*b 3 3"]


class PlastimatchView(NamedTuple):
    """Options of ``plastimatch drr``: ``--nrm``, ``--vup``, ``--isocenter`` (LPS mm), ``--sad`` and ``--sid`` (mm),
    ``--image-center`` in pixels, which is (column, row) although its help says (row, column)."""

    normal: Float[Tensor, "*b 3"]
    up: Float[Tensor, "*b 3"]
    isocenter: Float[Tensor, "*b 3"]
    distance: Float[Tensor, "*b"]
    image_center: Float[Tensor, "*b 2"]


def patient_from_world(
    parameters: Float[Tensor, "*b 9"], view: str, origin_patient_mm: Float[Tensor, "3"]
) -> Float[Tensor, "*b 4 4"]:
    """Rigid transform from the detector's frame to LPS, mm."""
    patient_from_ct = torch.eye(4).to(parameters)
    patient_from_ct[:3, 3] = origin_patient_mm
    return patient_from_ct @ torch.linalg.inv(world_from_ct(parameters, view))


def to_rtk(parameters: Float[Tensor, "*b 9"], view: str, origin_patient_mm: Float[Tensor, "3"]) -> RtkProjection:
    """RTK (``ThreeDCircularProjectionGeometry.AddProjection``): points and directions in the CT's own frame.

    The stack of projections has its origin at the first pixel's centre, and its rows go down.
    """
    place = patient_from_world(parameters, view, origin_patient_mm)
    source = (place[..., :3, :3] @ parameters[..., X_S : Z_S + 1, None])[..., 0] + place[..., :3, 3]
    return RtkProjection(source, place[..., :3, 3], place[..., :3, 0], -place[..., :3, 1])


def to_camera(
    parameters: Float[Tensor, "*b 9"], detector: Detector, view: str, origin_patient_mm: Float[Tensor, "3"]
) -> Camera:
    """nanodrr and computer vision (OpenCV's axes): a camera in the source that looks at the detector."""
    offset = parameters[..., :2] - parameters.new_tensor(detector.centre_mm)
    size = parameters.new_tensor([detector.columns, detector.rows])
    middle = size / 2 + offset * parameters.new_tensor([1, -1]) / detector.pixel_mm
    focal = parameters[..., Z_S] / detector.pixel_mm
    zero, one = torch.zeros_like(focal), torch.ones_like(focal)
    intrinsic = [focal, zero, middle[..., 0], zero, focal, middle[..., 1], zero, zero, one]
    world_from_camera = torch.diag(parameters.new_tensor([1, -1, -1, 1])).expand(*parameters.shape[:-1], 4, 4).clone()
    world_from_camera[..., :3, 3] = parameters[..., X_S : Z_S + 1]
    return Camera(
        patient_from_world(parameters, view, origin_patient_mm) @ world_from_camera,
        torch.stack(intrinsic, dim=-1).unflatten(-1, (3, 3)),
    )


def to_plastimatch(
    parameters: Float[Tensor, "*b 9"], detector: Detector, view: str, origin_patient_mm: Float[Tensor, "3"]
) -> PlastimatchView:
    """``plastimatch drr``: the isocentre lies in the detector's plane, at the source's foot."""
    place = patient_from_world(parameters, view, origin_patient_mm)
    flat = parameters[..., X_S : Z_S + 1] * parameters.new_tensor([1, 1, 0])
    foot = (place[..., :3, :3] @ flat[..., None])[..., 0] + place[..., :3, 3]
    offset = (parameters[..., :2] - parameters.new_tensor(detector.centre_mm)) / detector.pixel_mm
    middle = parameters.new_tensor([(detector.columns - 1) / 2, (detector.rows - 1) / 2])
    return PlastimatchView(
        place[..., :3, 2],
        place[..., :3, 1],
        foot,
        parameters[..., Z_S],
        middle + offset * parameters.new_tensor([1, -1]),
    )
