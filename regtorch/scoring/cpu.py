"""Sums of gradient images of poses: a band of a DRR and of its derivatives never leaves the core's cache.

Poses whose bands fit the cache together are rendered together, one row of tiles after the other. They read the same
part of the volume.
"""

from typing import no_type_check

import numpy as np
import torch
from jaxtyping import Float
from numba import get_num_threads, njit, prange
from torch import Tensor

from regtorch.drr.cpu.scratch import TILE_COLUMNS, TILE_ROWS, scratch, slope_scratch
from regtorch.drr.cpu.slices import prepared
from regtorch.drr.cpu.tile import paint
from regtorch.similarity.cpu import IN_CACHE, band_gram, bands, gradient_scratch
from regtorch.similarity.gram import FixedGradients


def joseph_gram(
    data: Float[Tensor, "d h w"],
    rays: Float[Tensor, "b 12"],
    ray_jacobian: Float[Tensor, "b 12 p"] | None,
    grid: Float[Tensor, "2 3"],
    fixed: FixedGradients,
) -> tuple[Float[Tensor, "b 2 m m+2"], Float[Tensor, " b"]]:
    """``similarity.gram.gradient_gram`` of DRRs by Joseph's method and, unless None, of their derivatives."""
    rows, columns = fixed.root.shape
    images = 1 if ray_jacobian is None else 1 + ray_jacobian.shape[2]
    count, band = bands(rows, columns, images)
    partial, squares = np.zeros((len(rays), count, 2, images, images + 2)), np.zeros((len(rays), count))
    twelve = rays.contiguous().numpy()
    by_pose = None if ray_jacobian is None else ray_jacobian.contiguous().numpy()
    unit, root = fixed.unit.contiguous().numpy(), fixed.root.contiguous().numpy()
    stacks = prepared(data, twelve, rows, columns)
    _grams(*stacks, grid.flatten().numpy(), twelve, by_pose, band, unit, root, partial, squares, get_num_threads())
    return torch.from_numpy(partial.sum(axis=1)), torch.from_numpy(np.sqrt(squares.sum(axis=1) / (rows * columns)))


@njit(parallel=True, nogil=True, cache=True, error_model="numpy")
@no_type_check
def _grams(groups, tables, sizes, spacing, rays, ray_jacobian, band, unit, root, partial, squares, threads):
    for thread in prange(threads):
        _share(
            thread, threads, (groups, tables, sizes), spacing, rays, ray_jacobian, band, unit, root, partial, squares
        )


@njit(nogil=True, error_model="numpy")
@no_type_check
def _share(thread, threads, stacks, spacing, rays, ray_jacobian, band, unit, root, partial, squares):
    poses, count, _, images, _ = partial.shape
    rows, columns = root.shape
    fit = max(1, IN_CACHE // (images * (band + 2) * columns))
    groups = max(1, (poses + fit * threads - 1) // (fit * threads)) * threads  # the same number for each thread
    together = (poses + groups - 1) // groups
    buffers = np.empty((together, images, band + 2, columns), np.float32)
    gradients = gradient_scratch(images, columns)
    room, slopes = scratch(1), slope_scratch(1, ray_jacobian)
    for item in range(thread, groups * count, threads):
        b = item // groups
        group = (item + b) % groups  # shares out the bands of one pose as well
        first, last = group * together, min((group + 1) * together, poses)
        row0, row1 = b * band, min((b + 1) * band, rows)
        if row0 >= row1:
            continue
        top, bottom = max(row0 - 1, 0), min(row1 + 1, rows)  # gradients reach one row further
        for row in range(top, bottom, TILE_ROWS):
            for pose in range(first, last):
                buffer, by_pose = buffers[pose - first], _of(ray_jacobian, pose)
                image, jacobian = buffer[:1], _derivatives(buffer, ray_jacobian)
                for column in range(0, columns, TILE_COLUMNS):
                    place = row, min(row + TILE_ROWS, bottom), column, min(column + TILE_COLUMNS, columns)
                    paint(stacks, spacing, rays[pose], by_pose, place, room, slopes, image, jacobian, row0 - 1, 0)
        for pose in range(first, last):
            buffer = buffers[pose - first]
            if row0 == 0:  # borders are replicated
                buffer[:, 0] = buffer[:, 1]
            if row1 == rows:
                buffer[:, rows - row0 + 1] = buffer[:, rows - row0]
            squares[pose, b] = band_gram(buffer, row0, row1, unit, root, gradients, partial[pose, b])


@njit(nogil=True)
@no_type_check
def _derivatives(buffer, ray_jacobian):
    if ray_jacobian is None:
        return None
    return buffer[1:].reshape((1, buffer.shape[0] - 1, buffer.shape[1], buffer.shape[2]))


@njit(nogil=True)
@no_type_check
def _of(ray_jacobian, pose):
    if ray_jacobian is None:
        return None
    return ray_jacobian[pose]
