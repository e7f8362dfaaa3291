"""The sums behind gradient correlation on a GPU, in one pass over each image, its gradients never stored.

Blocks of pixels are summed in float32 and the blocks in float64, always in the same order.
"""

import os
from importlib.util import find_spec

import torch
from jaxtyping import Float
from torch import Tensor

_BAND = 32
_WIDTH, _WIDTH_OF_PRODUCTS = 128, 32


def can_sum(images: Tensor) -> bool:
    """Whether ``gradient_gram`` can take these images: float32 on a GPU with Triton, no derivative wanted."""
    wanted = torch.is_grad_enabled() and images.requires_grad
    runs = images.is_cuda or os.environ.get("TRITON_INTERPRET") == "1"
    return runs and images.dtype == torch.float32 and not wanted and find_spec("triton") is not None


def gradient_gram(
    images: Float[Tensor, "n h w"], fixed: Float[Tensor, "2 h w"], root: Float[Tensor, "h w"]
) -> tuple[Float[Tensor, "n 2 1 3"], Float[Tensor, " n"]]:
    """As ``similarity.cpu.gradient_gram``, on the images' device."""
    from regtorch.similarity.triton import kernels

    n, rows, columns = images.shape
    blocks = _blocks(rows, columns, _WIDTH)
    parts = images.new_empty(n, blocks, 7, dtype=torch.float64)
    if parts.numel():
        tensors = (t.detach().contiguous() for t in (images, fixed, root, parts))
        with torch.cuda.device_of(images):
            kernels.gradient_sums[(n * blocks,)](
                *tensors, rows, columns, _BAND, WIDTH=_WIDTH, num_warps=2, enable_fp_fusion=True
            )
    sums = parts.sum(1)
    return sums[:, :6].view(n, 2, 1, 3), (sums[:, 6] / max(1, rows * columns)).sqrt()


def gradient_grams(
    images: Float[Tensor, "n m h w"], fixed: Float[Tensor, "2 h w"], root: Float[Tensor, "h w"]
) -> tuple[Float[Tensor, "n 2 m m+2"], Float[Tensor, " n"]]:
    """``similarity.gram.gradient_gram``, on the images' device."""
    from regtorch.similarity.triton import kernels

    n, m, rows, columns = images.shape
    blocks, height = _blocks(rows, columns, _WIDTH_OF_PRODUCTS), max(16, 1 << (m + 1).bit_length())
    parts, squares = images.new_empty(n, blocks, 2, height, height), images.new_empty(n, blocks)
    if parts.numel():
        tensors = (t.detach().contiguous() for t in (images, fixed, root, parts, squares))
        with torch.cuda.device_of(images):
            kernels.gradient_products[(n * blocks,)](
                *tensors, m, rows, columns, _BAND,
                HEIGHT=height, WIDTH=_WIDTH_OF_PRODUCTS, PRECISION="tf32x3", num_warps=1, enable_fp_fusion=True,
            )  # fmt: skip
    order = [m, m + 1, *range(m)]
    sums = parts.sum(1, dtype=torch.float64)[:, :, :m, order]
    return sums, (squares.sum(1, dtype=torch.float64) / max(1, rows * columns)).sqrt()


def _blocks(rows: int, columns: int, width: int) -> int:
    """How many blocks of pixels an image is summed in."""
    return -(-rows // _BAND) * -(-columns // width)
