"""The sums behind gradient correlation in one pass over each image, its gradients never stored."""

from typing import no_type_check

import numpy as np
import torch
from jaxtyping import Float
from numba import get_num_threads, njit, prange
from torch import Tensor


def can_sum(images: Tensor) -> bool:
    """Whether ``gradient_sums`` can take these images: float32 on the CPU, no derivative wanted."""
    wanted = torch.is_grad_enabled() and images.requires_grad
    return images.device.type == "cpu" and images.dtype == torch.float32 and not wanted


def gradient_sums(
    images: Float[Tensor, "n h w"], fixed: Float[Tensor, "2 h w"], weight: Float[Tensor, "h w"]
) -> tuple[Float[Tensor, "n 2 3"], Float[Tensor, " n"]]:
    """For the x- and the y-gradient m of each image: sums of w m, w m m and m f over all pixels, in float64.

    The second result is each image's root mean square.

    Gradients are Sobel's over 8 with replicated borders, as ``kornia.filters.spatial_gradient`` defines them.
    """
    sums = torch.zeros(len(images), 2, 3, dtype=torch.float64)
    squares = torch.zeros(len(images), dtype=torch.float64)
    arrays = (t.detach().contiguous().numpy() for t in (images, fixed, weight))
    _sums(*arrays, sums.numpy(), squares.numpy(), 4 * get_num_threads())
    return sums, (squares / max(1, images[0].numel())).sqrt() if len(images) else squares


@njit(parallel=True, nogil=True, cache=True, fastmath={"contract", "reassoc", "nsz"}, error_model="numpy")
@no_type_check
def _sums(images, fixed, weight, sums, squares, chunks):
    n, rows, columns = images.shape
    for chunk in prange(chunks):
        smooth, across = np.empty(columns + 2, np.float32), np.empty(columns + 2, np.float32)
        for i in range(chunk, n, chunks):
            image = images[i]
            for row in range(rows):
                above, here, below = image[max(row - 1, 0)], image[row], image[min(row + 1, rows - 1)]
                for c in range(columns):
                    smooth[c + 1] = (above[c] + below[c]) + np.float32(2) * here[c]
                    across[c + 1] = below[c] - above[c]
                smooth[0], smooth[columns + 1] = smooth[1], smooth[columns]
                across[0], across[columns + 1] = across[1], across[columns]
                w, fx, fy = weight[row], fixed[0, row], fixed[1, row]
                x1 = x2 = x3 = y1 = y2 = y3 = square = np.float32(0)
                for c in range(columns):
                    dx = (smooth[c + 2] - smooth[c]) * np.float32(0.125)
                    dy = (across[c] + across[c + 2] + np.float32(2) * across[c + 1]) * np.float32(0.125)
                    square += here[c] * here[c]
                    wx, wy = w[c] * dx, w[c] * dy
                    x1 += wx
                    x2 += wx * dx
                    x3 += fx[c] * dx
                    y1 += wy
                    y2 += wy * dy
                    y3 += fy[c] * dy
                squares[i] += square
                sums[i, 0, 0] += x1
                sums[i, 0, 1] += x2
                sums[i, 0, 2] += x3
                sums[i, 1, 0] += y1
                sums[i, 1, 1] += y2
                sums[i, 1, 2] += y3
