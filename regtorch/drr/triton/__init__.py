"""Projectors on a GPU, each pixel's line integral and its derivatives in one pass: the torch side.

``kernels.py`` holds the kernels on the device: Triton, for any GPU that Triton knows, and for none at all with
``TRITON_INTERPRET=1``. Nothing here waits for the device or reads a number from it. So a function can be captured in a
CUDA graph, after one call that compiles it; every call gives the same bits.

Shared arguments: ``data`` in float32 with axes k, j, i, and one of classes before them or none; ``rays`` of
``cone_beam_rays`` and ``grid`` of the volume in float64; ``method`` "joseph", "siddon" or "trilinear".
"""

import math
import os
from importlib.util import find_spec

import torch
from jaxtyping import Float
from torch import Tensor

_METHODS = ("joseph", "siddon", "trilinear")
_TILE_ROWS, _TILE_COLUMNS = 8, 16


def why_not(data: Tensor, method: str) -> str:
    """The reason why this backend cannot render; empty when nothing does."""
    if method not in _METHODS:
        return f"method {method!r}, expected one of {', '.join(map(repr, _METHODS))}"
    if data.dtype != torch.float32:
        return f"a volume of {data.dtype}, expected torch.float32"
    if not data.is_cuda and os.environ.get("TRITON_INTERPRET") != "1":
        return f"a volume on {data.device}, expected a CUDA device (or TRITON_INTERPRET=1)"
    if data.shape[-3:].numel() >= 1 << 31:
        return f"a volume of {data.shape[-3:].numel()} voxels, expected fewer than {1 << 31}"
    if find_spec("triton") is None:
        return "triton is not installed, expected the package 'triton'"
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
    images = data.new_empty(len(rays), data.shape[:-3].numel(), rows, columns)
    _launch("project", (data, rays, grid, images), data, images, method)
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
    """Line integrals and their derivatives by p parameters, given how the rays move with these."""
    parameters = ray_jacobian.shape[-1]
    images = data.new_empty(len(rays), data.shape[:-3].numel(), rows, columns)
    jacobian = data.new_empty(*images.shape[:2], parameters, rows, columns)
    tensors = data, rays, ray_jacobian, grid, images, jacobian
    _launch("project_with_jacobian", tensors, data, images, method, parameters)
    return images, jacobian


def pull_back_rays(
    data: Float[Tensor, "*c d h w"],
    rays: Float[Tensor, "b 12"],
    grid: Float[Tensor, "2 3"],
    image_gradients: Float[Tensor, "b classes rows columns"],
    method: str,
) -> Float[Tensor, "b 12"]:
    """The derivative by the rays of a scalar whose derivative by the images is given: float64.

    Each tile of pixels leaves its own sum, and these are added in the order of the tiles.
    """
    sums = rays.new_zeros(len(rays), _tiles(image_gradients), 12)
    _launch("pull_back_rays", (data, rays, grid, image_gradients.to(data), sums), data, image_gradients, method)
    return sums.sum(1)


def pull_back_data(
    data: Float[Tensor, "*c d h w"],
    rays: Float[Tensor, "b 12"],
    grid: Float[Tensor, "2 3"],
    image_gradients: Float[Tensor, "b classes rows columns"],
    method: str,
) -> Float[Tensor, "*c d h w"]:
    """The derivative by the volume of a scalar whose derivative by the images is given: the adjoint of ``project``.

    Many rays add to one voxel, in an order that is not fixed. Their summands are therefore whole numbers of 64 bits,
    whose sum has no order; the unit is the smallest for which no voxel can overflow.
    """
    # A ray crosses a voxel, or one of trilinear's tents two voxels wide, on less than twice the voxel's diagonal.
    most = 4 * grid[0].norm() * image_gradients.abs().sum(dtype=torch.float64)
    scale = torch.where(most == 0, 1, torch.exp2(62 - most.log2().ceil()))
    total = torch.zeros_like(data, dtype=torch.int64, memory_format=torch.contiguous_format)
    scaled = (image_gradients.double() * scale).to(torch.float32)
    _launch("pull_back_data", (total, rays, grid, scaled), data, image_gradients, method)
    return (total / scale).to(data.dtype)


def _tiles(images: Tensor) -> int:
    """How many tiles an image has."""
    rows, columns = images.shape[-2:]
    return -(-rows // _TILE_ROWS) * -(-columns // _TILE_COLUMNS)


def _launch(kernel: str, tensors: tuple[Tensor, ...], data: Tensor, images: Tensor, method: str, *more: int) -> None:
    """One program for each tile of each pose."""
    from regtorch.drr.triton import kernels

    d, h, w = data.shape[-3:]
    channels = images.shape[1]
    programs = len(images) * _tiles(images)
    if not programs or not channels:
        return
    steps = 2 * int(math.hypot(*(n + 1 for n in (d, h, w)))) + 2  # as the reference's trilinear has
    with torch.cuda.device_of(data):
        getattr(kernels, kernel)[(programs,)](
            *(t.detach().to(data.device).contiguous() for t in tensors), w, h, d, *images.shape[-2:], steps, *more,
            METHOD=method, CHANNELS=channels, PADDED=1 << (channels - 1).bit_length(),
            TILE_ROWS=_TILE_ROWS, TILE_COLUMNS=_TILE_COLUMNS, num_warps=4, enable_fp_fusion=True,
        )  # fmt: skip
