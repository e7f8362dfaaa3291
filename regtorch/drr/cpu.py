"""Fused CPU projectors: Joseph's method over tiles of pixels that skip empty slices, and Siddon's ray by ray.

Joseph: a tile's rays are followed together, slice by slice across their main axis. Between the four corner rays lies
the whole tile, so a summed-area table of "anything here" tells in four reads whether a slice can be skipped. What is
left is computed in two loops: the first, of positions, the compiler turns into vector instructions; the second reads
the four neighbours and adds.
"""

import math
from typing import no_type_check

import numpy as np
import torch
from jaxtyping import Float
from numba import get_num_threads, njit, prange
from torch import Tensor
from torch.utils.weak import WeakTensorKeyDictionary

_TILE_ROWS, _TILE_COLUMNS = 8, 16
_BLOCK = 4
_MIXED = -1

_prepared = WeakTensorKeyDictionary()


def why_not(data: Tensor, method: str, needs_gradient: bool) -> str:
    """What keeps this backend from rendering; empty when nothing does."""
    if method not in ("joseph", "siddon"):
        return f"method {method!r}, expected 'joseph' or 'siddon'"
    if needs_gradient:
        return "a gradient is asked for, expected none"
    if data.device.type != "cpu" or data.dtype != torch.float32:
        return f"a volume of {data.dtype} on {data.device}, expected torch.float32 on cpu"
    return ""


def project(
    data: Float[Tensor, "d h w"],
    rays: Float[Tensor, "b 12"],
    spacing_mm: Float[Tensor, "3"],
    rows: int,
    columns: int,
    method: str,
) -> Float[Tensor, "b rows columns"]:
    """Line integrals for twelve numbers per pose, in float32."""
    images = torch.empty(len(rays), rows, columns)
    twelve, spacing = rays.numpy(), spacing_mm.numpy()
    chunks = 16 * get_num_threads()
    if method == "siddon":
        _siddon(data.contiguous().numpy(), spacing, twelve, images.numpy(), chunks)
    else:
        axis = _main_axes(twelve, rows, columns)
        needed = range(3) if (axis == _MIXED).any() else set(axis.tolist())
        stacks = [_slices(data, a) if a in needed else _NOTHING for a in range(3)]
        slices, tables = zip(*stacks, strict=True)
        _joseph(slices, tables, spacing, twelve, axis, images.numpy(), chunks)
    return images


def _main_axes(rays: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """The axis that all rays of a pose run along most; its corner rays enclose the others."""
    source, first, column_step, row_step = rays.reshape(-1, 4, 3).transpose(1, 0, 2)
    corners = [first + c * column_step + r * row_step - source for r in (0, rows - 1) for c in (0, columns - 1)]
    directions = np.stack(corners)
    axis = np.abs(directions).argmax(axis=2)
    sign = np.take_along_axis(directions, axis[..., None], axis=2)[..., 0] > 0
    same = (axis == axis[0]).all(axis=0) & (sign == sign[0]).all(axis=0)
    return np.where(same, axis[0], _MIXED)


def _slices(data: Tensor, axis: int) -> tuple[np.ndarray, np.ndarray]:
    """The volume as slices across an axis with a border of air, and their tables; kept as long as the volume lives."""
    version, kept = _prepared.get(data, (None, {}))
    if data.is_inference():  # torch does not count the changes of such a tensor
        kept = {}
    elif version != data._version:
        kept = {}
        _prepared[data] = (data._version, kept)
    if axis not in kept:
        across = np.moveaxis(data.numpy(), 2 - axis, 0)
        slices = np.ascontiguousarray(np.pad(across, ((0, 0), (1, 2), (1, 2))))
        kept[axis] = slices, _occupancy(slices)
    return kept[axis]


def _occupancy(slices: np.ndarray) -> np.ndarray:
    """Per slice, a summed-area table over blocks of cells between four voxels: 1 where any of these is not zero."""
    occupied = slices != 0
    cells = occupied[:, :-1, :-1] | occupied[:, 1:, :-1] | occupied[:, :-1, 1:] | occupied[:, 1:, 1:]
    n, h, w = cells.shape
    cells = np.pad(cells, ((0, 0), (0, -h % _BLOCK), (0, -w % _BLOCK)))
    blocks = cells.reshape(n, cells.shape[1] // _BLOCK, _BLOCK, -1, _BLOCK).any(axis=(2, 4))
    return np.pad(blocks.cumsum(axis=1, dtype=np.int32).cumsum(axis=2, dtype=np.int32), ((0, 0), (1, 0), (1, 0)))


_NOTHING = np.zeros((0, 3, 3), np.float32), np.zeros((0, 1, 1), np.int32)


@njit(parallel=True, nogil=True, cache=True, error_model="numpy", fastmath={"contract"})
@no_type_check
def _joseph(slices, tables, spacing, rays, axis, images, chunks):
    poses, rows, columns = images.shape
    bands = (rows + _TILE_ROWS - 1) // _TILE_ROWS
    items = poses * bands
    for chunk in prange(chunks):
        scratch = _scratch()
        for item in range(chunk, items, chunks):
            pose = item // bands
            row0 = (item % bands) * _TILE_ROWS
            row1 = min(row0 + _TILE_ROWS, rows)
            for column0 in range(0, columns, _TILE_COLUMNS):
                column1 = min(column0 + _TILE_COLUMNS, columns)
                image, ray, main = images[pose], rays[pose], axis[pose]
                if main != _MIXED:
                    _tile_along(main, slices, tables, spacing, ray, row0, row1, column0, column1, scratch, image)
                else:
                    for row in range(row0, row1):
                        for column in range(column0, column1):
                            main = _main_axis(ray, row, column)
                            _tile_along(
                                main, slices, tables, spacing, ray, row, row + 1, column, column + 1, scratch, image
                            )


@njit(nogil=True)
@no_type_check
def _scratch():
    n = _TILE_ROWS * _TILE_COLUMNS
    return (
        np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.float32),
        np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.float32),
        np.empty(n, np.float32), np.empty(n, np.uint32),
    )  # fmt: skip


