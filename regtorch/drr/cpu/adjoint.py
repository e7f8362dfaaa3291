"""The adjoint of Joseph's method: the weight of every voxel in weighted images."""

import math
from typing import no_type_check

import numpy as np
from numba import njit, prange


@njit(parallel=True, nogil=True, cache=True, error_model="numpy")
@no_type_check
def joseph_adjoint(spacing, rays, weights, adjoints):
    """Into ``adjoints`` [n, c, d, h, w], to be summed over n, for ``weights`` [b, c, h, w] of the images' pixels."""
    poses, _, rows, columns = weights.shape
    shares = adjoints.shape[0]
    for share in prange(shares):
        for item in range(share, poses * rows, shares):
            pose, row = item // rows, item % rows
            for column in range(columns):
                _spread(adjoints[share], spacing, rays[pose], row, column, weights[pose, :, row, column])


@njit(nogil=True, error_model="numpy")
@no_type_check
def _spread(volume, spacing, ray, row, column, weight):
    d = (
        ray[3] + column * ray[6] + row * ray[9] - ray[0],
        ray[4] + column * ray[7] + row * ray[10] - ray[1],
        ray[5] + column * ray[8] + row * ray[11] - ray[2],
    )
    m = 0
    for axis in range(1, 3):
        if abs(d[axis]) > abs(d[m]):
            m = axis
    ia, ib = (0 if m != 0 else 1), (2 if m != 2 else 1)
    size = (volume.shape[3], volume.shape[2], volume.shape[1])
    da, db = d[ia] / d[m], d[ib] / d[m]
    length = math.sqrt((da * spacing[ia]) ** 2 + (db * spacing[ib]) ** 2 + spacing[m] ** 2)
    low, high = min(ray[m], ray[m] + d[m]), max(ray[m], ray[m] + d[m])
    at = np.empty(3, np.int64)
    for k in range(max(math.floor(low + 0.5), 0), min(math.floor(high + 0.5) + 1, size[m])):
        counted = (min(k + 0.5, high) - max(k - 0.5, low)) * length
        a, b = ray[ia] + (k - ray[m]) * da, ray[ib] + (k - ray[m]) * db
        a0, b0 = math.floor(a), math.floor(b)
        if counted <= 0 or a0 < -1 or b0 < -1 or a0 >= size[ia] or b0 >= size[ib]:
            continue
        at[m] = k
        fa = min(max((a - a0 - 0.5) * spacing[3 + ia] + 0.5, 0.0), 1.0)
        fb = min(max((b - b0 - 0.5) * spacing[3 + ib] + 0.5, 0.0), 1.0)
        for corner in range(4):
            at[ia], at[ib] = a0 + (corner & 1), b0 + (corner >> 1)
            if 0 <= at[ia] < size[ia] and 0 <= at[ib] < size[ib]:
                by_a = fa if corner & 1 else 1 - fa
                by_b = fb if corner >> 1 else 1 - fb
                for c in range(volume.shape[0]):
                    volume[c, at[2], at[1], at[0]] += by_a * by_b * counted * weight[c]
