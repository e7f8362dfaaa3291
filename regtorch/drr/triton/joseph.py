"""Joseph's method on a GPU: the slices that a tile of rays finds empty are skipped.

A tile's rays are followed together along their main axis m. Between its four corner rays lies the whole tile, so four
reads of a summed-area table tell whether a slice holds anything for it. All slices are looked at as one vector; the
numbers of those that count are compacted to a list in memory, which the tile then walks along. The border of air around
each slice makes every read valid.
"""

from typing import no_type_check

import triton
import triton.language as tl


SLICES_AT_ONCE = tl.constexpr(128)  # looked at together
_MARGIN = tl.constexpr(0.01)  # voxels, for rounding in float32
_FLOOR = tl.constexpr(8388607.5)  # 2^23 - 1/2


@triton.jit
@no_type_check
def joseph(
    slices, tables, numbers, twelve, grid, channel, channels, row0, column0, last_row, last_column, row, column, w, h, d,
    BLOCK: tl.constexpr, BORDER: tl.constexpr, SHARP: tl.constexpr, GRADIENT: tl.constexpr, PIXELS: tl.constexpr,
):  # fmt: skip
    """Per pixel: the line integral, and its derivative by source and pixel where ``GRADIENT``.

    ``row0`` to ``last_row`` and ``column0`` to ``last_column`` are the corners of the tile, ``row`` and ``column`` its
    pixels in float64. Rays of a tile that all run along one axis the same way are followed along that; else along each
    axis in turn those whose it is.
    """
    top, left = row0.to(tl.float64), column0.to(tl.float64)
    bottom, right = last_row.to(tl.float64), last_column.to(tl.float64)
    corner = _main_axis(twelve, top, left)
    uniform = (corner == _main_axis(twelve, top, right)) & (corner == _main_axis(twelve, bottom, left))
    uniform = uniform & (corner == _main_axis(twelve, bottom, right))
    own = _main_axis(twelve, row, column) % 3
    zero = tl.zeros([PIXELS], tl.float32)
    integral, s_i, s_j, s_k, p_i, p_j, p_k = zero, zero, zero, zero, zero, zero, zero
    first = tl.where(uniform, corner % 3, 0)
    end = tl.where(uniform, corner % 3 + 1, 3)
    for axis in range(first, end):
        value, s_a, s_b, s_m, p_a, p_b, p_m = _along(
            slices, tables, numbers, twelve, grid, channel, channels, axis, uniform, uniform | (own == axis),
            top, left, bottom, right, row, column, w, h, d, BLOCK, BORDER, SHARP, GRADIENT, PIXELS,
        )  # fmt: skip
        integral += value
        if GRADIENT:
            s_i += tl.where(axis == 0, s_m, s_a)
            s_j += tl.where(axis == 1, s_m, tl.where(axis == 0, s_a, s_b))
            s_k += tl.where(axis == 2, s_m, s_b)
            p_i += tl.where(axis == 0, p_m, p_a)
            p_j += tl.where(axis == 1, p_m, tl.where(axis == 0, p_a, p_b))
            p_k += tl.where(axis == 2, p_m, p_b)
    return integral, s_i, s_j, s_k, p_i, p_j, p_k