@njit(nogil=True, error_model="numpy")
@no_type_check
def _main_axis(ray, row, column):
    best, main = -1.0, 0
    for axis in range(3):
        along = abs(ray[3 + axis] + column * ray[6 + axis] + row * ray[9 + axis] - ray[axis])
        if along > best:
            best, main = along, axis
    return main


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
@no_type_check
def _tile_along(main, slices, tables, spacing, ray, row0, row1, column0, column1, scratch, image):
    if main == 0:
        _tile(slices[0], tables[0], spacing, 1, 2, 0, ray, row0, row1, column0, column1, scratch, image)
    elif main == 1:
        _tile(slices[1], tables[1], spacing, 0, 2, 1, ray, row0, row1, column0, column1, scratch, image)
    else:
        _tile(slices[2], tables[2], spacing, 0, 1, 2, ray, row0, row1, column0, column1, scratch, image)


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
@no_type_check
def _tile(slices, table, spacing, ia, ib, im, ray, row0, row1, column0, column1, scratch, image):
    """Rays of one tile, all along axis ``im``: on slice k a ray is at (a0 + k da, b0 + k db)."""
    a0, da, b0, db, low, high, total, fa, fb, offset = scratch
    zero, half = np.float32(0), np.float32(0.5)
    a_end, b_end = np.float32(slices.shape[2] - 2), np.float32(slices.shape[1] - 2)
    source_a, source_b, source_m = ray[ia], ray[ib], ray[im]
    p = 0
    first, last = np.inf, -np.inf  # of the slices that any ray reaches ...
    first_whole, last_whole = -np.inf, np.inf  # ... and that every ray crosses in full
    for row in range(row0, row1):
        for column in range(column0, column1):
            along = ray[3 + im] + column * ray[6 + im] + row * ray[9 + im] - source_m
            ka = (ray[3 + ia] + column * ray[6 + ia] + row * ray[9 + ia] - source_a) / along
            kb = (ray[3 + ib] + column * ray[6 + ib] + row * ray[9 + ib] - source_b) / along
            a0[p], da[p] = np.float32(source_a - source_m * ka + 1), np.float32(ka)  # 1: the border of air
            b0[p], db[p] = np.float32(source_b - source_m * kb + 1), np.float32(kb)
            near, far = min(source_m, source_m + along), max(source_m, source_m + along)
            low[p], high[p] = np.float32(near), np.float32(far)
            first, last = min(first, near), max(last, far)
            first_whole, last_whole = max(first_whole, near + 0.5), min(last_whole, far - 0.5)
            total[p] = zero
            p += 1
    count, stride = np.uint64(p), np.uint64(slices.shape[2])
    q1, q2, q3 = column1 - column0 - 1, p - (column1 - column0), p - 1
    start = int(max(math.floor(first + 0.5), 0.0))
    stop = int(min(math.ceil(last + 0.5), float(slices.shape[0])))
    for slice_index in range(start, stop):
        k = np.float32(slice_index)
        a_low = min(min(a0[0] + k * da[0], a0[q1] + k * da[q1]), min(a0[q2] + k * da[q2], a0[q3] + k * da[q3]))
        a_high = max(max(a0[0] + k * da[0], a0[q1] + k * da[q1]), max(a0[q2] + k * da[q2], a0[q3] + k * da[q3]))
        b_low = min(min(b0[0] + k * db[0], b0[q1] + k * db[q1]), min(b0[q2] + k * db[q2], b0[q3] + k * db[q3]))
        b_high = max(max(b0[0] + k * db[0], b0[q1] + k * db[q1]), max(b0[q2] + k * db[q2], b0[q3] + k * db[q3]))
        if a_high <= zero or b_high <= zero or a_low >= a_end or b_low >= b_end:
            continue
        al, ah = int(max(a_low, zero)) // _BLOCK, int(min(a_high, a_end)) // _BLOCK + 1
        bl, bh = int(max(b_low, zero)) // _BLOCK, int(min(b_high, b_end)) // _BLOCK + 1
        ah, bh = min(ah, table.shape[2] - 1), min(bh, table.shape[1] - 1)
        row_of_table = table[slice_index]
        if row_of_table[bh, ah] - row_of_table[bl, ah] - row_of_table[bh, al] + row_of_table[bl, al] == 0:
            continue
        for q in range(count):
            a = min(max(a0[q] + k * da[q], zero), a_end)
            b = min(max(b0[q] + k * db[q], zero), b_end)
            column, row = np.int32(a), np.int32(b)
            fa[q], fb[q] = a - np.float32(column), b - np.float32(row)
            offset[q] = np.uint32(row) * np.uint32(stride) + np.uint32(column)
        values = slices[slice_index].ravel()
        if first_whole <= slice_index <= last_whole:
            for q in range(count):
                total[q] += _bilinear(values, np.uint64(offset[q]), stride, fa[q], fb[q])
        else:
            for q in range(count):
                share = max(min(k + half, high[q]) - max(k - half, low[q]), zero)
                total[q] += share * _bilinear(values, np.uint64(offset[q]), stride, fa[q], fb[q])
    p = 0
    for row in range(row0, row1):
        for column in range(column0, column1):
            per_slice = (da[p] * spacing[ia]) ** 2 + (db[p] * spacing[ib]) ** 2 + spacing[im] ** 2
            image[row, column] = total[p] * np.float32(math.sqrt(per_slice))
            p += 1


