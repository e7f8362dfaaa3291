"""Fused CPU projectors (numba): values, exact derivatives by the rays, and adjoints, of every method.

Kernels call the six numbers of ``Volume.grid`` ``spacing``: voxel sizes in mm, then sharpness.
"""

import numpy as np
import torch
from jaxtyping import Float
from numba import get_num_threads
from torch import Tensor

from regtorch.drr.cpu.adjoint import joseph_adjoint
from regtorch.drr.cpu.images import joseph_images, joseph_pull_back, ray_adjoint, ray_images, ray_pull_back
from regtorch.drr.cpu.scratch import TILE_COLUMNS, TILE_ROWS
from regtorch.drr.cpu.slices import prepared

_SHARES = 4
"""How many partial volumes an adjoint is summed from: fixed, so that any number of threads gives the same bits."""


def why_not(data: Tensor, method: str) -> str:
    """The reason why this backend cannot render; empty when nothing does."""
    if data.device.type != "cpu" or data.dtype != torch.float32:
        return f"a volume of {data.dtype} on {data.device}, expected torch.float32 on cpu"
    return ""


def project(
    data: Float[Tensor, "*c d h w"],
    rays: Float[Tensor, "b 12"],
    grid: Float[Tensor, "2 3"],
    rows: int,
    columns: int,
    method: str,
) -> Float[Tensor, "b classes rows columns"]:
    """Line integrals for twelve numbers per pose."""
    images = _empty(len(rays), data.shape[:-3].numel(), rows, columns)
    _fill(data, rays, None, grid, images.numpy(), None, method)
    return images


def project_with_jacobian(
    data: Float[Tensor, "*c d h w"],
    rays: Float[Tensor, "b 12"],
    ray_jacobian: Float[Tensor, "b 12 p"],
    grid: Float[Tensor, "2 3"],
    rows: int,
    columns: int,
    method: str,
) -> tuple[Float[Tensor, "b classes rows columns"], Float[Tensor, "b classes p rows columns"]]:
    """Line integrals, and their derivatives by p parameters of which ``ray_jacobian`` is d rays / d parameters."""
    images = _empty(len(rays), data.shape[:-3].numel(), rows, columns)
    jacobian = _empty(*images.shape[:2], ray_jacobian.shape[2], rows, columns)
    by_pose = ray_jacobian.contiguous().numpy()
    _fill(data, rays, by_pose, grid, images.numpy(), jacobian.numpy(), method)
    return images, jacobian


def _fill(data, rays, ray_jacobian, grid, images, jacobian, method):
    twelve, six = rays.detach().contiguous().numpy(), grid.flatten().numpy()
    if method == "joseph":
        stacks = prepared(data, twelve, *images.shape[-2:])
        joseph_images(*stacks, six, twelve, ray_jacobian, images, jacobian, get_num_threads())
    else:
        voxels = _voxels(data)
        ray_images(method == "siddon", voxels, six, twelve, ray_jacobian, images, jacobian, 16 * get_num_threads())


def _empty(*shape: int) -> Tensor:
    """By numpy, which asks for large pages where torch does not: touching small ones can take longer than rendering."""
    return torch.from_numpy(np.empty(shape, np.float32))


def _voxels(data: Tensor) -> np.ndarray:
    """[c, d, h, w], whatever lies in memory how."""
    return data.detach().reshape(-1, *data.shape[-3:]).contiguous().numpy()


def pull_back_rays(
    data: Float[Tensor, "*c d h w"],
    rays: Float[Tensor, "b 12"],
    grid: Float[Tensor, "2 3"],
    image_gradients: Float[Tensor, "b classes rows columns"],
    method: str,
) -> Float[Tensor, "b 12"]:
    """Derivative by the rays of the sum of ``image_gradients`` times images, in float64."""
    twelve, six, weights = (
        rays.detach().contiguous().numpy(),
        grid.flatten().numpy(),
        image_gradients.contiguous().numpy(),
    )
    rows, columns = weights.shape[-2:]
    if method == "joseph":
        tiles = -(-rows // TILE_ROWS) * -(-columns // TILE_COLUMNS)
        partial = np.zeros((len(twelve), tiles, 12))
        stacks = prepared(data, twelve, rows, columns)
        joseph_pull_back(*stacks, six, twelve, weights, partial, get_num_threads())
    else:
        partial = np.zeros((len(twelve), rows, 12))
        voxels = _voxels(data)
        ray_pull_back(method == "siddon", voxels, six, twelve, weights, partial, 16 * get_num_threads())
    return torch.from_numpy(partial.sum(axis=1))


def pull_back_data(
    data: Float[Tensor, "*c d h w"],
    rays: Float[Tensor, "b 12"],
    grid: Float[Tensor, "2 3"],
    image_gradients: Float[Tensor, "b classes rows columns"],
    method: str,
) -> Float[Tensor, "*c d h w"]:
    """Derivative by the voxels of the same sum: the adjoint of projection."""
    twelve, six, weights = (
        rays.detach().contiguous().numpy(),
        grid.flatten().numpy(),
        image_gradients.contiguous().numpy(),
    )
    adjoints = np.zeros((_SHARES, *_voxels(data).shape), np.float32)
    if method == "joseph":
        joseph_adjoint(six, twelve, weights, adjoints)
    else:
        voxels = _voxels(data)
        ray_adjoint(method == "siddon", voxels, six, twelve, weights, adjoints)
    return torch.from_numpy(adjoints.sum(axis=0)).view_as(data)
