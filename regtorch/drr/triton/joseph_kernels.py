"""The kernels of Joseph's method: a program is a tile of pixels of one class of one pose.

Tiles are numbered along one axis of the grid, each tile of all classes of all poses before the next one: these read
the same part of the volume. ``numbers`` has room for each program's list of slices, ``records`` for what ``survey``
finds.
"""

from typing import no_type_check

import triton
import triton.language as tl

from regtorch.drr.triton.joseph import RECORD, joseph, survey

# Compiled once for all shapes: a 1 taken for a constant would have no type.
_SHAPES = ["w", "h", "d", "count", "rows", "columns", "channels", "room", "parameters", "per_image", "per_jacobian"]


@triton.jit(do_not_specialize=["w", "h", "d", "count", "rows", "columns", "channels", "programs"])
@no_type_check
def joseph_survey(
    records, rays, w, h, d, count, rows, columns, channels, programs,
    BORDER: tl.constexpr, TILE_ROWS: tl.constexpr, TILE_COLUMNS: tl.constexpr, AT_ONCE: tl.constexpr,
):  # fmt: skip
    """The records of all tiles, ``AT_ONCE`` by each program."""
    tile = tl.program_id(0) * AT_ONCE + tl.arange(0, AT_ONCE)
    there = tile < programs
    tile = tl.minimum(tile, programs - 1)
    _, _, pose, _, row0, column0 = _tile(tile, count, rows, columns, channels, TILE_ROWS, TILE_COLUMNS)
    bottom, right = tl.minimum(row0 + TILE_ROWS, rows) - 1, tl.minimum(column0 + TILE_COLUMNS, columns) - 1
    survey(
        records + tile.to(tl.int64) * RECORD, rays + pose * 12, there, row0.to(tl.float64), column0.to(tl.float64),
        bottom.to(tl.float64), right.to(tl.float64), w, h, d, BORDER,
    )  # fmt: skip


@triton.jit(do_not_specialize=_SHAPES)
@no_type_check
def joseph_project(
    slices, tables, numbers, records, rays, grid, images, w, h, d, count, rows, columns, channels, room,
    BLOCK: tl.constexpr, BORDER: tl.constexpr, SHARP: tl.constexpr, TILE_ROWS: tl.constexpr, TILE_COLUMNS: tl.constexpr,
):  # fmt: skip
    """Line integrals to ``images``."""
    image, _, pose, channel, row0, column0 = _tile(
        tl.program_id(0), count, rows, columns, channels, TILE_ROWS, TILE_COLUMNS
    )
    row, column, pixels = _pixels(row0, column0, rows, columns, TILE_ROWS, TILE_COLUMNS)
    own = tl.program_id(0).to(tl.int64)
    value, _, _, _, _, _, _ = joseph(
        slices, tables, numbers + own * room, records + own * RECORD, rays + pose * 12, grid, channel, channels,
        row0, column0, row, column, w, h, d, BLOCK, BORDER, SHARP, False, TILE_ROWS * TILE_COLUMNS,
    )  # fmt: skip
    tl.store(images + (image * rows + row) * columns + column, value, mask=pixels)


@triton.jit(do_not_specialize=_SHAPES, do_not_specialize_on_alignment=["jacobian"])
@no_type_check
def joseph_project_with_jacobian(
    slices, tables, numbers, records, rays, ray_jacobian, grid, images, jacobian,
    w, h, d, count, rows, columns, channels, room,
    parameters, per_image, per_jacobian,
    BLOCK: tl.constexpr, BORDER: tl.constexpr, SHARP: tl.constexpr, TILE_ROWS: tl.constexpr, TILE_COLUMNS: tl.constexpr,
):  # fmt: skip
    """Line integrals to ``images`` and their derivatives by each parameter to ``jacobian``.

    ``per_image`` and ``per_jacobian`` tell how many images lie between those of one pose, or class, and the next.
    """
    image, _, pose, channel, row0, column0 = _tile(
        tl.program_id(0), count, rows, columns, channels, TILE_ROWS, TILE_COLUMNS
    )
    row, column, pixels = _pixels(row0, column0, rows, columns, TILE_ROWS, TILE_COLUMNS)
    own = tl.program_id(0).to(tl.int64)
    value, s_i, s_j, s_k, p_i, p_j, p_k = joseph(
        slices, tables, numbers + own * room, records + own * RECORD, rays + pose * 12, grid, channel, channels,
        row0, column0, row, column, w, h, d, BLOCK, BORDER, SHARP, True, TILE_ROWS * TILE_COLUMNS,
    )  # fmt: skip
    at = row * columns + column
    area = rows.to(tl.int64) * columns
    tl.store(images + image * per_image * area + at, value, mask=pixels)
    across, down = column.to(tl.float32), row.to(tl.float32)
    for parameter in range(parameters):
        by = ray_jacobian + pose * 12 * parameters + parameter
        change = s_i * _number(by) + s_j * _number(by + parameters) + s_k * _number(by + 2 * parameters)
        change += p_i * _motion(by + 3 * parameters, parameters, across, down)
        change += p_j * _motion(by + 4 * parameters, parameters, across, down)
        change += p_k * _motion(by + 5 * parameters, parameters, across, down)
        tl.store(jacobian + (image * per_jacobian + parameter) * area + at, change, mask=pixels)


