"""Joseph's method on a GPU: the slices that a tile of rays finds empty are skipped.

A tile's rays are followed together along their main axis m. Between its four corner rays lies the whole tile, so four
reads of a summed-area table tell whether a slice holds anything for it. All slices are looked at as one vector; the
numbers of those that count are compacted to a list in memory, which the tile then walks along. The border of air around
each slice makes every read valid.

What is one number for a whole tile, ``survey`` finds beforehand, for many tiles at once, in float64: every thread of a
tile's program would else do it again.
"""

from typing import no_type_check

import triton
import triton.language as tl

RECORD = tl.constexpr(32)
"""Numbers of a tile's record, of which the last are not used."""

_SLICES_AT_ONCE = tl.constexpr(128)
_MARGIN = tl.constexpr(0.01)  # voxels, for rounding in float32
_FLOOR = tl.constexpr(8388607.5)  # 2^23 - 1/2
_NO_CELL = tl.constexpr(0x4B000000)  # 2^23 as float32
_EVERYWHERE = tl.constexpr(1e9)
_MIXED = tl.constexpr(-1)

# Of a record, in fours: the axis, between which slices rays run, and whether any ends in the volume or leaves it
# sideways; of the first ray its place on the middle slice and its slope along a and b; its way and its end along m, and
# the steps to the next column and row along m; these along a and b; and place and slope of the planes that enclose the
# tile.
_AXIS, _NEAR, _FAR, _CAREFUL = tl.constexpr(0), tl.constexpr(1), tl.constexpr(2), tl.constexpr(3)
_A, _DA, _B, _DB = tl.constexpr(4), tl.constexpr(5), tl.constexpr(6), tl.constexpr(7)
_ALONG, _END, _ACROSS_M, _DOWN_M = tl.constexpr(8), tl.constexpr(9), tl.constexpr(10), tl.constexpr(11)
_ACROSS_A, _DOWN_A, _ACROSS_B, _DOWN_B = tl.constexpr(12), tl.constexpr(13), tl.constexpr(14), tl.constexpr(15)
_LOW_A, _HIGH_A, _LOW_B, _HIGH_B = tl.constexpr(16), tl.constexpr(18), tl.constexpr(20), tl.constexpr(22)


@triton.jit
@no_type_check
def survey(record, twelve, there, top, left, bottom, right, w, h, d, BORDER: tl.constexpr):
    """The records of many tiles, each of one pose, whose corners are given in float64.

    The lowest of several lines is concave, so that between the first slice and the last no ray is below the chord.
    Rays that do not all run along one axis the same way may leave what their corners enclose: the tile is mixed.
    """
    axis = _main_axis(twelve, top, left)
    uniform = (axis == _main_axis(twelve, top, right)) & (axis == _main_axis(twelve, bottom, left))
    uniform = uniform & (axis == _main_axis(twelve, bottom, right))
    axis = axis % 3
    ia, ib = tl.where(axis == 0, 1, 0), tl.where(axis == 2, 1, 2)
    n_m, n_a, n_b = _size(axis, w, h, d), _size(ia, w, h, d), _size(ib, w, h, d)
    source, middle = tl.load(twelve + axis), n_m // 2
    nothing, everything = source * 0.0 - 1e300, source * 0.0 + 1e300
    first_end, last_end = everything, nothing
    low_a0, high_a0, low_b0, high_b0 = everything, nothing, everything, nothing
    low_a1, high_a1, low_b1, high_b1 = everything, nothing, everything, nothing
    for corner in tl.static_range(4):
        row, column = bottom if corner // 2 == 1 else top, right if corner % 2 == 1 else left
        along = _direction(twelve, axis, row, column)
        first_end, last_end = tl.minimum(first_end, source + along), tl.maximum(last_end, source + along)
        one_over = 1.0 / tl.where(along == 0, 1.0, along)
        da, db = _direction(twelve, ia, row, column) * one_over, _direction(twelve, ib, row, column) * one_over
        a0, b0 = tl.load(twelve + ia) + BORDER - source * da, tl.load(twelve + ib) + BORDER - source * db
        a1, b1 = a0 + (n_m - 1.0) * da, b0 + (n_m - 1.0) * db
        low_a0, high_a0, low_b0, high_b0 = _wider(low_a0, high_a0, low_b0, high_b0, a0, b0)
        low_a1, high_a1, low_b1, high_b1 = _wider(low_a1, high_a1, low_b1, high_b1, a1, b1)
        if corner == 0:
            _put_four(record + _A, a0 + middle * da, da, b0 + middle * db, db, there)
            _put_four(
                record + _ALONG, along, source + along, tl.load(twelve + 6 + axis), tl.load(twelve + 9 + axis), there
            )
    _put_four(
        record + _ACROSS_A, tl.load(twelve + 6 + ia), tl.load(twelve + 9 + ia),
        tl.load(twelve + 6 + ib), tl.load(twelve + 9 + ib), there,
    )  # fmt: skip
    _put_chords(record + _LOW_A, low_a0, low_a1, high_a0, high_a1, n_m, uniform, there)
    _put_chords(record + _LOW_B, low_b0, low_b1, high_b0, high_b1, n_m, uniform, there)
    near, far = tl.minimum(source, first_end) - _MARGIN, tl.maximum(source, last_end) + _MARGIN
    whole = (tl.minimum(source, last_end) + _MARGIN < -0.5) & (tl.maximum(source, first_end) - _MARGIN > n_m - 0.5)
    within_a = (tl.minimum(low_a0, low_a1) > 1 + _MARGIN) & (tl.maximum(high_a0, high_a1) < n_a + BORDER - _MARGIN)
    within_b = (tl.minimum(low_b0, low_b1) > 1 + _MARGIN) & (tl.maximum(high_b0, high_b1) < n_b + BORDER - _MARGIN)
    near, far = tl.where(uniform, near, -_EVERYWHERE), tl.where(uniform, far, _EVERYWHERE)
    careful = tl.where(uniform & whole & within_a & within_b, 0, 1)
    _put_four(record + _AXIS, tl.where(uniform, axis, _MIXED), near, far, careful, there)


