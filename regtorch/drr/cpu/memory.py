"""Memory for images, kept when it is dropped: touching what the system lends anew takes as long as rendering."""

import math
import weakref

import numpy as np
import torch
from torch import Tensor

_LEAST_BYTES = 1 << 20
_MOST_BYTES = 1 << 28
"""Kept at most, in all."""

_kept: dict[int, list[np.ndarray]] = {}


def empty(*shape: int) -> Tensor:
    """A float32 tensor of whatever values; its memory is that of one of the same size that was dropped, if any is left.

    By numpy, which asks for large pages where torch does not.
    """
    size = 4 * math.prod(shape)
    if size < _LEAST_BYTES:
        return torch.from_numpy(np.empty(shape, np.float32))
    try:
        memory = _kept[size].pop()
    except (KeyError, IndexError):
        memory = np.empty(size, np.uint8)
    lent = memory.view(np.float32).reshape(shape)
    weakref.finalize(lent, _keep, memory).atexit = False  # the tensor and all its views hold ``lent``
    return torch.from_numpy(lent)


def _keep(memory: np.ndarray) -> None:
    if memory.nbytes > _MOST_BYTES:
        return
    if sum(size * len(some) for size, some in list(_kept.items())) + memory.nbytes > _MOST_BYTES:
        _kept.clear()
    _kept.setdefault(memory.nbytes, []).append(memory)
