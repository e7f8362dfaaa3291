"""Gradient correlation of poses with a radiograph, and its derivatives; no DRR leaves the device or the cache."""

from types import ModuleType

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.batches import at_once
from regtorch.drr import cpu, triton
from regtorch.drr.rendering import Backend, Method, chosen_backend, rays_of
from regtorch.errors import RegtorchError
from regtorch.geometry import Detector, ray_jacobian
from regtorch.imaging.volume import Volume
from regtorch.scoring.cpu import joseph_gram
from regtorch.scoring.triton import gram as gram_triton
from regtorch.similarity.gram import (
    FixedGradients,
    NormalEquations,
    equations_from_gram,
    fixed_gradients,
    gradient_gram,
)

_POSES_ON_GPU = 1 << 15
"""Poses that a call on a GPU takes at once; its kernels bound their own memory."""


def gradient_correlations(
    volume: Volume,
    parameters: Float[Tensor, "*b 9"],
    detector: Detector,
    view: str,
    fixed: Float[Tensor, "h w"] | FixedGradients,
    *,
    weight: Float[Tensor, "h w"] | None = None,
    method: Method = "joseph",
    backend: Backend = "auto",
) -> Float[Tensor, "*b"]:
    """Gradient correlation, eqs. (2)-(3), of DRRs with the fixed image, in float64 and in bounded memory.

    The result has no graph: ``render`` and ``gradient_correlation`` make one. Raises ``RegtorchError`` as ``render``
    does, and for images of different shapes.

    Args:
        volume: CT in attenuation per mm, of one class of tissue.
        parameters: poses.
        detector, view: as in ``render``.
        fixed: fixed image, or its ``fixed_gradients``, made once for many calls.
        weight: weights of the fixed image's pixels; ``fixed_gradients`` contain theirs.
        method, backend: as in ``render``. Joseph's method on a CPU renders and compares in one pass.
    """
    found = _scored(volume, parameters, detector, view, fixed, weight, [], method, backend)
    return found.similarity.reshape(parameters.shape[:-1])


def normal_equations(
    volume: Volume,
    parameters: Float[Tensor, "*b 9"],
    detector: Detector,
    view: str,
    fixed: Float[Tensor, "h w"] | FixedGradients,
    *,
    weight: Float[Tensor, "h w"] | None = None,
    free: list[int] | None = None,
    method: Method = "joseph",
    backend: Backend = "auto",
) -> NormalEquations:
    """``gradient_correlations`` with J^T J [*b, p, p] and J^T r [*b, p] by the p parameters ``free``; None means all.

    r is the difference of the normalised gradient images, |r|^2 = 4 (1 - similarity). J is its exact derivative, per mm
    and per rad. J is stored for a few rows of one image at a time.
    """
    free = list(range(9)) if free is None else free
    found = _scored(volume, parameters, detector, view, fixed, weight, free, method, backend)
    return NormalEquations(*(part.reshape((*parameters.shape[:-1], *part.shape[1:])) for part in found))


def _scored(
    volume: Volume,
    parameters: Float[Tensor, "*b 9"],
    detector: Detector,
    view: str,
    fixed: Float[Tensor, "h w"] | FixedGradients,
    weight: Float[Tensor, "h w"] | None,
    free: list[int],
    method: str,
    backend: str,
) -> NormalEquations:
    chosen = chosen_backend(volume, parameters, method, backend)
    gradients = _prepared(volume, detector, fixed, weight)
    numbers_each = (1 + len(free)) * detector.rows * detector.columns
    many = _POSES_ON_GPU if chosen is triton else at_once(numbers_each, volume.data.device.type)
    found = []
    for some in parameters.detach().reshape(-1, 9).split(many):
        rays = rays_of(volume, some, detector, view)
        by_free = ray_jacobian(some, detector, view, volume.voxel_from_ct)[..., free].to(rays) if free else None
        gram, magnitude = _gram(chosen, method, volume, rays, by_free, gradients)
        found.append(equations_from_gram(gram, magnitude, gradients, torch.finfo(volume.data.dtype).eps))
    return NormalEquations(*(torch.cat(parts) for parts in zip(*found, strict=True)))


def _gram(
    chosen: ModuleType,
    method: str,
    volume: Volume,
    rays: Float[Tensor, "b 12"],
    by_free: Float[Tensor, "b 12 p"] | None,
    fixed: FixedGradients,
) -> tuple[Float[Tensor, "b 2 m m+2"], Float[Tensor, " b"]]:
    if chosen is cpu and method == "joseph":
        return joseph_gram(volume.data, rays, by_free, volume.grid, fixed)
    if chosen is triton:
        return gram_triton(volume.data, rays, by_free, volume.grid, fixed, method)
    place = volume.grid, *fixed.root.shape, method
    if by_free is None:
        images = chosen.project(volume.data, rays, *place)
    else:
        both = chosen.project_with_jacobian(volume.data, rays, by_free, *place)
        images = torch.cat([part.flatten(1, -3) for part in both], dim=1)
    return gradient_gram(images, fixed)


def _prepared(
    volume: Volume, detector: Detector, fixed: Tensor | FixedGradients, weight: Tensor | None
) -> FixedGradients:
    if volume.data.ndim != 3:
        raise RegtorchError(f"{volume.name}: {volume.data.shape[0]} classes of tissue, expected one to compare")
    shape = (fixed.root if isinstance(fixed, FixedGradients) else fixed).shape
    for name, other in (("fixed image", shape), ("weight", shape if weight is None else weight.shape)):
        if other != (detector.rows, detector.columns):
            raise RegtorchError(f"{name} of shape {tuple(other)}: expected {(detector.rows, detector.columns)}")
    if isinstance(fixed, FixedGradients):
        return fixed
    device = volume.data.device
    return fixed_gradients(fixed.to(device), None if weight is None else weight.to(device))
