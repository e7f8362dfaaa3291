"""Projectors on a GPU, each pixel's line integral and its derivatives in one pass: the torch side.

``joseph_kernels.py`` and ``kernels.py`` hold the kernels on the device: Triton, for any GPU that Triton knows, and for
none at all with ``TRITON_INTERPRET=1``. Nothing here waits for the device or reads a number from it. So a function can
be captured in a CUDA graph, after one call that compiles it; every call gives the same bits.

Shared arguments: ``data`` in float32 with axes k, j, i, and one of classes before them or none; ``rays`` of
``cone_beam_rays`` and ``grid`` of the volume in float64; ``method`` "joseph", "siddon" or "trilinear".
"""

import math
import os
from collections.abc import Sequence
from importlib.util import find_spec

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.drr.triton.slices import BLOCK, BORDER, prepared

_METHODS = ("joseph", "siddon", "trilinear")
_OF_RAYS = 8, 16
_MOST_SLICES = (1 << 15) - 1
_RECORD, _SURVEYED = 32, 64
_OF_VALUES, _OF_SLOPES = (8, 16, 1, 96), (8, 16, 2, 96)
"""Rows and columns of the tiles of Joseph's method, the warps that work on one, and the registers of a thread.

So few registers hold all that the loops need; more would keep fewer tiles in flight.
"""


def why_not(data: Tensor, method: str) -> str:
    """What keeps this backend from rendering; empty when nothing does."""
    if method not in _METHODS:
        return f"method {method!r}, expected one of {', '.join(map(repr, _METHODS))}"
    if data.dtype != torch.float32:
        return f"a volume of {data.dtype}, expected torch.float32"
    if not data.is_cuda and os.environ.get("TRITON_INTERPRET") != "1":
        return f"a volume on {data.device}, expected a CUDA device (or TRITON_INTERPRET=1)"
    if data.shape[-3:].numel() >= 1 << 31:
        return f"a volume of {data.shape[-3:].numel()} voxels, expected fewer than {1 << 31}"
    if math.prod(n + 2 * BORDER for n in data.shape[-3:]) >= 1 << 32:
        return f"a volume of {tuple(data.shape[-3:])} voxels, expected fewer than {1 << 32} with air around"
    if max(data.shape[-3:]) > _MOST_SLICES:
        return f"a volume of {max(data.shape[-3:])} slices, expected at most {_MOST_SLICES}"
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
    _launch("project", (rays, grid, images), data, grid, images, method)
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
    tensors = rays, ray_jacobian, grid, images, jacobian
    _launch("project_with_jacobian", tensors, data, grid, images, method, parameters, 1, parameters)
    return images, jacobian


def project_as_one(
    data: Float[Tensor, "*c d h w"],
    rays: Float[Tensor, "b 12"],
    ray_jacobian: Float[Tensor, "b 12 p"],
    grid: Float[Tensor, "2 3"],
    rows: int,
    columns: int,
    method: str,
) -> Float[Tensor, "b classes 1+p rows columns"]:
    """As ``project_with_jacobian``, each image followed by its derivatives."""
    images = 1 + ray_jacobian.shape[-1]
    both = data.new_empty(len(rays), data.shape[:-3].numel(), images, rows, columns)
    tensors = rays, ray_jacobian, grid, both, both.view(-1)[rows * columns :]
    _launch("project_with_jacobian", tensors, data, grid, both[:, :, 0], method, images - 1, images, images)
    return both


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
    joseph = method == "joseph"
    tiles = _tiles(image_gradients, _OF_SLOPES if joseph else _OF_RAYS) * (image_gradients.shape[1] if joseph else 1)
    sums = rays.new_zeros(len(rays), tiles, 12)
    _launch("pull_back_rays", (rays, grid, image_gradients.to(data), sums), data, grid, image_gradients, method)
    return sums.sum(1)


