"""Cone-beam rays as twelve numbers per pose: the narrow waist that every projector shares."""

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.geometry.detector import Detector
from regtorch.geometry.projection import world_from_ct

_MOVED = torch.tensor([[1.0, -1.0], [0.0, -1.0], [0.0, 0.0], [0.0, 0.0]])
"""How source, first pixel and the two steps move against the patient when the source moves, when the patient does."""


def cone_beam_rays(
    parameters: Float[Tensor, "*b 9"],
    detector: Detector,
    view: str,
    voxel_from_ct: Float[Tensor, "4 4"],
) -> Float[Tensor, "*b 12"]:
    """Source, centre of pixel (0, 0), step to the next column, step to the next row: each (i, j, k) in voxels.

    The ray of pixel (row, column) runs from the source to ``first + column * column_step + row * row_step``.
    """
    voxel_from_world = voxel_from_ct.to(parameters) @ torch.linalg.inv(world_from_ct(parameters, view))
    return (_in_world(parameters, detector) @ voxel_from_world.mT)[..., :3].flatten(-2)


def ray_jacobian(
    parameters: Float[Tensor, "*b 9"], detector: Detector, view: str, voxel_from_ct: Float[Tensor, "4 4"]
) -> Float[Tensor, "*b 12 9"]:
    """Derivatives of ``cone_beam_rays`` by the nine parameters: voxels per mm, voxels per rad.

    A point p of the world is A^-1 (p - t) in the ct frame, with A = R B_view and t where the patient is; a step has no
    t. Turning the patient about an axis w by a small angle turns p - t, seen from the patient, by -w x (p - t). Here w
    is R X for eta, Rz Y for theta and Z for phi.
    """
    world_from_patient = world_from_ct(parameters, view)
    in_world = _in_world(parameters, detector)
    seen = in_world[..., :3] - in_world[..., 3:] * parameters[..., None, 3:6]
    (_, cy, cz), (_, sy, sz) = parameters[..., 6:].cos().unbind(-1), parameters[..., 6:].sin().unbind(-1)
    zero, one = torch.zeros_like(cy), torch.ones_like(cy)
    axes = torch.stack([cz * cy, sz * cy, -sy, -sz, cz, zero, zero, zero, one], dim=-1).unflatten(-1, (3, 3))
    turned = torch.linalg.cross(seen[..., :, None, :], axes[..., None, :, :].expand(*seen.shape[:-1], 3, 3))
    moved = (_MOVED[:, :, None, None] * torch.eye(3)).flatten(1, 2).to(seen).expand(*seen.shape[:-1], 6, 3)
    by_parameters = torch.cat([moved, turned], dim=-2) @ world_from_patient[..., None, :3, :3]
    return (by_parameters @ voxel_from_ct[:3, :3].to(seen).mT).mT.flatten(-3, -2)


def _in_world(parameters: Float[Tensor, "*b 9"], detector: Detector) -> Float[Tensor, "*b 4 4"]:
    """Rows: source, centre of the first pixel, both steps; homogeneous, in mm."""
    x, y = detector.centre_mm
    pixel = detector.pixel_mm
    fixed = parameters.new_tensor(
        [
            [x - (detector.columns - 1) / 2 * pixel, y + (detector.rows - 1) / 2 * pixel, 0, 1],
            [pixel, 0, 0, 0],
            [0, -pixel, 0, 0],
        ]
    )
    source = torch.cat([parameters[..., :3], torch.ones_like(parameters[..., :1])], dim=-1)
    return torch.cat([source[..., None, :], fixed.expand(*source.shape[:-1], 3, 4)], dim=-2)
