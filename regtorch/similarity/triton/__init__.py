"""Sums for gradient correlation on a GPU, in one pass over each image, without storing gradients."""

import os
from importlib.util import find_spec

import torch
from jaxtyping import Float
from torch import Tensor

_BLOCK = 1024


def can_sum(images: Tensor) -> bool:
    """Whether ``gradient_gram`` supports these images: float32 on a GPU with Triton, without a derivative."""
    wanted = torch.is_grad_enabled() and images.requires_grad
    runs = images.is_cuda or os.environ.get("TRITON_INTERPRET") == "1"
    return runs and images.dtype == torch.float32 and not wanted and find_spec("triton") is not None


def gradient_gram(
    images: Float[Tensor, "n h w"], fixed: Float[Tensor, "2 h w"], root: Float[Tensor, "h w"]
) -> tuple[Float[Tensor, "n 2 1 3"], Float[Tensor, " n"]]:
    """``similarity.cpu.gradient_gram`` on the images' device.

    Blocks of pixels are summed in float32, the blocks in float64, always in the same order.
    """
    from regtorch.similarity.triton import kernels

    n, rows, columns = images.shape
    blocks = -(-rows * columns // _BLOCK)
    parts = images.new_zeros(n, blocks, 7, dtype=torch.float64)
    if parts.numel():
        tensors = (t.detach().contiguous() for t in (images, fixed, root, parts))
        with torch.cuda.device_of(images):
            kernels.gradient_gram[(n * blocks,)](*tensors, rows, columns, BLOCK=_BLOCK, enable_fp_fusion=True)
    sums = parts.sum(1)
    return sums[:, :6].view(n, 2, 1, 3), (sums[:, 6] / max(1, rows * columns)).sqrt()