@triton.jit
@no_type_check
def _wider(low_a, high_a, low_b, high_b, a, b):
    return tl.minimum(low_a, a), tl.maximum(high_a, a), tl.minimum(low_b, b), tl.maximum(high_b, b)


@triton.jit
@no_type_check
def _put_chords(at, low0, low1, high0, high1, slices, uniform, there):
    """Of both planes along one axis the place on the first slice, and the slope."""
    steps = tl.maximum(slices - 1, 1)
    low, high = tl.where(uniform, low0 - _MARGIN, -_EVERYWHERE), tl.where(uniform, high0 + _MARGIN, _EVERYWHERE)
    low_slope = tl.where(uniform, (low1 - low0) / steps, 0.0)
    high_slope = tl.where(uniform, (high1 - high0) / steps, 0.0)
    _put_four(at, low, low_slope, high, high_slope, there)


@triton.jit
@no_type_check
def _put_four(at, one, two, three, four, there):
    """Numbers that follow one another, for many tiles: together, so that they are written together."""
    odd = tl.join(one.to(tl.float32), three.to(tl.float32))
    even = tl.join(two.to(tl.float32), four.to(tl.float32))
    numbers = tl.join(odd, even).reshape([one.shape[0], 4])
    tl.store(at[:, None] + tl.arange(0, 4)[None, :], numbers, there[:, None])


