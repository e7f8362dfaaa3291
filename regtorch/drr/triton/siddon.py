"""Siddon's method on a GPU: every pixel of a block walks from voxel to voxel (Amanatides and Woo 1987), in float64."""

from typing import no_type_check

import triton
import triton.language as tl

from regtorch.drr.triton.box import cross_box


@triton.jit
@no_type_check
def siddon(
    volume, channels, pixels, upstream, si, sj, sk, pi, pj, pk, spacing_i, spacing_j, spacing_k, w, h, d,
    MODE: tl.constexpr,
):  # fmt: skip
    """As ``joseph``. A face crossed at t moves by (t - 1) / d with the source and by -t / d with the pixel."""
    di, dj, dk = pi - si, pj - sj, pk - sk
    enter, leave, came_by, _ = cross_box(si, sj, sk, di, dj, dk, -0.5, w - 0.5, h - 0.5, d - 0.5)
    active = pixels & (enter < leave)
    i, step_i, due_i, count_i = _begin(si, di, enter, leave, w)
    j, step_j, due_j, count_j = _begin(sj, dj, enter, leave, h)
    k, step_k, due_k, count_k = _begin(sk, dk, enter, leave, d)
    mm_i, mm_j, mm_k = di.to(tl.float32) * spacing_i, dj.to(tl.float32) * spacing_j, dk.to(tl.float32) * spacing_k
    length = tl.sqrt(mm_i * mm_i + mm_j * mm_j + mm_k * mm_k)

    zero = upstream * 0.0
    total, out_i, out_j, out_k, turn_i, turn_j, turn_k = zero, zero, zero, zero, zero, zero, zero
    t = enter
    # Two more, for the voxels where a ray enters and leaves are known up to rounding.
    crossings = tl.max(tl.where(active, count_i + count_j + count_k + 3, 0), 0)
    for _ in range(crossings):
        due = tl.minimum(tl.minimum(due_i, due_j), due_k)
        axis = tl.where(due_i == due, 0, tl.where(due_j == due, 1, 2))
        goes_by = tl.where(due <= leave, axis, -1)
        after = tl.maximum(t, tl.minimum(due, leave))
        at = volume + ((k * h + j) * w + i)[None, :]
        mask = channels & active[None, :]
        part = (after - t).to(tl.float32)
        if MODE == "scatter":
            tl.atomic_add(at, (upstream * (length * part)[None, :]).to(tl.int64), mask=mask, sem="relaxed")
        else:
            value = tl.load(at, mask=mask, other=0.0)
            total += value * part[None, :]
            if MODE == "gradient":
                t0, t1 = t.to(tl.float32), after.to(tl.float32)
                went, turned = _faces(came_by, goes_by, t0, t1, 0)
                out_i += value * went
                turn_i += value * turned
                went, turned = _faces(came_by, goes_by, t0, t1, 1)
                out_j += value * went
                turn_j += value * turned
                went, turned = _faces(came_by, goes_by, t0, t1, 2)
                out_k += value * went
                turn_k += value * turned
        t, came_by = after, goes_by
        i += tl.where(axis == 0, step_i, 0)
        j += tl.where(axis == 1, step_j, 0)
        k += tl.where(axis == 2, step_k, 0)
        active = active & (due < leave) & (i >= 0) & (i < w) & (j >= 0) & (j < h) & (k >= 0) & (k < d)
        due_i = tl.where(axis == 0, _due(si, di, i, step_i), due_i)
        due_j = tl.where(axis == 1, _due(sj, dj, j, step_j), due_j)
        due_k = tl.where(axis == 2, _due(sk, dk, k, step_k), due_k)

    s_i, s_j, s_k, p_i, p_j, p_k = zero, zero, zero, zero, zero, zero
    if MODE == "gradient":
        stretch = total / tl.where(length == 0, 1.0, length)[None, :]
        s_i, p_i = _ends(out_i, turn_i, di, length, stretch * (mm_i * spacing_i)[None, :])
        s_j, p_j = _ends(out_j, turn_j, dj, length, stretch * (mm_j * spacing_j)[None, :])
        s_k, p_k = _ends(out_k, turn_k, dk, length, stretch * (mm_k * spacing_k)[None, :])
    return total * length[None, :], s_i, s_j, s_k, p_i, p_j, p_k


@triton.jit
@no_type_check
def _begin(source, direction, enter, leave, n):
    """Of one axis: the first voxel, the way, the t where it ends, and how many more there are."""
    first = tl.floor(source + enter * direction + 0.5)
    last = tl.floor(source + leave * direction + 0.5)
    first = tl.minimum(tl.maximum(first, 0.0), n - 1.0).to(tl.int32)
    last = tl.minimum(tl.maximum(last, 0.0), n - 1.0).to(tl.int32)
    step = tl.where(direction > 0, 1, -1)
    return first, step, _due(source, direction, first, step), tl.abs(last - first)


@triton.jit
@no_type_check
def _due(source, direction, index, step):
    """The t where a ray leaves a voxel by this axis; beyond every ray where it never does."""
    flat = direction == 0
    face = index.to(tl.float64) + 0.5 * step.to(tl.float64)
    return tl.where(flat, 2.0, (face - source) / tl.where(flat, 1.0, direction))


@triton.jit
@no_type_check
def _faces(came_by, goes_by, t0, t1, AXIS: tl.constexpr):
    """The weight of a voxel of value one among the faces of one axis, and the same times t."""
    came, goes = tl.where(came_by == AXIS, 1.0, 0.0), tl.where(goes_by == AXIS, 1.0, 0.0)
    return (goes - came)[None, :], (goes * t1 - came * t0)[None, :]


@triton.jit
@no_type_check
def _ends(out, turn, direction, length, by_length):
    """The derivatives by source and pixel along one axis."""
    one_over = (1.0 / tl.where(direction == 0, 1.0, direction)).to(tl.float32)
    scale = (length * one_over)[None, :]
    return (turn - out) * scale - by_length, by_length - turn * scale
