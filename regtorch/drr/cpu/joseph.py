"""Joseph's method (Joseph 1982) over tiles of pixels: values, and their derivatives by a ray's ends.

A tile's rays are followed together, slice by slice across their main axis m. The whole tile lies between its four
corner rays. Four reads of a summed-area table of "anything here" tell whether a slice can be skipped. Three loops do
the rest; the first and the last become vector instructions: positions and offsets; reads, one group of four voxels
each; sums.

On slice k a ray is at (a0 + k da, b0 + k db). Its integral is L T, T = sum of f over slices, L the length per slice.
Let f_a and f_b be the derivatives of a bilinear value. The sums of f_a, f_b, (k - S_m) f_a and (k - S_m) f_b give the
derivative by source S and pixel P: take da = (P_a - S_a) / D, D = P_m - S_m, and a0 = S_a - S_m da. Then
d a(k) = dS_a - da dS_m + (k - S_m) d da and d da = (dP_a - dS_a - da (dP_m - dS_m)) / D. For precision the moments
are taken about the middle of the volume and moved to the source at the end.
"""

import math
from typing import no_type_check

import numpy as np
from numba import njit

from regtorch.drr.cpu.scratch import (
    A0,
    AT_HIGH,
    AT_LOW,
    B0,
    COLUMN,
    DA,
    DB,
    END,
    FA,
    FB,
    MOMENT_A,
    MOMENT_B,
    PER_CHANNEL,
    PIXEL_A,
    PIXEL_B,
    PIXEL_M,
    ROW,
    SHARE,
    SLICES,
    SOURCE_A,
    SOURCE_B,
    SOURCE_M,
    TILE_COLUMNS,
    TOTAL,
    TOTAL_A,
    TOTAL_B,
    N,
)
from regtorch.drr.cpu.slices import BLOCK, BORDER