@triton.jit
@no_type_check
def _along(
    slices, tables, numbers, twelve, grid, channel, channels, axis, uniform, mine, top, left, bottom, right, row, column,
    w, h, d,
    BLOCK: tl.constexpr, BORDER: tl.constexpr, SHARP: tl.constexpr, GRADIENT: tl.constexpr, PIXELS: tl.constexpr,
):  # fmt: skip
    """The rays that are ``mine`` along one axis; nothing for all others. Derivatives along a, b and m.

    Values need positions in float32, counted from the middle slice. Slopes jump from cell to cell, so for them positions
    are whole numbers of 2^-32 voxels.
    """
    ia, ib = tl.where(axis == 0, 1, 0), tl.where(axis == 2, 1, 2)
    n_m, n_a, n_b = _size(axis, w, h, d), _size(ia, w, h, d), _size(ib, w, h, d)
    stride = n_a + 2 * BORDER
    area = stride * (n_b + 2 * BORDER)
    stack = slices + (_before(axis, w, h, d, 2 * BORDER) * channels + channel * n_m.to(tl.int64) * area)
    middle = n_m // 2
    source_a, source_b, source_m = tl.load(twelve + ia), tl.load(twelve + ib), tl.load(twelve + axis)
    from_source = middle.to(tl.float64) - source_m
    start_a, start_b = source_a + BORDER, source_b + BORDER

    count, clipped = _list_slices(
        tables, numbers, twelve, channel, channels, axis, ia, ib, uniform, top, left, bottom, right, w, h, d,
        BLOCK, BORDER,
    )  # fmt: skip

    along = _direction(twelve, axis, row, column)
    mine = mine & (along != 0)
    along = tl.where(mine, along, 1.0)
    one_over_along = 1.0 / along
    slope_a = _direction(twelve, ia, row, column) * one_over_along
    slope_b = _direction(twelve, ib, row, column) * one_over_along
    middle_a, middle_b = start_a + from_source * slope_a, start_b + from_source * slope_b
    near = tl.where(mine, tl.minimum(source_m, source_m + along), 1e30).to(tl.float32)
    far = tl.where(mine, tl.maximum(source_m, source_m + along), -1e30).to(tl.float32)
    da, db = slope_a.to(tl.float32), slope_b.to(tl.float32)
    a0, b0 = middle_a.to(tl.float32), middle_b.to(tl.float32)
    if GRADIENT:
        exact_a, exact_b = (middle_a * 4294967296.0).to(tl.int64), (middle_b * 4294967296.0).to(tl.int64)
        step_a, step_b = (slope_a * 4294967296.0).to(tl.int64), (slope_b * 4294967296.0).to(tl.int64)
    if SHARP:
        sharp_a, sharp_b = _number(grid + 3 + ia), _number(grid + 3 + ib)

    zero = tl.zeros([PIXELS], tl.float32)
    total, sum_a, sum_b, turn_a, turn_b, at_near, at_far = zero, zero, zero, zero, zero, zero, zero
    coming = tl.load(numbers).to(tl.int32)
    for n in range(count):
        m = coming
        coming = tl.load(numbers + n + 1).to(tl.int32)  # one more is read than there are
        if GRADIENT:
            ahead = (m - middle).to(tl.int64)
            place_a, place_b = exact_a + ahead * step_a, exact_b + ahead * step_b
            ja, jb = (place_a >> 32).to(tl.int32), (place_b >> 32).to(tl.int32)
            ja, jb = tl.minimum(tl.maximum(ja, 0), n_a + BORDER), tl.minimum(tl.maximum(jb, 0), n_b + BORDER)
            fa = place_a.to(tl.uint32).to(tl.float32) * (1.0 / 4294967296.0)
            fb = place_b.to(tl.uint32).to(tl.float32) * (1.0 / 4294967296.0)
        else:
            ahead = (m - middle).to(tl.float32)
            ja, fa = _cell(a0 + ahead * da, n_a + BORDER)
            jb, fb = _cell(b0 + ahead * db, n_b + BORDER)
        if SHARP:
            fa, fb = (fa - 0.5) * sharp_a + 0.5, (fb - 0.5) * sharp_b + 0.5
            steep_a = tl.where((fa >= 0) & (fa < 1), sharp_a, 0.0)
            steep_b = tl.where((fb >= 0) & (fb < 1), sharp_b, 0.0)
            fa, fb = tl.minimum(tl.maximum(fa, 0.0), 1.0), tl.minimum(tl.maximum(fb, 0.0), 1.0)
        upper_left = stack + m.to(tl.int64) * area + (jb * stride + ja)
        v00, v01 = tl.load(upper_left), tl.load(upper_left + 1)
        v10, v11 = tl.load(upper_left + stride), tl.load(upper_left + stride + 1)
        upper, lower = v00 + fa * (v01 - v00), v10 + fa * (v11 - v10)
        value = upper + fb * (lower - upper)
        share = zero + 1.0
        if clipped:
            share = tl.maximum(tl.minimum(far, m + 0.5) - tl.maximum(near, m - 0.5), 0.0)
        total += share * value
        if GRADIENT:
            by_a = share * ((v01 - v00) + fb * ((v11 - v10) - (v01 - v00)))
            by_b = share * (lower - upper)
            if SHARP:
                by_a, by_b = by_a * steep_a, by_b * steep_b
            distance = (m - middle).to(tl.float32)
            sum_a += by_a
            sum_b += by_b
            turn_a += distance * by_a
            turn_b += distance * by_b
            if clipped:
                at_far += tl.where((share > 0) & (far < m + 0.5), value, 0.0)
                at_near += tl.where((share > 0) & (near > m - 0.5), value, 0.0)

    mm_a, mm_b, mm_m = _number(grid + ia), _number(grid + ib), _number(grid + axis)
    length = tl.sqrt(da * da * mm_a * mm_a + db * db * mm_b * mm_b + mm_m * mm_m)
    s_a, s_b, s_m, p_a, p_b, p_m = zero, zero, zero, zero, zero, zero
    if GRADIENT:
        from_source, one_over = from_source.to(tl.float32), one_over_along.to(tl.float32)
        stretch = total / length
        by_slope_a = length * (turn_a + from_source * sum_a) + stretch * da * (mm_a * mm_a)
        by_slope_b = length * (turn_b + from_source * sum_b) + stretch * db * (mm_b * mm_b)
        p_a, p_b = by_slope_a * one_over, by_slope_b * one_over
        s_a, s_b = length * sum_a - p_a, length * sum_b - p_b
        forward = along > 0  # the pixel is the far end
        p_m = length * tl.where(forward, at_far, -at_near) - (p_a * da + p_b * db)
        s_m = length * tl.where(forward, -at_near, at_far) - (s_a * da + s_b * db)
    return total * length, s_a, s_b, s_m, p_a, p_b, p_m