@triton.jit
@no_type_check
def joseph(
    slices, tables, numbers, record, twelve, grid, channel, channels, row0, column0, row, column, w, h, d,
    BLOCK: tl.constexpr, BORDER: tl.constexpr, SHARP: tl.constexpr, GRADIENT: tl.constexpr, PIXELS: tl.constexpr,
):  # fmt: skip
    """Per pixel: the line integral, and its derivative by source and pixel where ``GRADIENT``.

    The tile begins at ``row0`` and ``column0``. A mixed one is followed along each axis in turn, each time by those
    of its rays whose it is.
    """
    zero = tl.zeros([PIXELS], tl.float32)
    integral, s_i, s_j, s_k, p_i, p_j, p_k = zero, zero, zero, zero, zero, zero, zero
    only = tl.load(record + _AXIS).to(tl.int32)
    uniform = only != _MIXED
    for axis in range(tl.maximum(only, 0), tl.where(uniform, only + 1, 3)):
        value, s_a, s_b, s_m, p_a, p_b, p_m = _along(
            slices, tables, numbers, record, twelve, grid, channel, channels, axis, uniform, row0, column0, row, column,
            w, h, d, BLOCK, BORDER, SHARP, GRADIENT, PIXELS,
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
    slices, tables, numbers, record, twelve, grid, channel, channels, axis, uniform, row0, column0, row, column,
    w, h, d,
    BLOCK: tl.constexpr, BORDER: tl.constexpr, SHARP: tl.constexpr, GRADIENT: tl.constexpr, PIXELS: tl.constexpr,
):  # fmt: skip
    """The rays of one axis; nothing for all others. Derivatives along a, b and m.

    Values need positions in float32, counted from the middle slice. Slopes jump from cell to cell, so for them
    positions are whole numbers of 2^-32 voxels. Offsets are counted modulo 2^32.
    """
    ia, ib = tl.where(axis == 0, 1, 0), tl.where(axis == 2, 1, 2)
    n_m, n_a, n_b = _size(axis, w, h, d), _size(ia, w, h, d), _size(ib, w, h, d)
    stride = n_a + 2 * BORDER
    area = stride * (n_b + 2 * BORDER)
    stack = slices + (_before(axis, w, h, d, 2 * BORDER) * channels + channel * n_m.to(tl.int64) * area)
    middle = n_m // 2
    count = _list_slices(tables, numbers, record, channel, channels, axis, n_m, n_a, n_b, w, h, d, BLOCK, BORDER)

    zero = tl.zeros([PIXELS], tl.float32)
    if GRADIENT:
        middle_a, middle_b, slope_a, slope_b, along, near, far = _rays(
            twelve, axis, ia, ib, middle, uniform, row.to(tl.float64), column.to(tl.float64), BORDER
        )
        exact_a, exact_b = (middle_a * 4294967296.0).to(tl.int64), (middle_b * 4294967296.0).to(tl.int64)
        step_a, step_b = (slope_a * 4294967296.0).to(tl.int64), (slope_b * 4294967296.0).to(tl.int64)
        da, db = slope_a.to(tl.float32), slope_b.to(tl.float32)
    else:
        source = tl.load(twelve + axis)
        if uniform:
            from_source = (middle.to(tl.float64) - source).to(tl.float32)
            down, across = (row - row0).to(tl.float32), (column - column0).to(tl.float32)
            a0, b0, da, db, near, far = _near_rays(record, source.to(tl.float32), from_source, down, across)
        else:
            middle_a, middle_b, slope_a, slope_b, along, near, far = _rays(
                twelve, axis, ia, ib, middle, uniform, row.to(tl.float64), column.to(tl.float64), BORDER
            )
            a0, b0 = middle_a.to(tl.float32), middle_b.to(tl.float32)
            da, db = slope_a.to(tl.float32), slope_b.to(tl.float32)
    sharp_a, sharp_b = _number(grid + 3 + ia), _number(grid + 3 + ib)
    if GRADIENT:
        place_a, place_b, move_a, move_b = exact_a, exact_b, step_a, step_b
    else:
        place_a, place_b, move_a, move_b = a0, b0, da, db
    if tl.load(record + _CAREFUL) != 0:
        total, sum_a, sum_b, turn_a, turn_b, at_near, at_far = _walk(
            numbers, count, stack, middle, stride, area, n_a, n_b, place_a, place_b, move_a, move_b, near, far,
            sharp_a, sharp_b, BORDER, SHARP, GRADIENT, True, PIXELS,
        )  # fmt: skip
    else:
        total, sum_a, sum_b, turn_a, turn_b, at_near, at_far = _walk(
            numbers, count, stack, middle, stride, area, n_a, n_b, place_a, place_b, move_a, move_b, near, far,
            sharp_a, sharp_b, BORDER, SHARP, GRADIENT, False, PIXELS,
        )  # fmt: skip
    mm_a, mm_b, mm_m = _number(grid + ia), _number(grid + ib), _number(grid + axis)
    length = tl.sqrt(da * da * mm_a * mm_a + db * db * mm_b * mm_b + mm_m * mm_m)
    s_a, s_b, s_m, p_a, p_b, p_m = zero, zero, zero, zero, zero, zero
    if GRADIENT:
        from_source = (middle.to(tl.float64) - tl.load(twelve + axis)).to(tl.float32)
        one_over, stretch = 1.0 / along.to(tl.float32), total / length
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
def _walk(
    numbers, count, stack, middle, stride, area, n_a, n_b, place_a, place_b, move_a, move_b, near, far,
    sharp_a, sharp_b,
    BORDER: tl.constexpr, SHARP: tl.constexpr, GRADIENT: tl.constexpr, CAREFUL: tl.constexpr, PIXELS: tl.constexpr,
):  # fmt: skip
    """Sums over the slices in ``numbers``: of values, of slopes and of these times the distance from the middle, and
    the values where rays end. Where no ray ends in the volume or leaves it sideways one need not be ``CAREFUL``.
    """
    zero = tl.zeros([PIXELS], tl.float32)
    last_a, last_b = (n_a + BORDER).to(tl.float32), (n_b + BORDER).to(tl.float32)
    too_many = (stride + 1) * _NO_CELL

    total, sum_a, sum_b, turn_a, turn_b, at_near, at_far = zero, zero, zero, zero, zero, zero, zero
    coming = tl.load(numbers).to(tl.int32)
    for n in range(count):
        m = coming
        coming = tl.load(numbers + n + 1).to(tl.int32)  # one more is read than there are
        if GRADIENT:
            ahead = (m - middle).to(tl.int64)
            at_a, at_b = place_a + ahead * move_a, place_b + ahead * move_b
            ja, jb = (at_a >> 32).to(tl.int32), (at_b >> 32).to(tl.int32)
            if CAREFUL:
                ja, jb = tl.minimum(tl.maximum(ja, 0), n_a + BORDER), tl.minimum(tl.maximum(jb, 0), n_b + BORDER)
            fa = at_a.to(tl.uint32).to(tl.float32) * (1.0 / 4294967296.0)
            fb = at_b.to(tl.uint32).to(tl.float32) * (1.0 / 4294967296.0)
            first = m * area
        else:
            ahead = (m - middle).to(tl.float32)
            ja, fa = _cell(place_a + ahead * move_a, last_a, CAREFUL)
            jb, fb = _cell(place_b + ahead * move_b, last_b, CAREFUL)
            first = m * area - too_many
        if SHARP:
            fa, fb = (fa - 0.5) * sharp_a + 0.5, (fb - 0.5) * sharp_b + 0.5
            steep_a = tl.where((fa >= 0) & (fa < 1), sharp_a, 0.0)
            steep_b = tl.where((fb >= 0) & (fb < 1), sharp_b, 0.0)
            fa, fb = tl.minimum(tl.maximum(fa, 0.0), 1.0), tl.minimum(tl.maximum(fb, 0.0), 1.0)
        upper_left = stack + (first + jb * stride + ja).to(tl.uint32)
        v00, v01 = tl.load(upper_left), tl.load(upper_left + 1)
        v10, v11 = tl.load(upper_left + stride), tl.load(upper_left + stride + 1)
        upper, lower = v00 + fa * (v01 - v00), v10 + fa * (v11 - v10)
        value = upper + fb * (lower - upper)
        share = 1.0
        if CAREFUL:
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
            if CAREFUL:
                at_far += tl.where((share > 0) & (far < m + 0.5), value, 0.0)
                at_near += tl.where((share > 0) & (near > m - 0.5), value, 0.0)
    return total, sum_a, sum_b, turn_a, turn_b, at_near, at_far


