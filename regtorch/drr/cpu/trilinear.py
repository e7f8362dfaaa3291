"""Trilinear samples at equal steps of at most half a voxel, where a ray is within a voxel of the volume."""

import math
from typing import no_type_check

import numpy as np
from numba import njit


@njit(nogil=True, error_model="numpy")
@no_type_check
def trilinear(data, spacing, ray, row, column, value, slopes, adjoint, weight):
    """One ray, with the arguments of ``siddon`` and the samples of the reference, in float64.

    With t = enter + (leave - enter) u a sample at u moves by (1 - t) dS + t dP + d ((1 - u) d enter + u d leave).
    """
    size = (data.shape[3], data.shape[2], data.shape[1])
    d = (
        ray[3] + column * ray[6] + row * ray[9] - ray[0],
        ray[4] + column * ray[7] + row * ray[10] - ray[1],
        ray[5] + column * ray[8] + row * ray[11] - ray[2],
    )
    channels = data.shape[0]
    value[:] = 0
    if slopes is not None:
        slopes[:] = 0
    enter, leave, squared, entered, left = 0.0, 1.0, 0.0, -1, -1
    for axis in range(3):
        squared += (d[axis] * spacing[axis]) ** 2
        if d[axis] != 0:
            t0, t1 = (-1.0 - ray[axis]) / d[axis], (size[axis] - ray[axis]) / d[axis]
            if min(t0, t1) > enter:
                enter, entered = min(t0, t1), axis
            if max(t0, t1) < leave:
                leave, left = max(t0, t1), axis
        elif ray[axis] < -1.0 or ray[axis] > size[axis]:
            leave = -1.0
    if enter >= leave:
        return
    length = math.sqrt(squared)
    steps = 2 * int(math.sqrt((size[0] + 1.0) ** 2 + (size[1] + 1.0) ** 2 + (size[2] + 1.0) ** 2)) + 2
    step = (leave - enter) / steps
    near, far = np.zeros(channels), np.zeros(channels)
    for n in range(steps):
        u = (n + 0.5) / steps
        t = enter + (leave - enter) * u
        x, y, z = ray[0] + t * d[0], ray[1] + t * d[1], ray[2] + t * d[2]
        i, j, k = math.floor(x), math.floor(y), math.floor(z)
        fx, fy, fz = x - i, y - j, z - k
        for corner in range(8):
            ci, cj, ck = i + (corner & 1), j + ((corner >> 1) & 1), k + (corner >> 2)
            if not (0 <= ci < size[0] and 0 <= cj < size[1] and 0 <= ck < size[2]):
                continue
            wx, sx = (fx, 1.0) if corner & 1 else (1 - fx, -1.0)
            wy, sy = (fy, 1.0) if corner & 2 else (1 - fy, -1.0)
            wz, sz = (fz, 1.0) if corner & 4 else (1 - fz, -1.0)
            for c in range(channels):
                voxel = data[c, ck, cj, ci]
                value[c] += wx * wy * wz * voxel
                if adjoint is not None:
                    adjoint[c, ck, cj, ci] += wx * wy * wz * step * length * weight[c]
                if slopes is not None:
                    gx, gy, gz = sx * wy * wz * voxel, wx * sy * wz * voxel, wx * wy * sz * voxel
                    slopes[c, 0] += (1 - t) * gx
                    slopes[c, 1] += (1 - t) * gy
                    slopes[c, 2] += (1 - t) * gz
                    slopes[c, 3] += t * gx
                    slopes[c, 4] += t * gy
                    slopes[c, 5] += t * gz
                    along = gx * d[0] + gy * d[1] + gz * d[2]
                    near[c] += (1 - u) * along
                    far[c] += u * along
    for c in range(channels):
        if slopes is not None:
            for axis in range(3):
                stretched = step * value[c] * d[axis] * spacing[axis] ** 2 / length
                slopes[c, axis] = length * step * slopes[c, axis] - stretched
                slopes[c, 3 + axis] = length * step * slopes[c, 3 + axis] + stretched
            if entered >= 0:
                by_enter = length * (step * near[c] - value[c] / steps) / d[entered]
                slopes[c, entered] += by_enter * (enter - 1)
                slopes[c, 3 + entered] -= by_enter * enter
            if left >= 0:
                by_leave = length * (step * far[c] + value[c] / steps) / d[left]
                slopes[c, left] += by_leave * (leave - 1)
                slopes[c, 3 + left] -= by_leave * leave
        value[c] *= length * step
