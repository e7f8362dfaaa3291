"""Siddon's method (Siddon 1985), walking from voxel to voxel (Amanatides and Woo 1987), in float64."""

import math
from typing import no_type_check

import numpy as np
from numba import njit


@njit(nogil=True, error_model="numpy")
@no_type_check
def siddon(data, spacing, ray, row, column, value, slopes, adjoint, weight):
    """One ray through ``data`` [c, d, h, w]: its integrals into ``value`` [c].

    Unless None: their derivatives by source and pixel (i, j, k each) into ``slopes`` [c, 6], and ``weight`` [c] times
    what each voxel counts, added to ``adjoint`` [c, d, h, w].

    A face of axis x is crossed at t = (face - S_x) / d_x, so dt = ((t - 1) dS_x - t dP_x) / d_x, and the integral
    changes by (what lies before it - what lies behind it) dt.
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
    enter, leave, squared, entered = 0.0, 1.0, 0.0, -1
    for axis in range(3):
        squared += (d[axis] * spacing[axis]) ** 2
        if d[axis] != 0:
            t0, t1 = (-0.5 - ray[axis]) / d[axis], (size[axis] - 0.5 - ray[axis]) / d[axis]
            if min(t0, t1) > enter:
                enter, entered = min(t0, t1), axis
            leave = min(leave, max(t0, t1))
        elif ray[axis] < -0.5 or ray[axis] > size[axis] - 0.5:
            leave = -1.0
    if enter >= leave:
        return
    length = math.sqrt(squared)
    at, step, due, inverse = np.empty(3, np.int64), np.empty(3, np.int64), np.empty(3), np.empty(3)
    for axis in range(3):
        start = ray[axis] + enter * d[axis]
        at[axis] = min(max(math.floor(start + 0.5), 0), size[axis] - 1)
        step[axis] = 1 if d[axis] > 0 else -1
        inverse[axis] = 1 / d[axis] if d[axis] != 0 else np.inf
        due[axis] = (at[axis] + 0.5 * step[axis] - ray[axis]) * inverse[axis] if d[axis] != 0 else np.inf
    if slopes is not None and entered >= 0:
        _cross(slopes, data, at, entered, enter, d, -1.0)
    t = enter
    while True:
        axis = 0 if due[0] <= due[1] else 1
        if due[2] < due[axis]:
            axis = 2
        crossing = min(due[axis], leave)
        if crossing > t:
            for c in range(channels):
                value[c] += (crossing - t) * data[c, at[2], at[1], at[0]]
                if adjoint is not None:
                    adjoint[c, at[2], at[1], at[0]] += (crossing - t) * length * weight[c]
            t = crossing
        if due[axis] > 1:
            break
        if slopes is not None:
            _cross(slopes, data, at, axis, due[axis], d, 1.0)
        if due[axis] >= leave:
            break
        at[axis] += step[axis]
        if at[axis] < 0 or at[axis] >= size[axis]:
            break
        if slopes is not None:
            _cross(slopes, data, at, axis, due[axis], d, -1.0)
        due[axis] = (at[axis] + 0.5 * step[axis] - ray[axis]) * inverse[axis]
    for c in range(channels):
        if slopes is not None:
            for axis in range(3):
                stretched = value[c] * d[axis] * spacing[axis] ** 2 / length
                slopes[c, axis] = length * slopes[c, axis] - stretched
                slopes[c, 3 + axis] = length * slopes[c, 3 + axis] + stretched
        value[c] *= length


@njit(nogil=True, error_model="numpy")
@no_type_check
def _cross(slopes, data, at, axis, t, d, sign):
    """A crossing at ``t`` that ends (sign 1) or begins (-1) the way through the voxel at (i, j, k)."""
    for c in range(data.shape[0]):
        change = sign * data[c, at[2], at[1], at[0]] / d[axis]
        slopes[c, axis] += change * (t - 1)
        slopes[c, 3 + axis] -= change * t
