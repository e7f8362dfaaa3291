"""Whole batches of images, their jacobians and the products with these, spread over threads.

Work is handed out tile by tile and, within a tile, pose by pose: similar poses read the same part of the volume, which
then stays in the cache. Every sum is made in an order that does not depend on the number of threads.
"""

from typing import no_type_check

import numpy as np
from numba import njit, prange

from regtorch.drr.cpu.scratch import TILE_COLUMNS, TILE_ROWS, scratch, slope_scratch
from regtorch.drr.cpu.siddon import siddon
from regtorch.drr.cpu.tile import paint
from regtorch.drr.cpu.trilinear import trilinear


@njit(parallel=True, nogil=True, cache=True, error_model="numpy")
@no_type_check
def joseph_images(groups, tables, sizes, spacing, rays, ray_jacobian, images, jacobian, threads):
    """Into ``images`` [b, c, h, w] and, unless None, ``jacobian`` [b, c, p, h, w] by ``ray_jacobian`` [b, 12, p]."""
    for thread in prange(threads):
        _joseph_share(thread, threads, (groups, tables, sizes), spacing, rays, ray_jacobian, images, jacobian)


@njit(nogil=True)
@no_type_check
def _joseph_share(thread, threads, stacks, spacing, rays, ray_jacobian, images, jacobian):
    poses, channels, rows, columns = images.shape
    strips = (columns + TILE_COLUMNS - 1) // TILE_COLUMNS
    tiles = strips * ((rows + TILE_ROWS - 1) // TILE_ROWS)
    room = scratch(channels)
    slopes = slope_scratch(channels, jacobian)
    for item in range(thread, tiles * poses, threads):
        tile, pose = item // poses, item % poses
        row0, column0 = (tile // strips) * TILE_ROWS, (tile % strips) * TILE_COLUMNS
        place = row0, min(row0 + TILE_ROWS, rows), column0, min(column0 + TILE_COLUMNS, columns)
        by_pose = None if jacobian is None else ray_jacobian[pose]
        target = None if jacobian is None else jacobian[pose]
        paint(stacks, spacing, rays[pose], by_pose, place, room, slopes, images[pose], target, 0, 0)


@njit(parallel=True, nogil=True, cache=True, error_model="numpy")
@no_type_check
def joseph_pull_back(groups, tables, sizes, spacing, rays, weights, partial, threads):
    """Into ``partial`` [b, tiles, 12]: each tile's ``weights`` [b, c, h, w] times derivatives by the rays, summed."""
    poses, channels, rows, columns = weights.shape
    strips = (columns + TILE_COLUMNS - 1) // TILE_COLUMNS
    tiles = strips * ((rows + TILE_ROWS - 1) // TILE_ROWS)
    for thread in prange(threads):
        room, slopes = scratch(channels), slope_scratch(channels, weights)
        image = np.empty((channels, TILE_ROWS, TILE_COLUMNS), np.float32)
        jacobian = np.empty((channels, 12, TILE_ROWS, TILE_COLUMNS), np.float32)
        itself = np.eye(12)
        for item in range(thread, tiles * poses, threads):
            tile, pose = item // poses, item % poses
            row0, column0 = (tile // strips) * TILE_ROWS, (tile % strips) * TILE_COLUMNS
            row1, column1 = min(row0 + TILE_ROWS, rows), min(column0 + TILE_COLUMNS, columns)
            place, stacks = (row0, row1, column0, column1), (groups, tables, sizes)
            paint(stacks, spacing, rays[pose], itself, place, room, slopes, image, jacobian, row0, column0)
            for n in range(12):
                total = 0.0
                for c in range(channels):
                    for row in range(row0, row1):
                        for column in range(column0, column1):
                            slope = jacobian[c, n, row - row0, column - column0]
                            total += np.float64(weights[pose, c, row, column]) * slope
                partial[pose, tile, n] = total


@njit(nogil=True)
@no_type_check
def _walk(exact, data, spacing, ray, row, column, value, slopes, adjoint, weight):
    if exact:
        siddon(data, spacing, ray, row, column, value, slopes, adjoint, weight)
    else:
        trilinear(data, spacing, ray, row, column, value, slopes, adjoint, weight)


@njit(parallel=True, nogil=True, cache=True, error_model="numpy")
@no_type_check
def ray_images(exact, data, spacing, rays, ray_jacobian, images, jacobian, threads):
    """As ``joseph_images``, ray by ray: Siddon's method if ``exact``, else trilinear samples."""
    for thread in prange(threads):
        _ray_share(thread, threads, exact, data, spacing, rays, ray_jacobian, images, jacobian)


@njit(nogil=True)
@no_type_check
def _ray_share(thread, threads, exact, data, spacing, rays, ray_jacobian, images, jacobian):
    poses, channels, rows, columns = images.shape
    value = np.empty(channels)
    slopes = None if jacobian is None else np.empty((channels, 6))
    for item in range(thread, poses * rows, threads):
        pose, row = item // rows, item % rows
        for column in range(columns):
            _walk(exact, data, spacing, rays[pose], row, column, value, slopes, None, None)
            for c in range(channels):
                images[pose, c, row, column] = value[c]
                if jacobian is not None:
                    for p in range(jacobian.shape[2]):
                        derivative = _by_rays(slopes[c], row, column, ray_jacobian[pose, :, p])
                        jacobian[pose, c, p, row, column] = derivative


@njit(nogil=True)
@no_type_check
def _by_rays(slopes, row, column, rays):
    total = 0.0
    for axis in range(3):
        pixel = rays[3 + axis] + column * rays[6 + axis] + row * rays[9 + axis]
        total += slopes[axis] * rays[axis] + slopes[3 + axis] * pixel
    return total


@njit(parallel=True, nogil=True, cache=True, error_model="numpy")
@no_type_check
def ray_pull_back(exact, data, spacing, rays, weights, partial, threads):
    """As ``joseph_pull_back``, into ``partial`` [b, rows, 12]."""
    poses, channels, rows, columns = weights.shape
    for thread in prange(threads):
        value, slopes = np.empty(channels), np.empty((channels, 6))
        for item in range(thread, poses * rows, threads):
            pose, row = item // rows, item % rows
            sums = partial[pose, row]
            for column in range(columns):
                _walk(exact, data, spacing, rays[pose], row, column, value, slopes, None, None)
                for c in range(channels):
                    weight = np.float64(weights[pose, c, row, column])
                    for axis in range(3):
                        by_pixel = weight * slopes[c, 3 + axis]
                        sums[axis] += weight * slopes[c, axis]
                        sums[3 + axis] += by_pixel
                        sums[6 + axis] += by_pixel * column
                        sums[9 + axis] += by_pixel * row


@njit(parallel=True, nogil=True, cache=True, error_model="numpy")
@no_type_check
def ray_adjoint(exact, data, spacing, rays, weights, adjoints):
    """Into ``adjoints`` [n, c, d, h, w], to be summed over n: the weight of every voxel in images times ``weights``."""
    poses, channels, rows, columns = weights.shape
    shares = adjoints.shape[0]
    for share in prange(shares):
        value, weight = np.empty(channels), np.empty(channels)
        for item in range(share, poses * rows, shares):
            pose, row = item // rows, item % rows
            for column in range(columns):
                for c in range(channels):
                    weight[c] = weights[pose, c, row, column]
                _walk(exact, data, spacing, rays[pose], row, column, value, None, adjoints[share], weight)
