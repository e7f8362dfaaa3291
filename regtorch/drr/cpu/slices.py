"""The volume as Joseph's method reads it: slices across a main axis, four neighbours in one read, empty parts known."""

from typing import no_type_check

import numpy as np
from numba import njit, prange
from torch import Tensor
from torch.utils.weak import WeakTensorKeyDictionary

BLOCK = 4
"""Side of the blocks of cells in the table of occupied cells."""

BORDER = 2
"""Voxels of air around a slice: a read outside has neither value nor slope."""

_SLICES_AT_ONCE = 16
"""Neighbours along the axis that is contiguous in memory come in one cache line."""

_prepared = WeakTensorKeyDictionary()

Slices = tuple[np.ndarray, np.ndarray, np.ndarray]


def slices_across(data: Tensor, axis: int) -> Slices:
    """``data`` [d, h, w] or [c, d, h, w] across axis i, j or k (0, 1, 2), kept as long as the tensor lives unchanged.

    First, groups [c, n, cells]: a complex number of 16 bytes holds the four voxels (b, a), (b + 1, a), (b, a + 1),
    (b + 1, a + 1) of a slice with a border of air. Second, summed-area tables over blocks of cells between four voxels,
    1 where any of these is not zero. Third, the size of a slice with its border: along a, along b.
    """
    version, kept = _prepared.get(data, (None, {}))
    if data.is_inference():  # torch does not count the changes of such a tensor
        kept = {}
    elif version != data._version:
        kept = {}
        _prepared[data] = (data._version, kept)
    if axis not in kept:
        voxels = data.detach().reshape(-1, *data.shape[-3:]).numpy()
        kept[axis] = _stacked(np.moveaxis(voxels, 3 - axis, 1))
    return kept[axis]


def _stacked(across: np.ndarray) -> Slices:
    c, n, h, w = across.shape
    pairs = np.zeros((c, n, h + 2 * BORDER, w + 2 * BORDER, 2), np.float32)  # pages of air are never touched
    blocks = np.zeros((c, n, -(-(h + 2 * BORDER - 1) // BLOCK) + 1, -(-(w + 2 * BORDER - 1) // BLOCK) + 1), np.int32)
    _interleave(across, pairs, blocks)
    strides = (*pairs.strides[:2], pairs.itemsize * 2)  # each group shares half of its bytes with the next
    groups = np.ndarray((c, n, pairs[0, 0, ..., 0].size - 1), np.complex128, buffer=pairs.data, strides=strides)
    return groups, blocks.cumsum(axis=2, dtype=np.int32).cumsum(axis=3, dtype=np.int32), np.array(pairs.shape[3:1:-1])


@njit(parallel=True, nogil=True, cache=True)
@no_type_check
def _interleave(across, pairs, blocks):
    """Each slice with its border of air, interleaved with its next row; and where blocks of cells hold any.

    A cell lies between four voxels. It belongs to a block one row and one column further on in ``blocks``: summed-area
    tables begin with a row and a column of zeros.
    """
    c, n, h, w = across.shape
    for chunk in prange((n + _SLICES_AT_ONCE - 1) // _SLICES_AT_ONCE):
        some = range(chunk * _SLICES_AT_ONCE, min((chunk + 1) * _SLICES_AT_ONCE, n))
        for channel in range(c):
            for row in range(h):
                for k in some:
                    for column in range(w):
                        value = across[channel, k, row, column]
                        if value != 0:
                            b, a = row + BORDER, column + BORDER
                            pairs[channel, k, b, a, 0] = value
                            pairs[channel, k, b - 1, a, 1] = value
                            for cell in range(4):
                                above, left = (b - (cell >> 1)) // BLOCK, (a - (cell & 1)) // BLOCK
                                blocks[channel, k, above + 1, left + 1] = 1


def prepared(data: Tensor, rays: np.ndarray, rows: int, columns: int) -> tuple[tuple, tuple, tuple]:
    """Groups, tables and sizes for axes i, j, k as far as these rays follow them."""
    source, first, column_step, row_step = rays.reshape(-1, 4, 3).transpose(1, 0, 2)
    corners = [first + c * column_step + r * row_step - source for r in (0, rows - 1) for c in (0, columns - 1)]
    directions = np.stack(corners)  # they enclose all others
    main = np.abs(directions).argmax(axis=2)
    signed = np.where(np.take_along_axis(directions, main[..., None], axis=2)[..., 0] > 0, main, main - 3)
    needed = set(main[0].tolist()) if (signed == signed[0]).all() else range(3)
    nothing = _stacked(np.zeros((data.shape[:-3].numel(), 1, 1, 1), np.float32))
    stacks = [slices_across(data, axis) if axis in needed else nothing for axis in range(3)]
    groups, tables, sizes = zip(*stacks, strict=True)
    return groups, tables, sizes