@triton.jit
@no_type_check
def _rays(twelve, axis, ia, ib, middle, uniform, row, column, BORDER: tl.constexpr):
    """Of each ray, in float64: its place on the middle slice and its slope along a and b, its way along m, its ends.

    A ray of another axis ends before it begins.
    """
    along = _direction(twelve, axis, row, column)
    mine = along != 0
    if uniform == 0:
        mine = mine & (_main_axis(twelve, row, column) % 3 == axis)
    along = tl.where(mine, along, 1.0)
    one_over = 1.0 / along
    slope_a, slope_b = _direction(twelve, ia, row, column) * one_over, _direction(twelve, ib, row, column) * one_over
    source = tl.load(twelve + axis)
    from_source = middle.to(tl.float64) - source
    middle_a = tl.load(twelve + ia) + BORDER + from_source * slope_a
    middle_b = tl.load(twelve + ib) + BORDER + from_source * slope_b
    near = tl.where(mine, tl.minimum(source, source + along), 1e30).to(tl.float32)
    far = tl.where(mine, tl.maximum(source, source + along), -1e30).to(tl.float32)
    return middle_a, middle_b, slope_a, slope_b, along, near, far


@triton.jit
@no_type_check
def _near_rays(record, source, from_source, row, column):
    """As ``_rays`` of a tile of one axis, in float32: places and slopes differ little from those of its first ray.

    With d = along + column c_m + row r_m the slope's difference is (column (c_a - da c_m) + row (r_a - da r_m)) / d.
    """
    c_a, c_b, c_m = tl.load(record + _ACROSS_A), tl.load(record + _ACROSS_B), tl.load(record + _ACROSS_M)
    r_a, r_b, r_m = tl.load(record + _DOWN_A), tl.load(record + _DOWN_B), tl.load(record + _DOWN_M)
    da, db = tl.load(record + _DA), tl.load(record + _DB)
    ahead = column * c_m + row * r_m
    one_over = 1.0 / (tl.load(record + _ALONG) + ahead)
    more_a = (column * (c_a - da * c_m) + row * (r_a - da * r_m)) * one_over
    more_b = (column * (c_b - db * c_m) + row * (r_b - db * r_m)) * one_over
    a, b = tl.load(record + _A) + from_source * more_a, tl.load(record + _B) + from_source * more_b
    end = tl.load(record + _END) + ahead
    return a, b, da + more_a, db + more_b, tl.minimum(source, end), tl.maximum(source, end)


