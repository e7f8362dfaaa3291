"""One tile of an image and of its Jacobian by Joseph's method, for rays along any axes."""

from typing import no_type_check

import numpy as np
from numba import njit

from regtorch.drr.cpu.joseph import follow, in_plane
from regtorch.drr.cpu.scratch import (
    DERIVATIVE,
    PER_CHANNEL,
    PIXEL_A,
    PIXEL_B,
    PIXEL_M,
    SOURCE_A,
    SOURCE_B,
    SOURCE_M,
    TILE_COLUMNS,
    TOTAL,
    N,
    X,
    Y,
)

_MIXED = -1


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
@no_type_check
def paint(stacks, spacing, ray, ray_jacobian, place, room, slopes, image, jacobian, top, left):
    """One tile of an image [c, h, w] with first pixel (top, left), and of its Jacobian [c, p, h, w] unless it is None.

    ``place`` is the tile's first row, last row + 1, first column, last column + 1.
    """
    row0, row1, column0, column1 = place
    main = _main_axis(ray, row0, column0)
    for row in (row0, row1 - 1):
        if not main == _main_axis(ray, row, column0) == _main_axis(ray, row, column0 + TILE_COLUMNS - 1):
            main = _MIXED
    if main != _MIXED:
        main %= 3
        follow(stacks, spacing, main, ray, row0, column0, row1 - row0, room, slopes)
        _put(main, ray_jacobian, row0, row1, column0, column1, room[0], slopes, image, jacobian, top, left)
        return
    for row in range(row0, row1):
        for column in range(column0, column1):
            main = _main_axis(ray, row, column) % 3
            follow(stacks, spacing, main, ray, row, column, 0, room, slopes)
            _put(main, ray_jacobian, row, row + 1, column, column + 1, room[0], slopes, image, jacobian, top, left)


@njit(nogil=True, error_model="numpy")
@no_type_check
def _main_axis(ray, row, column):
    """The axis nearest to one ray, plus 3 where the ray runs down it."""
    best, main = -1.0, 0
    for axis in range(3):
        along = ray[3 + axis] + column * ray[6 + axis] + row * ray[9 + axis] - ray[axis]
        if abs(along) > best:
            best, main = abs(along), axis if along > 0 else axis + 3
    return main


@njit(nogil=True, fastmath={"contract"})
@no_type_check
def _put(main, ray_jacobian, row0, row1, column0, column1, s, slopes, image, jacobian, top, left):
    """Copy from the scratch into images. With P = F + column C + row R, d/dp = gS dS/dp + gP dP/dp."""
    ia, ib = in_plane(main)
    count = np.uint64((row1 - row0) * TILE_COLUMNS)
    for c in range(image.shape[0]):
        _copy(s, TOTAL + c * N, row0 - top, row1 - top, column0 - left, column1 - left, image[c])
        if slopes is not None:
            at, sums = c * PER_CHANNEL, slopes[0]
            for p in range(jacobian.shape[1]):
                by_p = ray_jacobian[:, p]
                s_a, s_b, s_m = np.float32(by_p[ia]), np.float32(by_p[ib]), np.float32(by_p[main])
                p_a, across_a, down_a = _pixel(by_p, ia, row0, column0)
                p_b, across_b, down_b = _pixel(by_p, ib, row0, column0)
                p_m, across_m, down_m = _pixel(by_p, main, row0, column0)
                for q in range(count):
                    x, y = X[q], Y[q]
                    s[DERIVATIVE + q] = (
                        sums[at + SOURCE_A + q] * s_a
                        + sums[at + SOURCE_B + q] * s_b
                        + sums[at + SOURCE_M + q] * s_m
                        + sums[at + PIXEL_A + q] * (p_a + x * across_a + y * down_a)
                        + sums[at + PIXEL_B + q] * (p_b + x * across_b + y * down_b)
                        + sums[at + PIXEL_M + q] * (p_m + x * across_m + y * down_m)
                    )
                _copy(s, DERIVATIVE, row0 - top, row1 - top, column0 - left, column1 - left, jacobian[c, p])


@njit(nogil=True)
@no_type_check
def _copy(s, first, row0, row1, column0, column1, image):
    for row in range(row0, row1):
        line, values = image[row, column0:], s[first + (row - row0) * TILE_COLUMNS :]
        if column1 - column0 == TILE_COLUMNS:  # a count known to the compiler makes this one instruction
            for x in range(TILE_COLUMNS):
                line[x] = values[x]
        else:
            for x in range(column1 - column0):
                line[x] = values[x]


@njit(nogil=True, inline="always")
@no_type_check
def _pixel(by_p, axis, row, column):
    """Motion of the pixel (row, column) along an axis, and the increments to the next pixel in its row and column."""
    across, down = by_p[6 + axis], by_p[9 + axis]
    return np.float32(by_p[3 + axis] + column * across + row * down), np.float32(across), np.float32(down)
