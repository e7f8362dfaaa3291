"""Trilinear samples at equal steps on a GPU, for a block of pixels at once."""

from typing import no_type_check

import triton
import triton.language as tl

from regtorch.drr.triton.box import cross_box


@triton.jit
@no_type_check
def trilinear(
    volume, channels, pixels, upstream, si, sj, sk, pi, pj, pk, spacing_i, spacing_j, spacing_k, w, h, d, steps,
    MODE: tl.constexpr,
):  # fmt: skip
    """As ``joseph``, with the same whole numbers of 2^-32 voxels for positions.

    Sample n is at t = enter + (leave - enter) (n + 1/2) / steps, so the samples move with both ends of the span.
    """
    di, dj, dk = pi - si, pj - sj, pk - sk
    enter, leave, enters_by, leaves_by = cross_box(
        si, sj, sk, di, dj, dk, -1.0, w.to(tl.float64), h.to(tl.float64), d.to(tl.float64)
    )
    hits = pixels & (enter < leave)
    step = (leave - enter) / steps
    x, step_x = _walk(si, di, enter, step)
    y, step_y = _walk(sj, dj, enter, step)
    z, step_z = _walk(sk, dk, enter, step)
    mm_i, mm_j, mm_k = di.to(tl.float32) * spacing_i, dj.to(tl.float32) * spacing_j, dk.to(tl.float32) * spacing_k
    length = tl.sqrt(mm_i * mm_i + mm_j * mm_j + mm_k * mm_k)
    weight = length * step.to(tl.float32)
    if MODE == "scatter":
        upstream = upstream * weight[None, :]

    zero = upstream * 0.0
    total, sum_i, sum_j, sum_k, turn_i, turn_j, turn_k = zero, zero, zero, zero, zero, zero, zero
    samples = tl.max(tl.where(hits, steps, 0), 0)
    for n in range(samples):
        i, j, k = (x >> 32).to(tl.int32), (y >> 32).to(tl.int32), (z >> 32).to(tl.int32)
        fi = (x.to(tl.uint32).to(tl.float32) * (1.0 / 4294967296.0))[None, :]
        fj = (y.to(tl.uint32).to(tl.float32) * (1.0 / 4294967296.0))[None, :]
        fk = (z.to(tl.uint32).to(tl.float32) * (1.0 / 4294967296.0))[None, :]
        x += step_x
        y += step_y
        z += step_z
        i0, i1 = hits & (i >= 0) & (i < w), hits & (i >= -1) & (i < w - 1)
        j0, j1, k0, k1 = (j >= 0) & (j < h), (j >= -1) & (j < h - 1), (k >= 0) & (k < d), (k >= -1) & (k < d - 1)
        corner = (k * h + j) * w + i
        value, by_i, by_j, by_k = zero, zero, zero, zero
        for c in tl.static_range(8):
            # The lower neighbour counts 1 - f and the upper one f, of which the signs are the derivatives.
            wi, gi, in_i = (fi, 1.0, i1) if c % 2 == 1 else (1.0 - fi, -1.0, i0)
            wj, gj, in_j = (fj, 1.0, j1) if (c // 2) % 2 == 1 else (1.0 - fj, -1.0, j0)
            wk, gk, in_k = (fk, 1.0, k1) if c // 4 == 1 else (1.0 - fk, -1.0, k0)
            mask = channels & (in_i & in_j & in_k)[None, :]
            at = volume + (corner + (c // 4 * h + (c // 2) % 2) * w + c % 2)[None, :]
            if MODE == "scatter":
                tl.atomic_add(at, (upstream * (wi * wj * wk)).to(tl.int64), mask=mask, sem="relaxed")
            else:
                v = tl.load(at, mask=mask, other=0.0)
                value += v * (wi * wj * wk)
                if MODE == "gradient":
                    by_i += v * (gi * wj * wk)
                    by_j += v * (wi * gj * wk)
                    by_k += v * (wi * wj * gk)
        total += value
        if MODE == "gradient":
            u = (n + 0.5) / steps
            sum_i += by_i
            sum_j += by_j
            sum_k += by_k
            turn_i += u * by_i
            turn_j += u * by_j
            turn_k += u * by_k

    s_i, s_j, s_k, p_i, p_j, p_k = zero, zero, zero, zero, zero, zero
    if MODE == "gradient":
        fi, fj, fk = di.to(tl.float32)[None, :], dj.to(tl.float32)[None, :], dk.to(tl.float32)[None, :]
        all_along = sum_i * fi + sum_j * fj + sum_k * fk
        at_end = turn_i * fi + turn_j * fj + turn_k * fk
        per_span = total * (length / steps)[None, :]
        by_enter = weight[None, :] * (all_along - at_end) - per_span
        by_leave = weight[None, :] * at_end + per_span
        stretch = total * (step.to(tl.float32) / tl.where(length == 0, 1.0, length))[None, :]
        start, end = enter.to(tl.float32)[None, :], leave.to(tl.float32)[None, :]
        by_enter = tl.where(hits[None, :], by_enter, 0.0)
        by_leave = tl.where(hits[None, :], by_leave, 0.0)
        s_i, p_i = _ends(sum_i, turn_i, di, weight, start, end, enters_by == 0, leaves_by == 0, by_enter, by_leave)
        s_j, p_j = _ends(sum_j, turn_j, dj, weight, start, end, enters_by == 1, leaves_by == 1, by_enter, by_leave)
        s_k, p_k = _ends(sum_k, turn_k, dk, weight, start, end, enters_by == 2, leaves_by == 2, by_enter, by_leave)
        long_i, long_j, long_k = (mm_i * spacing_i)[None, :], (mm_j * spacing_j)[None, :], (mm_k * spacing_k)[None, :]
        s_i, s_j, s_k = s_i - stretch * long_i, s_j - stretch * long_j, s_k - stretch * long_k
        p_i, p_j, p_k = p_i + stretch * long_i, p_j + stretch * long_j, p_k + stretch * long_k
    return total * weight[None, :], s_i, s_j, s_k, p_i, p_j, p_k


@triton.jit
@no_type_check
def _walk(source, direction, enter, step):
    """Along one axis: place of the first sample, and step to the next."""
    start = source + (enter + 0.5 * step) * direction
    return (start * 4294967296.0).to(tl.int64), (step * direction * 4294967296.0).to(tl.int64)


@triton.jit
@no_type_check
def _ends(sum_x, turn_x, direction, weight, start, end, enters, leaves, by_enter, by_leave):
    """The derivatives by source and pixel along one axis at constant length; faces move as in ``siddon``."""
    one_over = (1.0 / tl.where(direction == 0, 1.0, direction)).to(tl.float32)
    by_enter = by_enter * tl.where(enters, one_over, 0.0)[None, :]
    by_leave = by_leave * tl.where(leaves, one_over, 0.0)[None, :]
    p = weight[None, :] * (start * sum_x + (end - start) * turn_x)
    s = weight[None, :] * sum_x - p
    return s + by_enter * (start - 1.0) + by_leave * (end - 1.0), p - by_enter * start - by_leave * end
