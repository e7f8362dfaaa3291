"""Where rays enter and leave a box, in float64."""

from typing import no_type_check

import triton
import triton.language as tl


@triton.jit
@no_type_check
def cross_box(si, sj, sk, di, dj, dk, lower, upper_i, upper_j, upper_k):
    """The t in [0, 1] where s + t d enters and leaves a box, and the axis of either face.

    The axis is -1 where the ray starts or ends inside. Where a ray misses the box both t are the same.
    """
    in_i, out_i, hit_i = _cross_slab(si, di, lower, upper_i)
    in_j, out_j, hit_j = _cross_slab(sj, dj, lower, upper_j)
    in_k, out_k, hit_k = _cross_slab(sk, dk, lower, upper_k)
    latest = tl.maximum(tl.maximum(in_i, in_j), in_k)
    earliest = tl.minimum(tl.minimum(out_i, out_j), out_k)
    enter = tl.minimum(tl.maximum(latest, 0.0), 1.0)
    leave = tl.minimum(tl.maximum(earliest, 0.0), 1.0)
    leave = tl.where(hit_i & hit_j & hit_k, tl.maximum(enter, leave), enter)
    enters_by = tl.where(latest > 0, tl.where(in_i == latest, 0, tl.where(in_j == latest, 1, 2)), -1)
    leaves_by = tl.where(earliest < 1, tl.where(out_i == earliest, 0, tl.where(out_j == earliest, 1, 2)), -1)
    return enter, leave, enters_by, leaves_by


@triton.jit
@no_type_check
def _cross_slab(source, direction, lower, upper):
    flat = direction == 0
    step = tl.where(flat, 1.0, direction)
    one, other = (lower - source) / step, (upper - source) / step
    hit = (direction != 0) | ((one <= 0) & (other >= 0))
    return tl.where(flat, 0.0, tl.minimum(one, other)), tl.where(flat, 1.0, tl.maximum(one, other)), hit
