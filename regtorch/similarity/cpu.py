"""The sums behind gradient correlation in one pass over images that are still in the cache."""

from typing import no_type_check

import numpy as np
import torch
from jaxtyping import Float
from numba import get_num_threads, njit, prange
from torch import Tensor

IN_CACHE = 1 << 17
"""Floats that a core's second-level cache holds beside everything else."""

_ROWS = 130
_GRADIENTS = 8192


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
    most = max(1, min(_ROWS, IN_CACHE // (images * columns)) - 2)
    count = -(-rows // most)
    return count, -(-rows // count)


@njit(parallel=True, nogil=True, cache=True)
@no_type_check
def _grams(images, fixed, root, band, partial, squares, chunks):
    n, rows, columns = images.shape
    count = partial.shape[1]
    for chunk in prange(chunks):
        padded, gradients = np.empty((1, band + 2, columns), np.float32), gradient_scratch(1, columns)
        for item in range(chunk, n * count, chunks):
            i, b = item // count, item % count
            row0, row1 = b * band, min((b + 1) * band, rows)
            padded[0, 1 : row1 - row0 + 1] = images[i, row0:row1]
            padded[0, 0], padded[0, row1 - row0 + 1] = images[i, max(row0 - 1, 0)], images[i, min(row1, rows - 1)]
            squares[i, b] = band_gram(padded, row0, row1, fixed, root, gradients, partial[i, b])


@njit(nogil=True, fastmath={"contract", "reassoc", "nsz"})
@no_type_check
def band_gram(padded, row0, row1, fixed, root, gradients, sums):
    """Into ``sums`` [2, m, m + 2] for rows ``row0`` to ``row1`` of images [m, h, w].

    For the x- and the y-gradients, each times ``root``: their products with ``fixed`` [2, h, w], with ``root`` and with
    one another (upper triangle). Returns the sum of squares of the first image. ``padded`` [m, rows + 2, w] holds the
    rows from ``row0`` - 1 on, ``gradients`` is ``gradient_scratch``.
    """
    m, _, columns = padded.shape
    step = gradients.shape[2] // columns
    sums[:] = 0
    square = 0.0
    for begin in range(0, row1 - row0, step):
        end = min(begin + step, row1 - row0)
        first, pixels = np.uint64((row0 + begin) * columns), np.uint64((end - begin) * columns)
        r = root.ravel()[first:]
        for i in range(m):
            _differentiate(padded[i, begin:].ravel(), columns, pixels, r, gradients[0, i], gradients[1, i])
        for direction in range(2):
            f = fixed[direction].ravel()[first:]
            for i in range(m):
                g = gradients[direction, i]
                sums[direction, i, 0] += _dot(g, f, pixels)
                sums[direction, i, 1] += _dot(g, r, pixels)
                for j in range(i, m):
                    sums[direction, i, 2 + j] += _dot(g, gradients[direction, j], pixels)
        inside = padded[0, begin + 1 :].ravel()
        square += _dot(inside, inside, pixels)
    return square


@njit(nogil=True, fastmath={"contract"})
@no_type_check
def _differentiate(above, columns, pixels, root, dx, dy):
    """Sobel's derivatives over 8, times ``root``, of the rows after the first one in ``above``.

    In one loop over all rows as if they were one, after which each row's ends are set right: borders are replicated.
    """
    eighth, two = np.float32(0.125), np.float32(2)
    here, below = above[columns:], above[2 * columns :]
    one = np.uint64(1)
    for i in range(one, pixels - one):
        across = above[i + one] + two * here[i + one] + below[i + one]
        across -= above[i - one] + two * here[i - one] + below[i - one]
        down = below[i - one] + two * below[i] + below[i + one]
        down -= above[i - one] + two * above[i] + above[i + one]
        weight = eighth * root[i]
        dx[i], dy[i] = across * weight, down * weight
    for first in range(0, np.int64(pixels), columns):
        for i in (first, first + columns - 1):
            p, n = max(i - 1, first), min(i + 1, first + columns - 1)
            across = above[n] + two * here[n] + below[n] - above[p] - two * here[p] - below[p]
            down = below[p] + two * below[i] + below[n] - above[p] - two * above[i] - above[n]
            weight = eighth * root[i]
            dx[i], dy[i] = across * weight, down * weight


@njit(nogil=True, fastmath={"contract", "reassoc", "nsz"})
@no_type_check
def _dot(a, b, n):
    total = np.float32(0)
    for i in range(n):
        total += a[i] * b[i]
    return np.float64(total)


@njit(nogil=True)
@no_type_check
def gradient_scratch(images, columns):
    """Room [2, images, pixels] for a few rows of gradients: the fastest cache holds as much."""
    return np.empty((2, images, max(1, _GRADIENTS // (images * columns)) * columns), np.float32)
