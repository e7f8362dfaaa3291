"""The adjoint of Joseph's method on a GPU: what a block of pixels adds to the voxels that its rays read."""

from typing import no_type_check

import triton
import triton.language as tl


@triton.jit
@no_type_check
def joseph_adjoint(
    volume, channels, pixels, upstream, si, sj, sk, pi, pj, pk, spacing_i, spacing_j, spacing_k,
    sharp_i, sharp_j, sharp_k, w, h, d,
):  # fmt: skip
    """``upstream`` is added to ``volume``, whole numbers, where projection reads it. All slices: none is empty here.

    Every pixel has its own main axis m and in-plane axes a, b. Where a ray is in a slice is kept as a whole number of
    2^-32 voxels and moved by adding: as cheap as float32, and exact far from the origin, so that no ray reads the cell
    beside its own.
    """
    di, dj, dk = pi - si, pj - sj, pk - sk
    other = tl.maximum(tl.abs(di), tl.abs(dj))
    main_k = tl.abs(dk) > other
    main_j = (tl.abs(dj) > tl.abs(di)) & (tl.abs(dk) <= other)
    main_i = (tl.abs(dj) <= tl.abs(di)) & (tl.abs(dk) <= other)
    along = tl.where(main_k, dk, tl.where(main_j, dj, di))
    source_m = tl.where(main_k, sk, tl.where(main_j, sj, si))
    source_a = tl.where(main_i, sj, si)
    source_b = tl.where(main_k, sj, sk)
    n_m = tl.where(main_k, d, tl.where(main_j, h, w))
    n_a = tl.where(main_i, h, w)
    n_b = tl.where(main_k, h, d)
    stride_m = tl.where(main_k, w * h, tl.where(main_j, w, 1))
    stride_a = tl.where(main_i, w, 1)
    stride_b = tl.where(main_k, w, w * h)
    moves = along != 0
    along = tl.where(moves, along, 1.0)
    one_over_along = 1.0 / along
    slope_a = tl.where(main_i, dj, di) * one_over_along
    slope_b = tl.where(main_k, dj, dk) * one_over_along
    middle = n_m // 2
    from_source = middle.to(tl.float64) - source_m
    middle_a = source_a + from_source * slope_a
    middle_b = source_b + from_source * slope_b
    near = tl.minimum(source_m, source_m + along).to(tl.float32)
    far = tl.maximum(source_m, source_m + along).to(tl.float32)

    first = tl.maximum(near - 0.5, 0.0)
    last = tl.minimum(far + 0.5, n_m - 1.0)
    first, last = _within(first, last, middle, middle_a.to(tl.float32), slope_a.to(tl.float32), n_a)
    first, last = _within(first, last, middle, middle_b.to(tl.float32), slope_b.to(tl.float32), n_b)
    crosses = pixels & moves & (first <= last)
    stop = tl.max(tl.where(crosses, tl.ceil(last), -1.0), 0).to(tl.int32) + 1
    start = tl.minimum(tl.min(tl.where(crosses, tl.floor(first), 1e9), 0).to(tl.int32), stop)

    ahead = (start - middle).to(tl.float64)
    a = ((middle_a + ahead * slope_a) * 4294967296.0).to(tl.int64)
    b = ((middle_b + ahead * slope_b) * 4294967296.0).to(tl.int64)
    step_a = (slope_a * 4294967296.0).to(tl.int64)
    step_b = (slope_b * 4294967296.0).to(tl.int64)

    da, db = slope_a.to(tl.float32), slope_b.to(tl.float32)
    mm_a, mm_b = tl.where(main_i, spacing_j, spacing_i), tl.where(main_k, spacing_j, spacing_k)
    mm_m = tl.where(main_k, spacing_k, tl.where(main_j, spacing_j, spacing_i))
    sharp_a, sharp_b = tl.where(main_i, sharp_j, sharp_i)[None, :], tl.where(main_k, sharp_j, sharp_k)[None, :]
    length = tl.sqrt(da * da * mm_a * mm_a + db * db * mm_b * mm_b + mm_m * mm_m)
    upstream = upstream * length[None, :]

    for k in range(start, stop):
        ia, ib = (a >> 32).to(tl.int32), (b >> 32).to(tl.int32)
        fa = (a.to(tl.uint32).to(tl.float32) * (1.0 / 4294967296.0))[None, :]
        fb = (b.to(tl.uint32).to(tl.float32) * (1.0 / 4294967296.0))[None, :]
        fa, fb = (fa - 0.5) * sharp_a + 0.5, (fb - 0.5) * sharp_b + 0.5
        fa, fb = tl.minimum(tl.maximum(fa, 0.0), 1.0), tl.minimum(tl.maximum(fb, 0.0), 1.0)
        a += step_a
        b += step_b
        share = tl.maximum(tl.minimum(far, k + 0.5) - tl.maximum(near, k - 0.5), 0.0)
        here = crosses & (share > 0) & (k < n_m)
        a0, a1 = here & (ia >= 0) & (ia < n_a), here & (ia >= -1) & (ia < n_a - 1)
        b0, b1 = (ib >= 0) & (ib < n_b), (ib >= -1) & (ib < n_b - 1)
        m00, m01 = channels & (a0 & b0)[None, :], channels & (a1 & b0)[None, :]
        m10, m11 = channels & (a0 & b1)[None, :], channels & (a1 & b1)[None, :]
        at = volume + (k * stride_m + ia * stride_a + ib * stride_b)[None, :]
        right, down = stride_a[None, :], stride_b[None, :]
        share = share[None, :]
        upper, lower = upstream * share * (1.0 - fb), upstream * share * fb
        tl.atomic_add(at, (upper * (1.0 - fa)).to(tl.int64), mask=m00, sem="relaxed")
        tl.atomic_add(at + right, (upper * fa).to(tl.int64), mask=m01, sem="relaxed")
        tl.atomic_add(at + down, (lower * (1.0 - fa)).to(tl.int64), mask=m10, sem="relaxed")
        tl.atomic_add(at + down + right, (lower * fa).to(tl.int64), mask=m11, sem="relaxed")


@triton.jit
@no_type_check
def _within(first, last, middle, at_middle, slope, n):
    """The slices where a ray is between -1 and n of an in-plane axis; a hundredth wider, for float32 rounds."""
    slope = tl.where(tl.abs(slope) < 1e-20, 1e-20, slope)
    one = (-1.01 - at_middle) / slope + middle
    other = (n + 0.01 - at_middle) / slope + middle
    return tl.maximum(first, tl.minimum(one, other)), tl.minimum(last, tl.maximum(one, other))
