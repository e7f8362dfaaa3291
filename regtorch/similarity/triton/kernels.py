"""Sobel's gradients of a block of pixels, and seven sums over it."""

from typing import no_type_check

import triton
import triton.language as tl


@triton.jit(do_not_specialize=["rows", "columns"])
@no_type_check
def gradient_gram(images, fixed, root, parts, rows, columns, BLOCK: tl.constexpr):
    """To ``parts``, seven per block: m f, m r and m m of the x-gradient m times r, the same of y, and the squares."""
    pixels = rows * columns
    blocks = (pixels + BLOCK - 1) // BLOCK
    program = tl.program_id(0)
    pixel = (program % blocks) * BLOCK + tl.arange(0, BLOCK)
    there = pixel < pixels
    row, column = pixel // columns, pixel % columns
    image = images + (program // blocks).to(tl.int64) * pixels
    above, below = tl.maximum(row - 1, 0) * columns, tl.minimum(row + 1, rows - 1) * columns
    here, left, right = row * columns, tl.maximum(column - 1, 0), tl.minimum(column + 1, columns - 1)
    nw, ne = tl.load(image + above + left, there, 0.0), tl.load(image + above + right, there, 0.0)
    sw, se = tl.load(image + below + left, there, 0.0), tl.load(image + below + right, there, 0.0)
    n, s = tl.load(image + above + column, there, 0.0), tl.load(image + below + column, there, 0.0)
    w, e = tl.load(image + here + left, there, 0.0), tl.load(image + here + right, there, 0.0)
    value = tl.load(image + pixel, there, 0.0)
    roots = tl.load(root + pixel, there, 0.0)
    dx = ((ne - nw) + (se - sw) + 2.0 * (e - w)) * 0.125 * roots
    dy = ((sw - nw) + (se - ne) + 2.0 * (s - n)) * 0.125 * roots
    fixed_x, fixed_y = tl.load(fixed + pixel, there, 0.0), tl.load(fixed + pixels + pixel, there, 0.0)
    part = parts + program.to(tl.int64) * 7
    tl.store(part, tl.sum(dx * fixed_x, 0).to(tl.float64))
    tl.store(part + 1, tl.sum(dx * roots, 0).to(tl.float64))
    tl.store(part + 2, tl.sum(dx * dx, 0).to(tl.float64))
    tl.store(part + 3, tl.sum(dy * fixed_y, 0).to(tl.float64))
    tl.store(part + 4, tl.sum(dy * roots, 0).to(tl.float64))
    tl.store(part + 5, tl.sum(dy * dy, 0).to(tl.float64))
    tl.store(part + 6, tl.sum(value * value, 0).to(tl.float64))
