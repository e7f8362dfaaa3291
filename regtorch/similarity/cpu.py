"""The sums behind gradient correlation in one pass over images that are still in the cache."""

from typing import no_type_check

import numpy as np
import torch
from jaxtyping import Float
from numba import get_num_threads, njit, prange
from torch import Tensor

_ROWS = 64


def can_sum(images: Tensor) -> bool:
    """Whether ``gradient_gram`` can take these images: float32 on the CPU, no derivative wanted."""
    wanted = torch.is_grad_enabled() and images.requires_grad
    return images.device.type == "cpu" and images.dtype == torch.float32 and not wanted


def gradient_gram(
    images: Float[Tensor, "n h w"], fixed: Float[Tensor, "2 h w"], root: Float[Tensor, "h w"]
) -> tuple[Float[Tensor, "n 2 1 3"], Float[Tensor, " n"]]:
    """``similarity.gram.gradient_gram`` of images without derivatives, their gradients never stored whole."""
    n, rows, columns = images.shape
    count, band = bands(rows, columns, 1)
    partial, squares = np.zeros((n, count, 2, 1, 3)), np.zeros((n, count))
    arrays = [t.detach().contiguous().numpy() for t in (images, fixed, root)]
    _grams(*arrays, band, partial, squares, 4 * get_num_threads())
    return torch.from_numpy(partial.sum(axis=1)), torch.from_numpy(np.sqrt(squares.sum(axis=1) / (rows * columns)))


def bands(rows: int, columns: int, images: int) -> tuple[int, int]:
    """How many bands of how many rows an image is summed in, so that ``images`` bands stay in a core's cache.

    Independent of the number of threads, so that any gives the same bits.
    """
    most = max(1, min(_ROWS, (1 << 17) // (images * columns)) - 2)
    count = -(-rows // most)
    return count, -(-rows // count)


@njit(parallel=True, nogil=True, cache=True)
@no_type_check
def _grams(images, fixed, root, band, partial, squares, chunks):
    n, rows, columns = images.shape
    count = partial.shape[1]
    for chunk in prange(chunks):
        gradients = np.empty((1, band * columns), np.float32)
        for item in range(chunk, n * count, chunks):
            i, b = item // count, item % count
            row0, row1 = b * band, min((b + 1) * band, rows)
            squares[i, b] = band_gram(images[i : i + 1], 0, row0, row1, rows, fixed, root, gradients, partial[i, b])


@njit(nogil=True, fastmath={"contract", "reassoc", "nsz"})
@no_type_check
def band_gram(images, top, row0, row1, rows, fixed, root, gradients, sums):
    """Into ``sums`` [2, m, m + 2] for ``images`` [m, h, w] that begin at row ``top``, over rows ``row0`` to ``row1``.

    For the x- and the y-gradients, each times ``root``: their products with ``fixed`` [2, h, w], with ``root`` and with
    one another (upper triangle). Returns the sum of squares of the first image. ``gradients`` [m, pixels] is scratch.
    """
    m, _, columns = images.shape
    eighth, two = np.float32(0.125), np.float32(2)
    pixels = np.uint64((row1 - row0) * columns)
    inner = np.uint64(columns - 1)
    for direction in range(2):
        for i in range(m):
            for row in range(row0, row1):
                above, here = images[i, max(row - 1, 0) - top], images[i, row - top]
                below, weight = images[i, min(row + 1, rows - 1) - top], root[row]
                line = gradients[i, (row - row0) * columns : (row - row0 + 1) * columns]
                if direction == 0:
                    for c in range(np.uint64(1), inner):
                        after = above[c + np.uint64(1)] + two * here[c + np.uint64(1)] + below[c + np.uint64(1)]
                        before = above[c - np.uint64(1)] + two * here[c - np.uint64(1)] + below[c - np.uint64(1)]
                        line[c] = (after - before) * eighth * weight[c]
                else:
                    for c in range(np.uint64(1), inner):
                        after = below[c - np.uint64(1)] + two * below[c] + below[c + np.uint64(1)]
                        before = above[c - np.uint64(1)] + two * above[c] + above[c + np.uint64(1)]
                        line[c] = (after - before) * eighth * weight[c]
                for c in (0, columns - 1):  # borders are replicated
                    p, n = max(c - 1, 0), min(c + 1, columns - 1)
                    if direction == 0:
                        step = above[n] + two * here[n] + below[n] - above[p] - two * here[p] - below[p]
                    else:
                        step = below[p] + two * below[c] + below[n] - above[p] - two * above[c] - above[n]
                    line[c] = step * eighth * weight[c]
        first = np.uint64(row0 * columns)
        f, r = fixed[direction].ravel()[first:], root.ravel()[first:]
        for i in range(m):
            g = gradients[i]
            sums[direction, i, 0] = _dot(g, f, pixels)
            sums[direction, i, 1] = _dot(g, r, pixels)
            for j in range(i, m):
                sums[direction, i, 2 + j] = _dot(g, gradients[j], pixels)
    square = 0.0
    for row in range(row0, row1):
        line = images[0, row - top]
        square += _dot(line, line, np.uint64(columns))
    return square


@njit(nogil=True, fastmath={"contract", "reassoc", "nsz"})
@no_type_check
def _dot(a, b, n):
    total = np.float32(0)
    for i in range(n):
        total += a[i] * b[i]
    return np.float64(total)
