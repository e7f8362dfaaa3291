"""How well poses explain a radiograph, and which way is better, without a DRR leaving the device or the cache."""

from types import ModuleType

import torch
from jaxtyping import Float
from torch import Tensor

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

_PIXELS_AT_ONCE = {"cpu": 1 << 22}
_PIXELS_ELSEWHERE = 1 << 26
_POSES_AT_ONCE = 4096
_POSES_ON_GPU = 1 << 15


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
    """Gradient correlation, eqs. (2)-(3), of DRRs with the fixed image; float64. By Joseph's method one pass on a CPU.

    ``fixed`` may be ``fixed_gradients`` of an image, made once for many calls; then ``weight`` is theirs. Memory is
    bounded whatever the batch. No graph: see ``render`` and ``gradient_correlation`` for that.
    Raises ``RegtorchError`` as ``render`` does, and for images of different shapes.
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
    """As ``gradient_correlations``, with J^T J [*b, p, p] and J^T r [*b, p] by the parameters ``free`` (None: all).

    r is the difference of the normalised gradient images, |r|^2 = 4 (1 - similarity), J its exact derivative
    (per mm, per rad), which is stored for a few rows of one image at a time.
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
    pixels = _PIXELS_AT_ONCE.get(volume.data.device.type, _PIXELS_ELSEWHERE)
    at_once = max(1, min(_POSES_AT_ONCE, pixels // ((1 + len(free)) * detector.rows * detector.columns)))
    if chosen is triton:
        at_once = _POSES_ON_GPU  # what takes more memory than a pose it does for fewer at a time
    found = []
    for some in parameters.detach().reshape(-1, 9).split(at_once):
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
