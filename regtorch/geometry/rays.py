"""Cone-beam rays as twelve numbers per pose: the narrow waist that every projector shares."""

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.geometry.detector import Detector
from regtorch.geometry.projection import world_from_ct


def cone_beam_rays(
    parameters: Float[Tensor, "*b 9"],
    detector: Detector,
    view: str,
    voxel_from_ct: Float[Tensor, "4 4"],
) -> Float[Tensor, "*b 12"]:
    """Source, centre of pixel (0, 0), step to the next column, step to the next row: each (i, j, k) in voxels.

    The ray of pixel (row, column) runs from the source to ``first + column * column_step + row * row_step``.
    """
    ct_from_world = torch.linalg.inv(world_from_ct(parameters, view))
    voxel_from_world = voxel_from_ct.to(parameters) @ ct_from_world
    x, y = detector.centre_mm
    pixel = detector.pixel_mm
    first = parameters.new_tensor([x - (detector.columns - 1) / 2 * pixel, y + (detector.rows - 1) / 2 * pixel, 0, 1])
    column_step, row_step = parameters.new_tensor([pixel, 0, 0, 0]), parameters.new_tensor([0, -pixel, 0, 0])
    source = torch.cat([parameters[..., :3], torch.ones_like(parameters[..., :1])], dim=-1)
    batch = source.shape
    in_world = torch.stack([source, *(v.expand(batch) for v in (first, column_step, row_step))], dim=-1)
    return (voxel_from_world @ in_world)[..., :3, :].mT.flatten(-2)


def ray_jacobian(
    parameters: Float[Tensor, "*b 9"], detector: Detector, view: str, voxel_from_ct: Float[Tensor, "4 4"]
) -> Float[Tensor, "*b 12 9"]:
    """Derivatives of ``cone_beam_rays`` by the nine parameters: voxels per mm, voxels per rad."""
    by_pose = torch.func.jacfwd(lambda p: cone_beam_rays(p, detector, view, voxel_from_ct))
    flat = parameters.reshape(-1, 9)
    if not len(flat):
        return parameters.new_zeros(*parameters.shape[:-1], 12, 9)
    return torch.func.vmap(by_pose)(flat).reshape(*parameters.shape[:-1], 12, 9)