@triton.jit
@no_type_check
def _list_slices(
    tables, numbers, record, channel, channels, axis, n_m, n_a, n_b, w, h, d, BLOCK: tl.constexpr, BORDER: tl.constexpr
):
    """The slices that hold anything between the corner rays, to ``numbers``; how many there are."""
    wide = (n_a + 2 * BORDER + BLOCK - 2) // BLOCK + 1
    high = (n_b + 2 * BORDER + BLOCK - 2) // BLOCK + 1
    before = _blocks_before(axis, w, h, d, BLOCK, BORDER)
    table = tables + (before * channels + channel * n_m.to(tl.int64) * (wide * high))
    near, far = tl.load(record + _NEAR), tl.load(record + _FAR)
    tl.debug_barrier()  # the list of another axis has been read
    count = 0
    for begin in range(0, n_m, _SLICES_AT_ONCE):
        m = begin + tl.arange(0, _SLICES_AT_ONCE)
        la, ha = _block(record + _LOW_A, m, n_a, BLOCK, BORDER), _block(record + _HIGH_A, m, n_a, BLOCK, BORDER) + 1
        lb, hb = _block(record + _LOW_B, m, n_b, BLOCK, BORDER), _block(record + _HIGH_B, m, n_b, BLOCK, BORDER) + 1
        there = (m < n_m) & (m + 0.5 > near) & (m - 0.5 < far)
        at = table + m.to(tl.int64) * (wide * high)
        found = tl.load(at + hb * wide + ha, there, 0) - tl.load(at + lb * wide + ha, there, 0)
        found -= tl.load(at + hb * wide + la, there, 0) - tl.load(at + lb * wide + la, there, 0)
        one = tl.where(found > 0, 1, 0)
        tl.store(numbers + (count + tl.cumsum(one, 0) - one), m.to(tl.int16), found > 0)
        count += tl.sum(one, 0)
    tl.debug_barrier()
    return count


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
def _cell(place, last, CAREFUL: tl.constexpr):
    """The cell, counted from ``_NO_CELL``, and the fraction in it; if ``CAREFUL`` clamped to the border of air.

    2^23 + n has the bits of n, those of its exponent beside; an integer is the end of a cell or the beginning of one.
    """
    if CAREFUL:
        place = tl.minimum(tl.maximum(place, 1.0), last)
    whole = place + _FLOOR
    return whole.to(tl.int32, bitcast=True), place - (whole - 8388608.0)


@triton.jit
@no_type_check
def _block(chord, m, n, BLOCK: tl.constexpr, BORDER: tl.constexpr):
    place = tl.load(chord) + m.to(tl.float32) * tl.load(chord + 1)
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
