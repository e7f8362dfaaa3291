"""The volume as Joseph's kernels read it: slices across each axis in a border of air, and where they are occupied."""

from math import prod

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import max_pool2d, pad
from torch.utils.weak import WeakTensorKeyDictionary

BLOCK = 2
"""Side of the blocks of cells that the tables tell apart."""

BORDER = 2
"""Voxels of air around a slice: a ray beyond it reads the outermost cell, which has neither value nor slope."""

_prepared = WeakTensorKeyDictionary()


def prepared(data: Float[Tensor, "*c d h w"]) -> tuple[Float[Tensor, " voxels"], Int[Tensor, " blocks"]]:
    """For axes i, j and k, one after the other: slices [c, n, b, a], and summed-area tables of what they hold.

    A table counts blocks of cells of which any of the voxels around is not zero. Both are kept as long as ``data``
    lives unchanged. All three axes at once: which ones the rays need would be a number to wait for.
    """
    version, kept = _prepared.get(data, (None, None))
    if data.is_inference() or version != data._version:  # torch does not count changes of inference tensors
        kept = _made(data.detach().reshape(-1, *data.shape[-3:]))
        if not data.is_inference():
            _prepared[data] = data._version, kept
    return kept


def _made(voxels: Float[Tensor, "c d h w"]) -> tuple[Tensor, Tensor]:
    c = len(voxels)
    across = [voxels.movedim(3 - axis, 1) for axis in range(3)]
    shapes = [(c, s.shape[1], s.shape[2] + 2 * BORDER, s.shape[3] + 2 * BORDER) for s in across]
    tables = [(c, n, _blocks(h) + 1, _blocks(w) + 1) for _, n, h, w in shapes]
    slices = voxels.new_zeros(sum(map(prod, shapes)))
    counts = voxels.new_zeros(sum(map(prod, tables)), dtype=torch.int32)
    parts = slices.split(list(map(prod, shapes))), counts.split(list(map(prod, tables)))
    for axis, (values, table) in enumerate(zip(*parts, strict=True)):
        values, table = values.view(shapes[axis]), table.view(tables[axis])
        values[..., BORDER:-BORDER, BORDER:-BORDER] = across[axis]
        table[..., 1:, 1:] = _occupied(values).cumsum(2, dtype=torch.int32).cumsum(3, dtype=torch.int32)
    return slices, counts


def _blocks(voxels: int) -> int:
    """How many blocks the cells between so many voxels make."""
    return -(-(voxels - 1) // BLOCK)


def _occupied(values: Float[Tensor, "c n h w"]) -> Float[Tensor, "c n rows columns"]:
    """1 for each block of cells that has anything at one of its corners."""
    h, w = values.shape[-2:]
    beyond = 0, _blocks(w) * BLOCK + 1 - w, 0, _blocks(h) * BLOCK + 1 - h
    return max_pool2d(pad((values != 0).to(values.dtype), beyond), BLOCK + 1, BLOCK)