def pull_back_data(
    data: Float[Tensor, "*c d h w"],
    rays: Float[Tensor, "b 12"],
    grid: Float[Tensor, "2 3"],
    image_gradients: Float[Tensor, "b classes rows columns"],
    method: str,
) -> Float[Tensor, "*c d h w"]:
    """The derivative by the volume of a scalar whose derivative by the images is given: the adjoint of ``project``.

    Many rays add to one voxel, in an order that is not fixed. What they add is therefore made whole numbers of 64
    bits, whose sum knows no order; the unit is the smallest for which no voxel can overflow.
    """
    # A ray crosses a voxel, or one of trilinear's tents two voxels wide, on less than twice the voxel's diagonal.
    most = 4 * grid[0].norm() * image_gradients.abs().sum(dtype=torch.float64)
    scale = torch.where(most == 0, 1, torch.exp2(62 - most.log2().ceil()))
    total = torch.zeros_like(data, dtype=torch.int64, memory_format=torch.contiguous_format)
    scaled = (image_gradients.double() * scale).to(torch.float32)
    _launch_per_ray("pull_back_data", (total, rays, grid, scaled), image_gradients, method)
    return (total / scale).to(data.dtype)


def _launch(
    kernel: str, tensors: Sequence[Tensor], data: Tensor, grid: Tensor, images: Tensor, method: str, *more: int
) -> None:
    if method == "joseph":
        _launch_joseph(f"joseph_{kernel}", tensors, data, grid, images, *more)
    else:
        _launch_per_ray(kernel, (data, *tensors), images, method, *more)


def _launch_per_ray(kernel: str, tensors: Sequence[Tensor], images: Tensor, method: str, *more: int) -> None:
    """One program for each tile of each pose; the volume is the first tensor."""
    from regtorch.drr.triton import kernels

    data, (d, h, w), channels = tensors[0], tensors[0].shape[-3:], images.shape[1]
    programs = len(images) * _tiles(images, _OF_RAYS)
    if not programs or not channels:
        return
    steps = 2 * int(math.hypot(*(n + 1 for n in (d, h, w)))) + 2  # as the reference's trilinear has
    with torch.cuda.device_of(data):
        getattr(kernels, kernel)[(programs,)](
            *_there(tensors, data), w, h, d, *images.shape[-2:], steps, *more,
            METHOD=method, CHANNELS=channels, PADDED=1 << (channels - 1).bit_length(),
            TILE_ROWS=_OF_RAYS[0], TILE_COLUMNS=_OF_RAYS[1], num_warps=4, enable_fp_fusion=True,
        )  # fmt: skip


def _launch_joseph(
    kernel: str, tensors: Sequence[Tensor], data: Tensor, grid: Tensor, images: Tensor, *more: int
) -> None:
    """One program for each tile of each class of each pose."""
    from regtorch.drr.triton import joseph_kernels

    d, h, w = data.shape[-3:]
    rows, columns, warps, registers = _OF_VALUES if kernel == "joseph_project" else _OF_SLOPES
    programs = images.shape[:2].numel() * _tiles(images, (rows, columns))
    if not programs:
        return
    sharp = grid.is_cuda or bool((grid[1] > 1).any())  # what is on the device is not waited for
    slices, tables = prepared(data)
    room = max(d, h, w) + 1
    numbers = torch.empty(programs * room, dtype=torch.int16, device=data.device)
    records = data.new_empty(programs * _RECORD)
    rays, *others = _there(tensors, data)
    place = w, h, d, images.shape[:2].numel(), *images.shape[-2:], images.shape[1]
    options = {"num_warps": warps, "enable_fp_fusion": True}
    if torch.version.cuda:  # other compilers know no such option
        options["maxnreg"] = registers
    with torch.cuda.device_of(data):
        joseph_kernels.joseph_survey[(-(-programs // _SURVEYED),)](
            records, rays, *place, programs,
            BORDER=BORDER, TILE_ROWS=rows, TILE_COLUMNS=columns, AT_ONCE=_SURVEYED, num_warps=1, enable_fp_fusion=True,
        )  # fmt: skip
        getattr(joseph_kernels, kernel)[(programs,)](
            slices, tables, numbers, records, rays, *others, *place, room, *more,
            BLOCK=BLOCK, BORDER=BORDER, SHARP=sharp, TILE_ROWS=rows, TILE_COLUMNS=columns, **options,
        )  # fmt: skip


def _tiles(images: Tensor, tile: tuple[int, ...]) -> int:
    """How many tiles an image has."""
    return -(-images.shape[-2] // tile[0]) * -(-images.shape[-1] // tile[1])


def _there(tensors: Sequence[Tensor], data: Tensor) -> list[Tensor]:
    return [t.detach().to(data.device).contiguous() for t in tensors]
