"""The projectors in plain torch: the reference of every fused kernel, differentiable by pose and by voxel.

A method gives the places and weights of samples along a ray. A ray is p(t) = source + t (pixel - source), 0 <= t <= 1,
in voxel coordinates (i, j, k).
"""

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import grid_sample

from regtorch.batches import at_once

_SHARE = 2.0
"""Of the budget: the reference holds one array of samples at a time."""


def project(
    data: Float[Tensor, "*c d h w"],
    rays: Float[Tensor, "b 12"],
    grid: Float[Tensor, "2 3"],
    rows: int,
    columns: int,
    method: str,
) -> Float[Tensor, "b classes rows columns"]:
    """Line integrals for twelve numbers per pose, in bounded memory."""
    data, grid = data.reshape(-1, *data.shape[-3:]), grid.to(data)
    images = []
    for ray in rays:
        parts = [
            _RULES[method](data, source.to(data), pixel.to(data), grid)
            for source, pixel, _ in _some_rays(ray, data, rows, columns)
        ]
        images.append(torch.cat(parts, dim=1).reshape(-1, rows, columns))
    return torch.stack(images) if images else data.new_zeros(0, len(data), rows, columns)


def project_with_jacobian(
    data: Float[Tensor, "*c d h w"],
    rays: Float[Tensor, "b 12"],
    ray_jacobian: Float[Tensor, "b 12 p"],
    grid: Float[Tensor, "2 3"],
    rows: int,
    columns: int,
    method: str,
) -> tuple[Float[Tensor, "b classes rows columns"], Float[Tensor, "b classes p rows columns"]]:
    """Line integrals and their derivatives by p parameters, with ``ray_jacobian`` = d rays / d parameters.

    A pixel depends on the ends of its own ray alone. So one backward pass of the sum over pixels gives all derivatives.
    """
    data, grid = data.reshape(-1, *data.shape[-3:]), grid.to(data)
    if not len(rays):
        none = 0, len(data)
        return data.new_zeros(*none, rows, columns), data.new_zeros(*none, ray_jacobian.shape[2], rows, columns)
    images, jacobians = [], []
    for ray, by_parameters in zip(rays, ray_jacobian, strict=True):
        values, slopes = [], []
        for source, pixel, steps in _some_rays(ray, data, rows, columns):
            ends = [end.detach().to(data).requires_grad_() for end in (source, pixel)]
            with torch.enable_grad():
                value = _RULES[method](data, *ends, grid)
            each = [torch.autograd.grad(one.sum(), ends, retain_graph=True) for one in value]
            by_source, by_pixel = (torch.stack(gradient) for gradient in zip(*each, strict=True))
            by_rays = [by_source, by_pixel, by_pixel * steps[:, :1], by_pixel * steps[:, 1:]]
            values.append(value.detach())
            slopes.append(torch.einsum("cnr,rp->cpn", torch.cat(by_rays, dim=2), by_parameters.to(data)))
        images.append(torch.cat(values, dim=1).unflatten(1, (rows, columns)))
        jacobians.append(torch.cat(slopes, dim=2).unflatten(2, (rows, columns)))
    return torch.stack(images), torch.stack(jacobians)