@njit(nogil=True, inline="always")
@no_type_check
def _bilinear(values, at, stride, fa, fb):
    one = np.uint64(1)
    v00, v01 = values[at], values[at + one]
    v10, v11 = values[at + stride], values[at + stride + one]
    upper = v00 + fa * (v01 - v00)
    lower = v10 + fa * (v11 - v10)
    return upper + fb * (lower - upper)


@njit(parallel=True, nogil=True, cache=True, error_model="numpy")
@no_type_check
def _siddon(data, spacing, rays, images, chunks):
    """Siddon 1985, walking from voxel to voxel (Amanatides and Woo 1987), in float64."""
    poses, rows, columns = images.shape
    size = (data.shape[2], data.shape[1], data.shape[0])
    for chunk in prange(chunks):
        at, step = np.empty(3, np.int64), np.empty(3, np.int64)
        due, d = np.empty(3), np.empty(3)
        for item in range(chunk, poses * rows, chunks):
            pose, row = item // rows, item % rows
            ray = rays[pose]
            for column in range(columns):
                enter, leave, squared = 0.0, 1.0, 0.0
                for axis in range(3):
                    d[axis] = ray[3 + axis] + column * ray[6 + axis] + row * ray[9 + axis] - ray[axis]
                    squared += (d[axis] * spacing[axis]) ** 2
                    if d[axis] != 0:
                        t0, t1 = (-0.5 - ray[axis]) / d[axis], (size[axis] - 0.5 - ray[axis]) / d[axis]
                        enter, leave = max(enter, min(t0, t1)), min(leave, max(t0, t1))
                    elif ray[axis] < -0.5 or ray[axis] > size[axis] - 0.5:
                        leave = -1.0
                if enter >= leave:
                    images[pose, row, column] = 0
                    continue
                for axis in range(3):
                    start = ray[axis] + enter * d[axis]
                    at[axis] = min(max(math.floor(start + 0.5), 0), size[axis] - 1)
                    step[axis] = 1 if d[axis] > 0 else -1
                    due[axis] = np.inf
                    if d[axis] != 0:
                        due[axis] = (at[axis] + 0.5 * step[axis] - ray[axis]) / d[axis]
                total, t = 0.0, enter
                while True:
                    axis = 0 if due[0] <= due[1] else 1
                    if due[2] < due[axis]:
                        axis = 2
                    crossing = min(due[axis], leave)
                    if crossing > t:
                        total += (crossing - t) * data[at[2], at[1], at[0]]
                        t = crossing
                    if due[axis] >= leave:
                        break
                    at[axis] += step[axis]
                    if at[axis] < 0 or at[axis] >= size[axis]:
                        break
                    due[axis] = (at[axis] + 0.5 * step[axis] - ray[axis]) / d[axis]
                images[pose, row, column] = total * math.sqrt(squared)
