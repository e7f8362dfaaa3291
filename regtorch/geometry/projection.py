"""Projection matrices from the nine parameters, and back.

Eq. (1) of the paper is printed with the wrong sign for x_s and y_s: take the source at z_s > 0 and the detector at z =
0. The ray from the source through (x, y, z) meets the detector at X = (z_s x - x_s z) / (z_s - z).
"""

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.errors import RegtorchError
from regtorch.geometry.detector import Detector
from regtorch.geometry.rotation import euler_from_rotation, rotation_from_euler
from regtorch.geometry.views import world_from_patient_axes


def world_from_ct(parameters: Float[Tensor, "*b 9"], view: str) -> Float[Tensor, "*b 4 4"]:
    """Rigid transform of the patient: x_world = R(eta, theta, phi) B_view x_ct + (x_obj, y_obj, z_obj), in mm."""
    axes = world_from_patient_axes(view).to(parameters)
    rotation = rotation_from_euler(parameters[..., 6:]) @ axes
    top = torch.cat([rotation, parameters[..., 3:6, None]], dim=-1)
    bottom = parameters.new_tensor([0, 0, 0, 1]).expand(*top.shape[:-2], 1, 4)
    return torch.cat([top, bottom], dim=-2)


def pixel_from_world(parameters: Float[Tensor, "*b 9"], detector: Detector) -> Float[Tensor, "*b 3 4"]:
    """Central projection from the source onto the detector, to homogeneous (column, row); the last is z_s - z > 0."""
    x_s, y_s, z_s = parameters[..., :3].unbind(-1)
    zero, one = torch.zeros_like(z_s), torch.ones_like(z_s)
    plane_from_world = torch.stack(
        [z_s, zero, -x_s, zero, zero, z_s, -y_s, zero, zero, zero, -one, z_s], dim=-1
    ).unflatten(-1, (3, 4))
    return detector.pixel_from_plane().to(parameters) @ plane_from_world


def pixel_from_patient(
    parameters: Float[Tensor, "*b 9"], detector: Detector, view: str, origin_patient_mm: Float[Tensor, "3"]
) -> Float[Tensor, "*b 3 4"]:
    """Projection matrix from LPS millimetres to (column, row) of the image seen from the source.

    ``origin_patient_mm`` is where the ``ct`` frame has its origin: the centre of the CT as stored.
    """
    ct_from_patient = torch.eye(4).to(parameters)
    ct_from_patient[:3, 3] = -origin_patient_mm.to(parameters)
    return pixel_from_world(parameters, detector) @ world_from_ct(parameters, view) @ ct_from_patient


def project(matrix: Float[Tensor, "*b 3 4"], points: Float[Tensor, "n 3"]) -> Float[Tensor, "*b n 2"]:
    """(column, row) of points; not a number for points behind the source."""
    homogeneous = points.to(matrix) @ matrix[..., :3].mT + matrix[..., None, :, 3]
    depth = homogeneous[..., 2:]
    return homogeneous[..., :2] / torch.where(depth > 0, depth, torch.nan)


def parameters_from_matrix(
    matrix: Float[Tensor, "*b 3 4"], detector: Detector, view: str, origin_patient_mm: Float[Tensor, "3"]
) -> Float[Tensor, "*b 9"]:
    """The nine parameters of a ``pixel_from_patient``, whatever its scale and sign.

    Raises ``RegtorchError`` for a matrix that no source can make on a detector with these square pixels.
    """
    plane = torch.linalg.inv(detector.pixel_from_plane().to(matrix)) @ matrix
    offset = plane[..., 3] + plane[..., :3] @ origin_patient_mm.to(matrix)
    m = plane[..., :3]
    # m = s [[z_s q1 - x_s q3], [z_s q2 - y_s q3], [-q3]] with q the rows of a rotation, so det(m) = -s^3 z_s^2.
    scale = -torch.linalg.det(m).sign() * m[..., 2, :].norm(dim=-1)
    m, offset = m / scale[..., None, None], offset / scale[..., None]
    q3 = -m[..., 2, :]
    x_s, y_s = -(m[..., 0, :] * q3).sum(-1), -(m[..., 1, :] * q3).sum(-1)
    across, up = m[..., 0, :] + x_s[..., None] * q3, m[..., 1, :] + y_s[..., None] * q3
    lengths = torch.stack([across.norm(dim=-1), up.norm(dim=-1)], dim=-1)
    skew = (across * up).sum(-1).abs() / lengths.prod(-1)
    square = ((lengths[..., 0] / lengths[..., 1] - 1).abs() <= 1e-3) & (skew <= 1e-3)  # false for what is not finite
    if not bool(square.all()):
        raise RegtorchError("projection matrix with skewed or oblong pixels: expected square ones")
    z_s = lengths.mean(-1)
    rotation = torch.stack([across, up, q3 * z_s[..., None]], dim=-2) / z_s[..., None, None]
    z = z_s - offset[..., 2]
    x, y = (offset[..., 0] + x_s * z) / z_s, (offset[..., 1] + y_s * z) / z_s
    angles = euler_from_rotation(rotation @ world_from_patient_axes(view).to(matrix).mT)
    return torch.cat([torch.stack([x_s, y_s, z_s, x, y, z], dim=-1), angles], dim=-1)