@triton.jit
@no_type_check
def _list_slices(
    tables, numbers, twelve, channel, channels, axis, ia, ib, uniform, top, left, bottom, right, w, h, d,
    BLOCK: tl.constexpr, BORDER: tl.constexpr,
):  # fmt: skip
    """The slices that hold anything between the corner rays, to ``numbers``; how many, and whether rays end in any.

    The corners enclose rays along other axes or the other way round nowhere: then whole slices count.
    """
    n_m, n_a, n_b = _size(axis, w, h, d), _size(ia, w, h, d), _size(ib, w, h, d)
    wide = (n_a + 2 * BORDER + BLOCK - 2) // BLOCK + 1
    high = (n_b + 2 * BORDER + BLOCK - 2) // BLOCK + 1
    before = _blocks_before(axis, w, h, d, BLOCK, BORDER)
    table = tables + (before * channels + channel * n_m.to(tl.int64) * (wide * high))
    source = tl.load(twelve + axis).to(tl.float32)
    middle = n_m // 2
    a00, da00, b00, db00, end00 = _corner(twelve, axis, ia, ib, middle, top, left, BORDER)
    a01, da01, b01, db01, end01 = _corner(twelve, axis, ia, ib, middle, top, right, BORDER)
    a10, da10, b10, db10, end10 = _corner(twelve, axis, ia, ib, middle, bottom, left, BORDER)
    a11, da11, b11, db11, end11 = _corner(twelve, axis, ia, ib, middle, bottom, right, BORDER)
    first_end = tl.minimum(tl.minimum(end00, end01), tl.minimum(end10, end11))
    last_end = tl.maximum(tl.maximum(end00, end01), tl.maximum(end10, end11))
    near, far = tl.minimum(source, first_end) - _MARGIN, tl.maximum(source, last_end) + _MARGIN
    whole_from, whole_to = tl.minimum(source, last_end) + _MARGIN, tl.maximum(source, first_end) - _MARGIN
    clipped = (uniform == 0) | (whole_from > -0.5) | (whole_to < n_m - 0.5)

    tl.debug_barrier()  # the list of another axis has been read
    count = 0
    for begin in range(0, n_m, SLICES_AT_ONCE):
        m = begin + tl.arange(0, SLICES_AT_ONCE)
        ahead = (m - middle).to(tl.float32)
        low_a = tl.minimum(tl.minimum(a00 + ahead * da00, a01 + ahead * da01), tl.minimum(a10 + ahead * da10, a11 + ahead * da11))
        top_a = tl.maximum(tl.maximum(a00 + ahead * da00, a01 + ahead * da01), tl.maximum(a10 + ahead * da10, a11 + ahead * da11))
        low_b = tl.minimum(tl.minimum(b00 + ahead * db00, b01 + ahead * db01), tl.minimum(b10 + ahead * db10, b11 + ahead * db11))
        top_b = tl.maximum(tl.maximum(b00 + ahead * db00, b01 + ahead * db01), tl.maximum(b10 + ahead * db10, b11 + ahead * db11))
        low_a, top_a = tl.where(uniform, low_a - _MARGIN, 0.0), tl.where(uniform, top_a + _MARGIN, 1e9)
        low_b, top_b = tl.where(uniform, low_b - _MARGIN, 0.0), tl.where(uniform, top_b + _MARGIN, 1e9)
        la, ha = _block(low_a, n_a, BLOCK, BORDER), _block(top_a, n_a, BLOCK, BORDER) + 1
        lb, hb = _block(low_b, n_b, BLOCK, BORDER), _block(top_b, n_b, BLOCK, BORDER) + 1
        there = (m < n_m) & (m + 0.5 > near) & (m - 0.5 < far)
        at = table + m.to(tl.int64) * (wide * high)
        found = tl.load(at + hb * wide + ha, there, 0) - tl.load(at + lb * wide + ha, there, 0)
        found -= tl.load(at + hb * wide + la, there, 0) - tl.load(at + lb * wide + la, there, 0)
        one = tl.where(found > 0, 1, 0)
        tl.store(numbers + (count + tl.cumsum(one, 0) - one), m.to(tl.int16), found > 0)
        count += tl.sum(one, 0)
    tl.debug_barrier()
    return count, clipped


