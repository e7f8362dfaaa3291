"""The front door of the projectors: CT and poses in, line integrals and their derivatives out."""

from types import ModuleType
from typing import Literal, get_args

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.drr import cpu, reference, triton
from regtorch.drr.differentiable import project
from regtorch.errors import RegtorchError
from regtorch.geometry import Detector, cone_beam_rays, ray_jacobian
from regtorch.imaging.volume import Volume

Method = Literal["joseph", "trilinear", "siddon"]
Backend = Literal["auto", "torch", "cpu", "triton"]


def render(
    volume: Volume,
    parameters: Float[Tensor, "*b 9"],
    detector: Detector,
    view: str = "PA",
    *,
    method: Method = "joseph",
    backend: Backend = "auto",
) -> Float[Tensor, "..."]:
    """Line integrals [*b, h, w] of attenuation from the source to every pixel, seen looking from the source.

    Voxels behind the source or behind the detector do not count, and air surrounds the volume. The images have
    the type and device of ``volume.data``, whose unit must be ``per_mm`` (see ``regtorch.imaging.hounsfield``); a
    volume of c classes of tissue [c, d, h, w] gives [*b, c, h, w] in one pass. Differentiable by the
    parameters and by the voxels with every backend.

    Methods: ``siddon`` (Siddon 1985) is exact for voxels of constant value; ``joseph`` (Joseph 1982) interpolates
    bilinearly, or with the edges that ``volume.sharpness`` asks for, on each slice across the axis nearest to the ray;
    ``trilinear`` samples at half-voxel steps.
    Backends: ``torch`` is the readable reference; ``cpu`` and ``triton`` (for GPUs) are fused kernels in float32.
    ``auto`` takes the fastest that can render this.

    Raises ``RegtorchError`` for values in HU and for poses that are not finite or have the source behind the detector.
    It also does for unknown methods and backends, and for a backend that cannot render this.
    """
    fused = chosen_backend(volume, parameters, method, backend)
    rays = rays_of(volume, parameters, detector, view)
    images = project(fused, volume.data, rays, volume.grid, detector.rows, detector.columns, method)
    return _shaped(images, volume, parameters)


def render_with_jacobian(
    volume: Volume,
    parameters: Float[Tensor, "*b 9"],
    detector: Detector,
    view: str = "PA",
    *,
    method: Method = "joseph",
    backend: Backend = "auto",
) -> tuple[Float[Tensor, "..."], Float[Tensor, "..."]]:
    """``render``, and the exact derivatives of every pixel by the nine parameters (per mm, per rad) in the same pass.

    Forward mode: images [*b, h, w] and jacobians [*b, 9, h, w], or [*b, c, h, w] and [*b, c, 9, h, w] for a volume of
    c classes. Neither carries a graph.
    """
    fused = chosen_backend(volume, parameters, method, backend)
    flat = parameters.detach().reshape(-1, 9)
    rays = rays_of(volume, flat, detector, view)
    by_parameters = ray_jacobian(flat, detector, view, volume.voxel_from_ct).to(rays)
    place = volume.grid, detector.rows, detector.columns, method
    images, jacobian = fused.project_with_jacobian(volume.data, rays, by_parameters, *place)
    return _shaped(images, volume, parameters), _shaped(jacobian, volume, parameters)


def _shaped(result: Tensor, volume: Volume, parameters: Float[Tensor, "*b 9"]) -> Tensor:
    """[b, classes, ...] as the poses' batch shape and, if the volume has any, classes."""
    result = result.squeeze(1) if volume.data.ndim == 3 else result
    return result.reshape(*parameters.shape[:-1], *result.shape[1:])


def rays_of(volume: Volume, parameters: Float[Tensor, "*b 9"], detector: Detector, view: str) -> Float[Tensor, "b 12"]:
    """Twelve numbers per pose in float64 on the volume's device."""
    flat = parameters.reshape(-1, 9).to(volume.data.device, torch.float64)
    return cone_beam_rays(flat, detector, view, volume.voxel_from_ct)


def chosen_backend(volume: Volume, parameters: Float[Tensor, "*b 9"], method: str, backend: str) -> ModuleType:
    """The module that is to work; checks everything ``render`` is given."""
    for what, name, known in (("method", method, get_args(Method)), ("backend", backend, get_args(Backend))):
        if name not in known:
            raise RegtorchError(f"{what} {name!r}: expected one of {', '.join(known)}")
    if volume.unit != "per_mm":
        raise RegtorchError(f"{volume.name}: values in {volume.unit}, expected attenuation per mm to render")
    if not bool(parameters.detach().sum().isfinite()):  # one number, where a mask would be as large as the batch
        raise RegtorchError("parameters that are not finite: expected nine numbers per pose")
    if parameters.numel() and bool(parameters[..., 2].min() <= 0):
        raise RegtorchError(f"SDD of {float(parameters[..., 2].min()):g} mm: expected a positive distance")
    fused = {"cpu": cpu, "triton": triton}
    if backend == "auto":
        fastest = "cpu" if volume.data.device.type == "cpu" else "triton"
        return reference if fused[fastest].why_not(volume.data, method) else fused[fastest]
    if backend == "torch":
        return reference
    if missing := fused[backend].why_not(volume.data, method):
        raise RegtorchError(f"backend {backend!r} cannot render this: {missing}")
    return fused[backend]
