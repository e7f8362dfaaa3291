"""The kernels of rays that are followed by themselves: a program is a tile of pixels of one pose, with every channel.

Tiles are numbered along one axis of the grid, pose after pose. All setup is in float64, all sums are in float32.
"""

from typing import no_type_check

import triton
import triton.language as tl

from regtorch.drr.triton.joseph_adjoint import joseph_adjoint
from regtorch.drr.triton.siddon import siddon
from regtorch.drr.triton.trilinear import trilinear

# Compiled once for all shapes: a 1 taken for a constant would have no type.
_SHAPES = ["w", "h", "d", "rows", "columns", "steps", "parameters", "per_image", "per_jacobian"]


@triton.jit(do_not_specialize=_SHAPES)
@no_type_check
def project(
    data, rays, grid, images, w, h, d, rows, columns, steps,
    METHOD: tl.constexpr, CHANNELS: tl.constexpr, PADDED: tl.constexpr, TILE_ROWS: tl.constexpr,
    TILE_COLUMNS: tl.constexpr,
):  # fmt: skip
    """Line integrals to ``images``."""
    pose, _, row, column, pixels, channel, channels = _tile(rows, columns, CHANNELS, PADDED, TILE_ROWS, TILE_COLUMNS)
    nothing = tl.zeros([PADDED, TILE_ROWS * TILE_COLUMNS], tl.float32)
    value, _, _, _, _, _, _ = _line(
        data, rays, grid, pose, row, column, pixels, channel, channels, nothing, w, h, d, steps, METHOD, "value"
    )
    at = ((pose * CHANNELS + channel) * rows + row[None, :]) * columns + column[None, :]
    tl.store(images + at, value, mask=channels & pixels[None, :])


@triton.jit(do_not_specialize=_SHAPES)
@no_type_check
def project_with_jacobian(
    data, rays, ray_jacobian, grid, images, jacobian, w, h, d, rows, columns, steps,
    parameters, per_image, per_jacobian,
    METHOD: tl.constexpr, CHANNELS: tl.constexpr, PADDED: tl.constexpr, TILE_ROWS: tl.constexpr,
    TILE_COLUMNS: tl.constexpr,
):  # fmt: skip
    """Line integrals to ``images`` and their derivatives by each parameter to ``jacobian``.

    ``per_image`` and ``per_jacobian`` tell how many images lie between those of one pose, or class, and the next.
    """
    pose, _, row, column, pixels, channel, channels = _tile(rows, columns, CHANNELS, PADDED, TILE_ROWS, TILE_COLUMNS)
    nothing = tl.zeros([PADDED, TILE_ROWS * TILE_COLUMNS], tl.float32)
    value, s_i, s_j, s_k, p_i, p_j, p_k = _line(
        data, rays, grid, pose, row, column, pixels, channel, channels, nothing, w, h, d, steps, METHOD, "gradient"
    )
    mask = channels & pixels[None, :]
    image = pose * CHANNELS + channel
    tl.store(images + (image * per_image * rows + row[None, :]) * columns + column[None, :], value, mask=mask)
    for parameter in range(parameters):
        twelve = ray_jacobian + pose * 12 * parameters + parameter
        i, j, k = _motion(twelve, row, column, parameters)
        change = s_i * _number(twelve) + s_j * _number(twelve + parameters) + s_k * _number(twelve + 2 * parameters)
        change += p_i * i + p_j * j + p_k * k
        at = ((image * per_jacobian + parameter) * rows + row[None, :]) * columns + column[None, :]
        tl.store(jacobian + at, change, mask=mask)


@triton.jit(do_not_specialize=_SHAPES)
@no_type_check
def pull_back_rays(
    data, rays, grid, image_gradients, sums, w, h, d, rows, columns, steps,
    METHOD: tl.constexpr, CHANNELS: tl.constexpr, PADDED: tl.constexpr, TILE_ROWS: tl.constexpr,
    TILE_COLUMNS: tl.constexpr,
):  # fmt: skip
    """Each tile's part of the derivative by the twelve numbers of its pose to ``sums``, twelve per tile."""
    pose, tile, row, column, pixels, channel, channels = _tile(rows, columns, CHANNELS, PADDED, TILE_ROWS, TILE_COLUMNS)
    nothing = tl.zeros([PADDED, TILE_ROWS * TILE_COLUMNS], tl.float32)
    _, s_i, s_j, s_k, p_i, p_j, p_k = _line(
        data, rays, grid, pose, row, column, pixels, channel, channels, nothing, w, h, d, steps, METHOD, "gradient"
    )
    at = ((pose * CHANNELS + channel) * rows + row[None, :]) * columns + column[None, :]
    upstream = tl.load(image_gradients + at, mask=channels & pixels[None, :], other=0.0)
    twelve = sums + tile * 12
    one = row * 0.0 + 1.0
    for axis in tl.static_range(3):
        s, p = (s_i, p_i) if axis == 0 else ((s_j, p_j) if axis == 1 else (s_k, p_k))
        tl.store(twelve + axis, _sum(s * upstream, one))
        tl.store(twelve + 3 + axis, _sum(p * upstream, one))
        tl.store(twelve + 6 + axis, _sum(p * upstream, column))
        tl.store(twelve + 9 + axis, _sum(p * upstream, row))