_SLICE = np.arange(SLICES, dtype=np.float32)
_SHIFT, _NEXT = np.int32(BLOCK.bit_length() - 1), np.int32(1)  # blocks are powers of two
_LOW_A, _HIGH_A, _LOW_B, _HIGH_B, _INSIDE = (SLICES * i for i in range(5))


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
@no_type_check
def follow(stacks, spacing, main, ray, row0, column0, rows, room, slopes):
    """``rows`` rows of a tile, or one pixel if 0, along one main axis.

    Values of channel c go into the scratch at TOTAL + c N. Derivatives by source and pixel, along ``in_plane(main)``
    and ``main``, go into ``slopes`` at c PER_CHANNEL + SOURCE_A ... PIXEL_M, unless that is None.
    """
    s, offset, groups, four, boxes = room
    all_groups, all_tables, sizes = stacks
    stack, tables = all_groups[main], all_tables[main]
    ia, ib = in_plane(main)
    zero, half, one = np.float32(0), np.float32(0.5), np.float32(1)
    sharp_a, sharp_b = np.float32(spacing[3 + ia]), np.float32(spacing[3 + ib])
    sharp = sharp_a > one or sharp_b > one
    stride = np.uint32(sizes[main][0])
    a_end, b_end = np.float32(sizes[main][0] - 2), np.float32(sizes[main][1] - 2)
    pixels = max(rows * TILE_COLUMNS, 1)
    count = np.uint64(pixels)
    _ends(ray, main, row0, column0, count, s)
    if slopes is None:
        _rays(ray, ia, ib, main, row0, column0, count, s)
    else:
        sums, exact = slopes
        _rays(ray, ia, ib, main, row0, column0, count, exact)
        for q in range(4 * N):
            s[q] = np.float32(exact[q])
    channels = stack.shape[0]
    for c in range(channels):
        for q in range(count):
            s[TOTAL + c * N + q] = zero
        if slopes is not None:
            sums[c * PER_CHANNEL : (c + 1) * PER_CHANNEL] = zero
    q1, q2, q3 = min(TILE_COLUMNS, pixels) - 1, max(pixels - TILE_COLUMNS, 0), pixels - 1  # the corners, with 0
    source, middle = np.float32(ray[main]), np.float32(stack.shape[1] // 2)
    near, far = min(s[END], s[END + q1]), max(s[END], s[END + q1])
    near, far = min(near, min(s[END + q2], s[END + q3])), max(far, max(s[END + q2], s[END + q3]))
    # Slices that any ray reaches, and those that every ray crosses in full.
    start = int(max(math.floor(min(source, near) + half), zero))
    stop = int(min(math.ceil(max(source, far) + half), np.float32(stack.shape[1])))
    first_whole = (source if source < near else far) + half
    last_whole = (near if source < near else source) - half
    for first in range(start, stop, SLICES):
        some = min(SLICES, stop - first)
        _boxes(np.float32(first), some, q1, q2, q3, a_end, b_end, tables.shape[3] - 1, tables.shape[2] - 1, s, boxes)
        for i in range(some):
            slice_index = first + i
            k = np.float32(slice_index)
            located = False
            for c in range(channels):
                if _is_empty(tables[c, slice_index], boxes, i):
                    continue
                whole = first_whole <= k <= last_whole
                if not located:
                    located = True
                    inside = boxes[_INSIDE + i] != 0
                    if slopes is None:
                        _locate(k, count, stride, a_end, b_end, inside, s, s, offset)
                    else:
                        _locate(float(slice_index), count, stride, a_end, b_end, inside, exact, s, offset)
                    if not whole:
                        _shares(k, source, count, s)
                values = stack[c, slice_index]
                for q in range(count):
                    groups[q] = values[np.uint64(offset[q])]
                if sharp:
                    _sharpen(s, four, count, sharp_a, sharp_b)
                if slopes is None:
                    if whole:
                        for q in range(count):
                            s[TOTAL + c * N + q] += _value(s, four, q)
                    else:
                        for q in range(count):
                            s[TOTAL + c * N + q] += s[SHARE + q] * _value(s, four, q)
                else:
                    if whole:
                        for q in range(count):
                            _add(s, sums, four, c, q, one, k - middle)
                    else:
                        for q in range(count):
                            _add(s, sums, four, c, q, s[SHARE + q], k - middle)
                        _add_ends(s, sums, four, c, k, source, count)
    if slopes is None:
        _lengthen(ia, ib, main, spacing, channels, count, s)
    else:
        _finish(ia, ib, main, spacing, source, middle, channels, count, s, sums)


@njit(nogil=True, inline="always")
@no_type_check
def in_plane(main):
    """The axes a and b of slices across ``main``."""
    return (0 if main != 0 else 1), (2 if main != 2 else 1)


@njit(nogil=True, fastmath={"contract"})
@no_type_check
def _ends(ray, im, row0, column0, count, s):
    """On which slice rays' pixels lie."""
    end = ray[3 + im] + column0 * ray[6 + im] + row0 * ray[9 + im]
    for q in range(count):
        s[END + q] = np.float32(end + COLUMN[q] * ray[6 + im] + ROW[q] * ray[9 + im])


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
@no_type_check
def _rays(ray, ia, ib, im, row0, column0, count, rays):
    """Where rays are on slice 0, from its border, and per slice, in float32 or float64."""
    source_a, source_b, source_m = ray[ia], ray[ib], ray[im]
    along = ray[3 + im] + column0 * ray[6 + im] + row0 * ray[9 + im] - source_m
    across_a = ray[3 + ia] + column0 * ray[6 + ia] + row0 * ray[9 + ia] - source_a
    across_b = ray[3 + ib] + column0 * ray[6 + ib] + row0 * ray[9 + ib] - source_b
    for q in range(count):
        row, column = ROW[q], COLUMN[q]
        per_slice = 1 / (along + column * ray[6 + im] + row * ray[9 + im])
        da = (across_a + column * ray[6 + ia] + row * ray[9 + ia]) * per_slice
        db = (across_b + column * ray[6 + ib] + row * ray[9 + ib]) * per_slice
        rays[A0 + q], rays[DA + q] = source_a - source_m * da + BORDER, da
        rays[B0 + q], rays[DB + q] = source_b - source_m * db + BORDER, db


@njit(nogil=True, fastmath={"contract"})
@no_type_check
def _boxes(first, count, q1, q2, q3, a_end, b_end, most_a, most_b, s, boxes):
    """Between which blocks of ``count`` slices from ``first`` on a tile's rays lie: the same where it holds none."""
    one = np.float32(1)
    a0, a1, a2, a3 = s[A0], s[A0 + q1], s[A0 + q2], s[A0 + q3]
    b0, b1, b2, b3 = s[B0], s[B0 + q1], s[B0 + q2], s[B0 + q3]
    da0, da1, da2, da3 = s[DA], s[DA + q1], s[DA + q2], s[DA + q3]
    db0, db1, db2, db3 = s[DB], s[DB + q1], s[DB + q2], s[DB + q3]
    most_a, most_b = np.int32(most_a), np.int32(most_b)
    for i in range(np.uint64(count)):
        k = first + _SLICE[i]
        a_low = min(min(a0 + k * da0, a1 + k * da1), min(a2 + k * da2, a3 + k * da3))
        a_high = max(max(a0 + k * da0, a1 + k * da1), max(a2 + k * da2, a3 + k * da3))
        b_low = min(min(b0 + k * db0, b1 + k * db1), min(b2 + k * db2, b3 + k * db3))
        b_high = max(max(b0 + k * db0, b1 + k * db1), max(b2 + k * db2, b3 + k * db3))
        outside = (a_high <= one) | (b_high <= one) | (a_low >= a_end) | (b_low >= b_end)
        inside = (a_low >= one) & (b_low >= one) & (a_high <= a_end) & (b_high <= b_end)
        al, ah = _block(a_low, a_end), _block(a_high, a_end) + _NEXT
        bl, bh = _block(b_low, b_end), _block(b_high, b_end) + _NEXT
        boxes[_LOW_A + i] = al
        boxes[_LOW_B + i] = bl
        boxes[_HIGH_A + i] = al if outside else min(ah, most_a)
        boxes[_HIGH_B + i] = bl if outside else min(bh, most_b)
        boxes[_INSIDE + i] = inside


@njit(nogil=True, inline="always")
@no_type_check
def _block(place, end):
    return np.int32(min(max(place, np.float32(0)), end)) >> _SHIFT


@njit(nogil=True, inline="always")
@no_type_check
def _is_empty(table, boxes, i):
    al, ah = np.uint64(boxes[_LOW_A + i]), np.uint64(boxes[_HIGH_A + i])
    bl, bh = np.uint64(boxes[_LOW_B + i]), np.uint64(boxes[_HIGH_B + i])
    return table[bh, ah] - table[bl, ah] - table[bh, al] + table[bl, al] == 0


@njit(nogil=True, fastmath={"contract"})
@no_type_check
def _locate(k, count, stride, a_end, b_end, inside, rays, s, offset):
    """Cells and places in them on slice k, from rays in float32 or float64; at its border for a ray beyond it."""
    if inside:
        for q in range(count):
            _place(rays[A0 + q] + k * rays[DA + q], rays[B0 + q] + k * rays[DB + q], q, stride, s, offset)
    else:
        zero = np.float32(0)
        for q in range(count):
            a = min(max(rays[A0 + q] + k * rays[DA + q], zero), a_end)
            b = min(max(rays[B0 + q] + k * rays[DB + q], zero), b_end)
            _place(a, b, q, stride, s, offset)


@njit(nogil=True, inline="always", fastmath={"contract"})
@no_type_check
def _place(a, b, q, stride, s, offset):
    column, row = np.floor(a), np.floor(b)
    s[FA + q], s[FB + q] = np.float32(a - column), np.float32(b - row)
    offset[q] = np.uint32(np.int32(row)) * stride + np.uint32(np.int32(column))


@njit(nogil=True)
@no_type_check
def _shares(k, source, count, s):
    """Slice k stands for the slab from k - 1/2 to k + 1/2, of which only the part between source and pixel counts."""
    half, zero = np.float32(0.5), np.float32(0)
    for q in range(count):
        end = s[END + q]
        s[SHARE + q] = max(min(k + half, max(source, end)) - max(k - half, min(source, end)), zero)


@njit(nogil=True, fastmath={"contract"})
@no_type_check
def _sharpen(s, four, count, sharp_a, sharp_b):
    """Groups of which bilinear interpolation has, where the ray is, the value and slopes of sharper voxels."""
    zero, half, one = np.float32(0), np.float32(0.5), np.float32(1)
    for q in range(count):
        fa, fb = s[FA + q], s[FB + q]
        a, b = (fa - half) * sharp_a + half, (fb - half) * sharp_b + half
        slope_a = sharp_a if zero <= a < one else zero
        slope_b = sharp_b if zero <= b < one else zero
        a0, b0 = min(max(a, zero), one) - fa * slope_a, min(max(b, zero), one) - fb * slope_b
        v00, v10, v01, v11 = four[4 * q], four[4 * q + 1], four[4 * q + 2], four[4 * q + 3]
        upper, lower = v01 - v00, v11 - v10
        u0, l0 = v00 + a0 * upper, v10 + a0 * lower
        u1, l1 = u0 + slope_a * upper, l0 + slope_a * lower
        four[4 * q], four[4 * q + 1] = u0 + b0 * (l0 - u0), u0 + (b0 + slope_b) * (l0 - u0)
        four[4 * q + 2], four[4 * q + 3] = u1 + b0 * (l1 - u1), u1 + (b0 + slope_b) * (l1 - u1)


@njit(nogil=True, inline="always")
@no_type_check
def _value(s, four, q):
    v00, v10, v01, v11 = four[4 * q], four[4 * q + 1], four[4 * q + 2], four[4 * q + 3]
    upper = v00 + s[FA + q] * (v01 - v00)
    lower = v10 + s[FA + q] * (v11 - v10)
    return upper + s[FB + q] * (lower - upper)


@njit(nogil=True, inline="always")
@no_type_check
def _add(s, slopes, four, c, q, share, from_middle):
    v00, v10, v01, v11 = four[4 * q], four[4 * q + 1], four[4 * q + 2], four[4 * q + 3]
    upper_step, lower_step = v01 - v00, v11 - v10
    upper = v00 + s[FA + q] * upper_step
    lower = v10 + s[FA + q] * lower_step
    along_a = share * (upper_step + s[FB + q] * (lower_step - upper_step))
    along_b = share * (lower - upper)
    at = c * PER_CHANNEL + q
    s[TOTAL + c * N + q] += share * (upper + s[FB + q] * (lower - upper))
    slopes[TOTAL_A + at] += along_a
    slopes[TOTAL_B + at] += along_b
    slopes[MOMENT_A + at] += from_middle * along_a
    slopes[MOMENT_B + at] += from_middle * along_b


@njit(nogil=True)
@no_type_check
def _add_ends(s, slopes, four, c, k, source, count):
    """The slice's share when a source or pixel inside it moves along the main axis."""
    half, zero = np.float32(0.5), np.float32(0)
    for q in range(count):
        value = _value(s, four, q) if s[SHARE + q] > zero else zero
        end = s[END + q]
        if max(source, end) < k + half:
            slopes[AT_HIGH + c * PER_CHANNEL + q] += value
        if min(source, end) > k - half:
            slopes[AT_LOW + c * PER_CHANNEL + q] += value


@njit(nogil=True, fastmath={"contract"})
@no_type_check
def _lengthen(ia, ib, im, spacing, channels, count, s):
    """Sums into integrals."""
    size_a, size_b, size_m = np.float32(spacing[ia] ** 2), np.float32(spacing[ib] ** 2), np.float32(spacing[im] ** 2)
    for c in range(channels):
        for q in range(count):
            da, db = s[DA + q], s[DB + q]
            s[TOTAL + c * N + q] *= math.sqrt(da * da * size_a + db * db * size_b + size_m)


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
@no_type_check
def _finish(ia, ib, im, spacing, source, middle, channels, count, s, slopes):
    """Sums into integrals and derivatives."""
    one, zero = np.float32(1), np.float32(0)
    size_a, size_b = np.float32(spacing[ia] ** 2), np.float32(spacing[ib] ** 2)
    for c in range(channels):
        at = c * PER_CHANNEL
        for q in range(count):
            da, db = s[DA + q], s[DB + q]
            length = math.sqrt(da * da * size_a + db * db * size_b + np.float32(spacing[im] ** 2))
            total = s[TOTAL + c * N + q]
            along, lever = s[END + q] - source, middle - source
            moment_a = slopes[at + MOMENT_A + q] + lever * slopes[at + TOTAL_A + q]
            moment_b = slopes[at + MOMENT_B + q] + lever * slopes[at + TOTAL_B + q]
            over_a = (length * moment_a + total * da * size_a / length) / along
            over_b = (length * moment_b + total * db * size_b / length) / along
            sum_a, sum_b = length * slopes[at + TOTAL_A + q], length * slopes[at + TOTAL_B + q]
            high, low = length * slopes[at + AT_HIGH + q], -length * slopes[at + AT_LOW + q]
            turned = over_a * da + over_b * db
            forward = one if along > zero else zero
            slopes[at + SOURCE_A + q] = sum_a - over_a
            slopes[at + SOURCE_B + q] = sum_b - over_b
            slopes[at + SOURCE_M + q] = turned - sum_a * da - sum_b * db + forward * low + (one - forward) * high
            slopes[at + PIXEL_A + q] = over_a
            slopes[at + PIXEL_B + q] = over_b
            slopes[at + PIXEL_M + q] = forward * high + (one - forward) * low - turned
            s[TOTAL + c * N + q] = length * total
