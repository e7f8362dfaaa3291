"""Fused kernels as differentiable torch functions: ``project`` forward, adjoints backward."""

from types import ModuleType
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from regtorch.drr import reference


def project(
    backend: ModuleType,
    data: Float[Tensor, "*c d h w"],
    rays: Float[Tensor, "b 12"],
    grid: Float[Tensor, "2 3"],
    rows: int,
    columns: int,
    method: str,
) -> Float[Tensor, "b classes rows columns"]:
    """``backend.project`` with derivatives by the rays and by the voxels."""
    place = grid, rows, columns, method
    needs_gradient = torch.is_grad_enabled() and (rays.requires_grad or data.requires_grad)
    if backend is reference or not needs_gradient:
        return backend.project(data, rays, *place)
    return _Projection.apply(data, rays, backend, place)


class _Projection(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, data: Tensor, rays: Tensor, backend: ModuleType, place: tuple) -> Tensor:
        ctx.save_for_backward(data, rays)
        ctx.data = data  # backends find their copies of a volume by this object
        ctx.backend, ctx.place = backend, place
        return backend.project(data, rays, *place)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, image_gradients: Tensor) -> tuple[Tensor | None, Tensor | None, None, None]:
        _, rays = ctx.saved_tensors  # raises an error if the volume has changed since
        grid, _, _, method = ctx.place
        given = ctx.data, rays, grid, image_gradients, method
        by_data = ctx.backend.pull_back_data(*given) if ctx.needs_input_grad[0] else None
        by_rays = ctx.backend.pull_back_rays(*given) if ctx.needs_input_grad[1] else None
        return by_data, by_rays, None, None
