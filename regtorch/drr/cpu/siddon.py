"""Siddon's method (Siddon 1985), walking from voxel to voxel (Amanatides and Woo 1987), in float64."""

import math
from typing import no_type_check

import numpy as np
from numba import njit


@njit(nogil=True, error_model="numpy")
@no_type_check
def siddon(data, spacing, ray, row, column, value, slopes, adjoint, weight):
    """One ray through ``data`` [c, d, h, w]: its integrals into ``value`` [c].

    Unless None: their derivatives by source and pixel (i, j, k each) go into ``slopes`` [c, 6]. ``weight`` [c] times
    each voxel's length is added to ``adjoint`` [c, d, h, w].

    A face of axis x is crossed at t = (face - S_x) / d_x, so dt = ((t - 1) dS_x - t dP_x) / d_x. The integral changes
    by (value before it - value behind it) dt.
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
    # Scalars, not arrays, and the first class by itself: in registers the walk takes a third of the time.
    i, step_i, inverse_i = _begin(ray[0], d[0], enter, size[0])
    j, step_j, inverse_j = _begin(ray[1], d[1], enter, size[1])
    k, step_k, inverse_k = _begin(ray[2], d[2], enter, size[2])
    due_i = _due(i, step_i, ray[0], inverse_i)
    due_j = _due(j, step_j, ray[1], inverse_j)
    due_k = _due(k, step_k, ray[2], inverse_k)
    if slopes is not None and entered >= 0:
        _cross(slopes, data, (i, j, k), entered, enter, d, -1.0)
    t, first = enter, 0.0
    while True:
        if due_i <= due_j and due_i <= due_k:
            axis, due = 0, due_i
        elif due_j <= due_k:
            axis, due = 1, due_j
        else:
            axis, due = 2, due_k
        crossing = min(due, leave)
        if crossing > t:
            first += (crossing - t) * data[0, k, j, i]
            for c in range(1, channels):
                value[c] += (crossing - t) * data[c, k, j, i]
            if adjoint is not None:
                for c in range(channels):
                    adjoint[c, k, j, i] += (crossing - t) * length * weight[c]
            t = crossing
        if due > 1:
            break
        if slopes is not None:
            _cross(slopes, data, (i, j, k), axis, due, d, 1.0)
        if due >= leave:
            break
        if axis == 0:
            i += step_i
            if i < 0 or i >= size[0]:
                break
            due_i = (i + 0.5 * step_i - ray[0]) * inverse_i
        elif axis == 1:
            j += step_j
            if j < 0 or j >= size[1]:
                break
            due_j = (j + 0.5 * step_j - ray[1]) * inverse_j
        else:
            k += step_k
            if k < 0 or k >= size[2]:
                break
            due_k = (k + 0.5 * step_k - ray[2]) * inverse_k
        if slopes is not None:
            _cross(slopes, data, (i, j, k), axis, due, d, -1.0)
    value[0] = first
    for c in range(channels):
        if slopes is not None:
            for axis in range(3):
                stretched = value[c] * d[axis] * spacing[axis] ** 2 / length
                slopes[c, axis] = length * slopes[c, axis] - stretched
                slopes[c, 3 + axis] = length * slopes[c, 3 + axis] + stretched
        value[c] *= length


@njit(nogil=True, error_model="numpy", inline="always")
@no_type_check
def _begin(source, d, enter, size):
    """Along one axis: the voxel in which a ray enters, which way it goes on, and 1 / d."""
    at = min(max(math.floor(source + enter * d + 0.5), 0), size - 1)
    return at, 1 if d > 0 else -1, 1 / d if d != 0 else np.inf


@njit(nogil=True, error_model="numpy", inline="always")
@no_type_check
def _due(at, step, source, inverse):
    """Where on the ray, 0 at the source and 1 at the pixel, the next face across this axis is; infinity for none."""
    return (at + 0.5 * step - source) * inverse if inverse != np.inf else np.inf


@njit(nogil=True, error_model="numpy")
@no_type_check
def _cross(slopes, data, at, axis, t, d, sign):
    """A crossing at ``t`` that ends (sign 1) or begins (-1) the way through the voxel at (i, j, k)."""
    for c in range(data.shape[0]):
        change = sign * data[c, at[2], at[1], at[0]] / d[axis]
        slopes[c, axis] += change * (t - 1)
        slopes[c, 3 + axis] -= change * t