@triton.jit(do_not_specialize=_SHAPES)
@no_type_check
def joseph_pull_back_rays(
    slices, tables, numbers, records, rays, grid, image_gradients, sums, w, h, d, count, rows, columns, channels, room,
    BLOCK: tl.constexpr, BORDER: tl.constexpr, SHARP: tl.constexpr, TILE_ROWS: tl.constexpr, TILE_COLUMNS: tl.constexpr,
):  # fmt: skip
    """Each tile's part of the derivative by the twelve numbers of its pose to ``sums``, twelve per tile and class."""
    image, within, pose, channel, row0, column0 = _tile(
        tl.program_id(0), count, rows, columns, channels, TILE_ROWS, TILE_COLUMNS
    )
    row, column, pixels = _pixels(row0, column0, rows, columns, TILE_ROWS, TILE_COLUMNS)
    own = tl.program_id(0).to(tl.int64)
    _, s_i, s_j, s_k, p_i, p_j, p_k = joseph(
        slices, tables, numbers + own * room, records + own * RECORD, rays + pose * 12, grid, channel, channels,
        row0, column0, row, column, w, h, d, BLOCK, BORDER, SHARP, True, TILE_ROWS * TILE_COLUMNS,
    )  # fmt: skip
    upstream = tl.load(image_gradients + (image * rows + row) * columns + column, mask=pixels, other=0.0)
    upstream, across, down = upstream.to(tl.float64), column.to(tl.float64), row.to(tl.float64)
    tiles = ((rows + TILE_ROWS - 1) // TILE_ROWS) * ((columns + TILE_COLUMNS - 1) // TILE_COLUMNS)
    part = sums + (image * tiles + within) * 12
    _store_sums(part, upstream, s_i, p_i, across, down)
    _store_sums(part + 1, upstream, s_j, p_j, across, down)
    _store_sums(part + 2, upstream, s_k, p_k, across, down)


@triton.jit
@no_type_check
def _tile(program, count, rows, columns, channels, TILE_ROWS: tl.constexpr, TILE_COLUMNS: tl.constexpr):
    """Of a program: its image's number and its own within this, its pose and class, and its first row and column."""
    across = (columns + TILE_COLUMNS - 1) // TILE_COLUMNS
    image, within = program % count, program // count
    pose, channel = image // channels, image % channels
    row0, column0 = (within // across) * TILE_ROWS, (within % across) * TILE_COLUMNS
    return image.to(tl.int64), within, pose.to(tl.int64), channel.to(tl.int64), row0, column0


@triton.jit
@no_type_check
def _pixels(row0, column0, rows, columns, TILE_ROWS: tl.constexpr, TILE_COLUMNS: tl.constexpr):
    """The rows and columns of a tile's pixels, the image's last ones in place of others; and which the image has."""
    pixel = tl.arange(0, TILE_ROWS * TILE_COLUMNS)
    row, column = row0 + pixel // TILE_COLUMNS, column0 + pixel % TILE_COLUMNS
    return tl.minimum(row, rows - 1), tl.minimum(column, columns - 1), (row < rows) & (column < columns)


@triton.jit
@no_type_check
def _motion(by, parameters, across, down):
    """How pixels move along one axis with one parameter; ``by`` is where the ray Jacobian has the first pixel's."""
    return _number(by) + across * _number(by + 3 * parameters) + down * _number(by + 6 * parameters)


@triton.jit
@no_type_check
def _store_sums(part, upstream, by_source, by_pixel, across, down):
    """Of one axis, in float64 and always in the same order."""
    by_pixel = upstream * by_pixel.to(tl.float64)
    tl.store(part, tl.sum(upstream * by_source.to(tl.float64), 0))
    tl.store(part + 3, tl.sum(by_pixel, 0))
    tl.store(part + 6, tl.sum(by_pixel * across, 0))
    tl.store(part + 9, tl.sum(by_pixel * down, 0))


@triton.jit
@no_type_check
def _number(at):
    return tl.load(at).to(tl.float32)