@triton.jit(do_not_specialize=_SHAPES)
@no_type_check
def pull_back_data(
    total, rays, grid, image_gradients, w, h, d, rows, columns, steps,
    METHOD: tl.constexpr, CHANNELS: tl.constexpr, PADDED: tl.constexpr, TILE_ROWS: tl.constexpr,
    TILE_COLUMNS: tl.constexpr,
):  # fmt: skip
    """``image_gradients`` added to the whole numbers ``total`` where ``project`` reads the volume."""
    pose, _, row, column, pixels, channel, channels = _tile(rows, columns, CHANNELS, PADDED, TILE_ROWS, TILE_COLUMNS)
    at = ((pose * CHANNELS + channel) * rows + row[None, :]) * columns + column[None, :]
    upstream = tl.load(image_gradients + at, mask=channels & pixels[None, :], other=0.0)
    _line(total, rays, grid, pose, row, column, pixels, channel, channels, upstream, w, h, d, steps, METHOD, "scatter")


@triton.jit
@no_type_check
def _tile(
    rows, columns, CHANNELS: tl.constexpr, PADDED: tl.constexpr, TILE_ROWS: tl.constexpr, TILE_COLUMNS: tl.constexpr
):
    """Of this program: its pose, its own number, its pixels' rows and columns, the channels, and which there are."""
    tile = tl.program_id(0)
    across = (columns + TILE_COLUMNS - 1) // TILE_COLUMNS
    tiles = across * ((rows + TILE_ROWS - 1) // TILE_ROWS)
    pose, within = tile // tiles, tile % tiles
    pixel = tl.arange(0, TILE_ROWS * TILE_COLUMNS)
    row = (within // across) * TILE_ROWS + pixel // TILE_COLUMNS
    column = (within % across) * TILE_COLUMNS + pixel % TILE_COLUMNS
    channel = tl.arange(0, PADDED).to(tl.int64)[:, None]
    pixels = (row < rows) & (column < columns)
    return pose.to(tl.int64), tile.to(tl.int64), row, column, pixels, channel, channel < CHANNELS


@triton.jit
@no_type_check
def _line(
    data, rays, grid, pose, row, column, pixels, channel, channels, upstream, w, h, d, steps,
    METHOD: tl.constexpr, MODE: tl.constexpr,
):  # fmt: skip
    twelve = rays + pose * 12
    row, column = row.to(tl.float64), column.to(tl.float64)
    si, sj, sk = tl.load(twelve), tl.load(twelve + 1), tl.load(twelve + 2)
    pi = tl.load(twelve + 3) + column * tl.load(twelve + 6) + row * tl.load(twelve + 9)
    pj = tl.load(twelve + 4) + column * tl.load(twelve + 7) + row * tl.load(twelve + 10)
    pk = tl.load(twelve + 5) + column * tl.load(twelve + 8) + row * tl.load(twelve + 11)
    mm_i, mm_j, mm_k = _number(grid), _number(grid + 1), _number(grid + 2)
    volume = data + channel * (w.to(tl.int64) * h * d)
    if METHOD == "joseph":
        sharp_i, sharp_j, sharp_k = _number(grid + 3), _number(grid + 4), _number(grid + 5)
        joseph_adjoint(
            volume, channels, pixels, upstream, si, sj, sk, pi, pj, pk, mm_i, mm_j, mm_k, sharp_i, sharp_j, sharp_k,
            w, h, d,
        )  # fmt: skip
    elif METHOD == "siddon":
        return siddon(volume, channels, pixels, upstream, si, sj, sk, pi, pj, pk, mm_i, mm_j, mm_k, w, h, d, MODE)
    else:
        return trilinear(
            volume, channels, pixels, upstream, si, sj, sk, pi, pj, pk, mm_i, mm_j, mm_k, w, h, d, steps, MODE
        )


@triton.jit
@no_type_check
def _motion(twelve, row, column, parameters):
    """How the pixels move with one parameter, of which ``twelve`` is the first of the column of the ray Jacobian."""
    i = _number(twelve + 3 * parameters) + column * _number(twelve + 6 * parameters)
    j = _number(twelve + 4 * parameters) + column * _number(twelve + 7 * parameters)
    k = _number(twelve + 5 * parameters) + column * _number(twelve + 8 * parameters)
    i += row * _number(twelve + 9 * parameters)
    j += row * _number(twelve + 10 * parameters)
    k += row * _number(twelve + 11 * parameters)
    return i[None, :], j[None, :], k[None, :]


@triton.jit
@no_type_check
def _number(at):
    return tl.load(at).to(tl.float32)


@triton.jit
@no_type_check
def _sum(values, factor):
    """Over channels and pixels, in float64 and always in the same order."""
    return tl.sum(tl.sum(values.to(tl.float64) * factor.to(tl.float64)[None, :], 1), 0)