@triton.jit
@no_type_check
def _corner(twelve, axis, ia, ib, middle, row, column, BORDER: tl.constexpr):
    """Of one ray in float32: its place on the middle slice and its slope along a and b, and where its pixel is on m."""
    along = _direction(twelve, axis, row, column)
    end = (tl.load(twelve + axis) + along).to(tl.float32)
    one_over = 1.0 / tl.where(along == 0, 1.0, along).to(tl.float32)
    from_source = (middle.to(tl.float64) - tl.load(twelve + axis)).to(tl.float32)
    da = _direction(twelve, ia, row, column).to(tl.float32) * one_over
    db = _direction(twelve, ib, row, column).to(tl.float32) * one_over
    a = tl.load(twelve + ia).to(tl.float32) + BORDER + from_source * da
    b = tl.load(twelve + ib).to(tl.float32) + BORDER + from_source * db
    return a, da, b, db, end


@triton.jit
@no_type_check
def _direction(twelve, axis, row, column):
    """From the source to pixels, along one axis, in float64."""
    step = column * tl.load(twelve + 6 + axis) + row * tl.load(twelve + 9 + axis)
    return tl.load(twelve + 3 + axis) + step - tl.load(twelve + axis)


@triton.jit
@no_type_check
def _main_axis(twelve, row, column):
    """The axis nearest to rays, plus 3 where a ray runs down it."""
    i, j, k = _direction(twelve, 0, row, column), _direction(twelve, 1, row, column), _direction(twelve, 2, row, column)
    is_k = tl.abs(k) > tl.maximum(tl.abs(i), tl.abs(j))
    is_j = tl.abs(j) > tl.abs(i)
    along = tl.where(is_k, k, tl.where(is_j, j, i))
    return tl.where(is_k, 2, tl.where(is_j, 1, 0)) + tl.where(along > 0, 0, 3)


@triton.jit
@no_type_check
def _cell(place, last):
    """The cell and the fraction in it, clamped to the border of air; an integer is the end of a cell or a beginning."""
    place = tl.minimum(tl.maximum(place, 1.0), last.to(tl.float32))
    whole = place + _FLOOR
    return whole.to(tl.int32, bitcast=True) & 0x7FFFFF, place - (whole - 8388608.0)


@triton.jit
@no_type_check
def _block(place, n, BLOCK: tl.constexpr, BORDER: tl.constexpr):
    return tl.minimum(tl.maximum(place, 0.0), (n + BORDER).to(tl.float32)).to(tl.int32) // BLOCK


@triton.jit
@no_type_check
def _size(axis, w, h, d):
    return tl.where(axis == 0, w, tl.where(axis == 1, h, d))


@triton.jit
@no_type_check
def _before(axis, w, h, d, MORE: tl.constexpr):
    """How many voxels one class's slices across the axes before this one have, borders and all."""
    across_i = w.to(tl.int64) * (h + MORE) * (d + MORE)
    across_j = h.to(tl.int64) * (w + MORE) * (d + MORE)
    return tl.where(axis > 0, across_i, 0) + tl.where(axis > 1, across_j, 0)


@triton.jit
@no_type_check
def _blocks_before(axis, w, h, d, BLOCK: tl.constexpr, BORDER: tl.constexpr):
    """As ``_before``, entries of their tables."""
    i = (w + 2 * BORDER + BLOCK - 2) // BLOCK + 1
    j = (h + 2 * BORDER + BLOCK - 2) // BLOCK + 1
    k = (d + 2 * BORDER + BLOCK - 2) // BLOCK + 1
    return tl.where(axis > 0, w.to(tl.int64) * (j * k), 0) + tl.where(axis > 1, h.to(tl.int64) * (i * k), 0)


@triton.jit
@no_type_check
def _number(at):
    return tl.load(at).to(tl.float32)
