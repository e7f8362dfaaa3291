"""Sobel's gradients of bands of rows, and sums over them: each row is read once and remembered for the next two."""

from typing import no_type_check

import triton
import triton.language as tl


@triton.jit(do_not_specialize=["rows", "columns", "band"])
@no_type_check
def gradient_sums(images, fixed, root, parts, rows, columns, band, WIDTH: tl.constexpr):
    """To ``parts``, seven per image and block: m f, m r and m m of the x-gradient m times r, of y, and the squares.

    A program has a block of ``band`` rows and ``WIDTH`` columns of one image.
    """
    number, block, blocks, first, end, column, inside = _block(rows, columns, band, WIDTH)
    pixels = rows.to(tl.int64) * columns
    image = images + number * pixels
    above, here = tl.maximum(first - 1, 0), first
    turn, smooth, _ = _row(image, above, column, columns, inside)
    turn_here, smooth_here, value = _row(image, here, column, columns, inside)
    zero = tl.zeros([WIDTH], tl.float32)
    x_f, x_r, x_x, y_f, y_r, y_y, squares = zero, zero, zero, zero, zero, zero, zero
    for row in range(first, end):
        turn_next, smooth_next, next_value = _row(image, tl.minimum(row + 1, rows - 1), column, columns, inside)
        at = row * columns + column
        roots = tl.load(root + at, inside, 0.0)
        dx = (turn + 2.0 * turn_here + turn_next) * (0.125 * roots)
        dy = (smooth_next - smooth) * (0.125 * roots)
        x_f += dx * tl.load(fixed + at, inside, 0.0)
        y_f += dy * tl.load(fixed + pixels + at, inside, 0.0)
        x_r += dx * roots
        y_r += dy * roots
        x_x += dx * dx
        y_y += dy * dy
        squares += value * value
        turn, smooth = turn_here, smooth_here
        turn_here, smooth_here, value = turn_next, smooth_next, next_value
    part = parts + (number * blocks + block) * 7
    tl.store(part, tl.sum(x_f, 0).to(tl.float64))
    tl.store(part + 1, tl.sum(x_r, 0).to(tl.float64))
    tl.store(part + 2, tl.sum(x_x, 0).to(tl.float64))
    tl.store(part + 3, tl.sum(y_f, 0).to(tl.float64))
    tl.store(part + 4, tl.sum(y_r, 0).to(tl.float64))
    tl.store(part + 5, tl.sum(y_y, 0).to(tl.float64))
    tl.store(part + 6, tl.sum(squares, 0).to(tl.float64))


@triton.jit(do_not_specialize=["m", "rows", "columns", "band"])
@no_type_check
def gradient_products(
    images, fixed, root, parts, squares, m, rows, columns, band,
    HEIGHT: tl.constexpr, WIDTH: tl.constexpr, PRECISION: tl.constexpr,
):  # fmt: skip
    """To ``parts``, per group of m images and block: for x and for y the products of all gradients with one another.

    They are ``HEIGHT`` rows: the gradients times r of the images, then f, then r, then nothing. ``squares`` are those
    of each group's first image. A program has a block of ``band`` rows and ``WIDTH`` columns.
    """
    group, block, blocks, first, end, column, inside = _block(rows, columns, band, WIDTH)
    column, inside = column[None, :], inside[None, :]
    line = tl.arange(0, HEIGHT)[:, None]
    there = (line < m) & inside
    pixels = rows.to(tl.int64) * columns
    image = images + (group * m + line) * pixels
    above, here = tl.maximum(first - 1, 0), first
    turn, smooth, _ = _row(image, above, column, columns, there)
    turn_here, smooth_here, value = _row(image, here, column, columns, there)
    square = tl.zeros([HEIGHT, WIDTH], tl.float32)
    of_x, of_y = tl.zeros([HEIGHT, HEIGHT], tl.float32), tl.zeros([HEIGHT, HEIGHT], tl.float32)
    for row in range(first, end):
        turn_next, smooth_next, next_value = _row(image, tl.minimum(row + 1, rows - 1), column, columns, there)
        at = row * columns + column
        roots = tl.load(root + at, inside, 0.0)
        dx = (turn + 2.0 * turn_here + turn_next) * (0.125 * roots)
        dy = (smooth_next - smooth) * (0.125 * roots)
        beside = tl.where(line == m + 1, roots, 0.0)
        dx = tl.where(line < m, dx, tl.where(line == m, tl.load(fixed + at, inside, 0.0), beside))
        dy = tl.where(line < m, dy, tl.where(line == m, tl.load(fixed + pixels + at, inside, 0.0), beside))
        of_x = tl.dot(dx, tl.trans(dx), of_x, input_precision=PRECISION)
        of_y = tl.dot(dy, tl.trans(dy), of_y, input_precision=PRECISION)
        square += value * value
        turn, smooth = turn_here, smooth_here
        turn_here, smooth_here, value = turn_next, smooth_next, next_value
    place = line * HEIGHT + tl.arange(0, HEIGHT)[None, :]
    part = parts + (group * blocks + block) * (2 * HEIGHT * HEIGHT)
    tl.store(part + place, of_x)
    tl.store(part + HEIGHT * HEIGHT + place, of_y)
    tl.store(squares + group * blocks + block, tl.sum(tl.sum(tl.where(line == 0, square, 0.0), 1), 0))


@triton.jit
@no_type_check
def _block(rows, columns, band, WIDTH: tl.constexpr):
    """Of this program: its group of images, its block, how many there are, its rows, and columns that the image has."""
    strips = (columns + WIDTH - 1) // WIDTH
    blocks = strips * ((rows + band - 1) // band)
    group, block = tl.program_id(0) // blocks, tl.program_id(0) % blocks
    first = (block // strips) * band
    column = (block % strips) * WIDTH + tl.arange(0, WIDTH)
    return group.to(tl.int64), block, blocks, first, tl.minimum(first + band, rows), column, column < columns


@triton.jit
@no_type_check
def _row(image, row, column, columns, there):
    """Of one row, borders replicated: differences across, smoothed values, and values."""
    line = image + row * columns
    left = tl.load(line + tl.maximum(column - 1, 0), there, 0.0)
    right = tl.load(line + tl.minimum(column + 1, columns - 1), there, 0.0)
    value = tl.load(line + column, there, 0.0)
    return right - left, left + 2.0 * value + right, value