def _some_rays(ray, data, rows, columns):
    """Sources and pixels [n, 3] of rays, in bounded memory, and their (column, row) [n, 2]."""
    size = torch.tensor(data.shape[:0:-1])
    samples_per_ray = 2 * int((size + 1.0).norm()) + int(size.sum()) + 6
    source, first, column_step, row_step = ray.unflatten(-1, (4, 3))
    pixels = torch.arange(rows * columns, device=data.device)
    for some in pixels.split(at_once(len(data) * samples_per_ray, share=_SHARE, most=len(pixels))):
        steps = torch.stack([some % columns, some // columns], dim=1).to(data)
        yield source.expand(len(some), 3), first + steps[:, :1] * column_step + steps[:, 1:] * row_step, steps


def _siddon(data, source, pixel, grid):
    """Siddon 1985: all crossings with voxel faces, sorted. Between two of them lies one voxel."""
    size, direction = torch.tensor(data.shape[:0:-1], device=data.device), pixel - source
    enter, leave = _span(source, direction, source.new_tensor(-0.5), size - 0.5)
    crossings = [enter[:, None], leave[:, None]]
    for axis in range(3):
        faces = torch.arange(int(size[axis]) + 1, device=data.device).to(data) - 0.5
        step = direction[:, axis, None]
        t = (faces - source[:, axis, None]) / torch.where(step == 0, torch.ones_like(step), step)
        crossings.append(torch.where(step == 0, enter[:, None], t))
    # Not clamp: its derivative is wrong where both limits are equal, as for a ray that misses the volume.
    t = torch.minimum(torch.maximum(torch.cat(crossings, dim=1), enter[:, None]), leave[:, None]).sort(dim=1).values
    middle = (t[:, 1:] + t[:, :-1]).detach() / 2
    # A ray along a face between two voxels reads the upper one.
    index = (source[:, None] + middle[..., None] * direction[:, None] + 0.5).floor().long()
    i, j, k = torch.minimum(index.clamp(min=0), size - 1).unbind(-1)
    return (data[:, k, j, i] * t.diff(dim=1)).sum(2) * (direction * grid[0]).norm(dim=1)


def _joseph(data, source, pixel, grid):
    """Joseph 1982: one bilinear sample where the ray crosses each slice of its main axis.

    Slice k stands for the slab from k - 1/2 to k + 1/2, of which only the part between source and pixel counts. For
    voxels sharper than linear, a sample is taken nearer to the voxel's centre.
    """
    direction = pixel - source
    main = direction.abs().argmax(dim=1)
    integrals = torch.zeros_like(direction[:, 0]).expand(len(data), -1)
    for axis in range(3):
        chosen = (main == axis).nonzero()[:, 0]
        d, start = direction[chosen], source[chosen]
        slices = torch.arange(data.shape[3 - axis], device=data.device).to(data)
        step = d[:, axis, None]
        points = start[:, None] + ((slices - start[:, axis, None]) / step)[..., None] * d[:, None]
        ends = torch.stack([start[:, axis, None], start[:, axis, None] + step])
        low, high = ends.amin(0), ends.amax(0)
        share = (torch.minimum(slices + 0.5, high) - torch.maximum(slices - 0.5, low)).clamp(0, 1)
        length = (d * grid[0]).norm(dim=1) / step[:, 0].abs()
        integrals = integrals.index_add(1, chosen, (_sample(data, _sharpened(points, grid[1])) * share).sum(2) * length)
    return integrals


def _trilinear(data, source, pixel, grid):
    """Trilinear samples in equal steps of at most half a voxel, where the ray is within a voxel of the volume."""
    size, direction = torch.tensor(data.shape[:0:-1], device=data.device), pixel - source
    enter, leave = _span(source, direction, source.new_tensor(-1.0), size.to(data))
    steps = 2 * int((size + 1.0).norm()) + 2
    middle = (torch.arange(steps, device=data.device).to(data) + 0.5) / steps
    t = enter[:, None] + (leave - enter)[:, None] * middle
    points = source[:, None] + t[..., None] * direction[:, None]
    return _sample(data, points).sum(2) * (leave - enter) / steps * (direction * grid[0]).norm(dim=1)


def _span(source, direction, lower, upper):
    """Span of t in [0, 1] inside a box; empty for a ray that misses it."""
    flat = direction == 0
    step = torch.where(flat, torch.ones_like(direction), direction)
    ends = torch.stack([(lower - source) / step, (upper - source) / step])
    missed = (flat & ((source < lower) | (source > upper))).any(dim=1)
    enter = torch.where(flat, 0, ends.amin(0)).amax(dim=1).clamp(0, 1)
    leave = torch.where(flat, 1, ends.amax(0)).amin(dim=1).clamp(0, 1)
    return enter, torch.where(missed, enter, torch.maximum(enter, leave))


def _sharpened(points, sharpness):
    """Points where linear interpolation has the value of voxels of this sharpness at ``points``."""
    cell = points.detach().floor()
    return cell + ((points - cell - 0.5) * sharpness + 0.5).clamp(0, 1)


def _sample(data, points):
    """Trilinear values [c, rays, samples] at (i, j, k), zero outside."""
    size = torch.tensor(data.shape[:0:-1], device=data.device)
    # grid_sample cannot place a point along an axis of one voxel, so such an axis is given an empty neighbour.
    padded = torch.nn.functional.pad(data, [side for n in data.shape[:0:-1] for side in (0, int(n == 1))])
    grid = 2 * points / (size.clamp(min=2) - 1) - 1
    return grid_sample(padded[None], grid[None, None], align_corners=True, padding_mode="zeros")[0, :, 0]


_RULES = {"siddon": _siddon, "joseph": _joseph, "trilinear": _trilinear}
