"""The front door of the projectors: CT and poses in, line integrals out."""

from typing import Literal, get_args

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.drr import cpu, reference
from regtorch.errors import RegtorchError
from regtorch.geometry import Detector, cone_beam_rays
from regtorch.imaging.volume import Volume

Method = Literal["joseph", "trilinear", "siddon"]
Backend = Literal["auto", "torch", "cpu"]


def render(
    volume: Volume,
    parameters: Float[Tensor, "*b 9"],
    detector: Detector,
    view: str = "PA",
    *,
    method: Method = "joseph",
    backend: Backend = "auto",
) -> Float[Tensor, "*b h w"]:
    """Line integrals of attenuation from the source to every pixel, seen looking from the source to the detector.

    What lies behind the source or behind the detector is not counted, and air surrounds the volume. The images have
    the type and device of ``volume.data``, whose unit must be ``per_mm`` (see ``regtorch.imaging.attenuation``).

    Methods: ``siddon`` (Siddon 1985) is exact for voxels of constant value; ``joseph`` (Joseph 1982) interpolates
    bilinearly on each slice across the axis nearest to the ray; ``trilinear`` samples at half-voxel steps.
    Backends: ``torch`` is the readable, differentiable reference; ``cpu`` is fused, float32 and without a gradient.
    ``auto`` takes the fastest that can do what is asked.

    Raises ``RegtorchError`` for HU, poses that are not finite or have their source not in front of the detector, and
    for a method or backend that is not known or a backend that cannot do what is asked.
    """
    for what, name, known in (("method", method, get_args(Method)), ("backend", backend, get_args(Backend))):
        if name not in known:
            raise RegtorchError(f"{what} {name!r}: expected one of {', '.join(known)}")
    if volume.unit != "per_mm":
        raise RegtorchError(f"{volume.name}: values in {volume.unit}, expected attenuation per mm to render")
    if not bool(torch.isfinite(parameters).all()):
        raise RegtorchError("parameters that are not finite: expected nine numbers per pose")
    if bool((parameters[..., 2] <= 0).any()):
        raise RegtorchError(f"SDD of {float(parameters[..., 2].min()):g} mm: expected a positive distance")
    flat = parameters.reshape(-1, 9)
    rays = cone_beam_rays(flat.to(volume.data.device, torch.float64), detector, view, volume.voxel_from_ct)
    needs_gradient = torch.is_grad_enabled() and (parameters.requires_grad or volume.data.requires_grad)
    missing = cpu.why_not(volume.data, method, needs_gradient)
    if backend == "cpu" and missing:
        raise RegtorchError(f"backend 'cpu' cannot render this: {missing}")
    project = reference.project if backend == "torch" or missing else cpu.project
    images = project(volume.data, rays, volume.spacing_mm, detector.rows, detector.columns, method)
    return images.reshape(*parameters.shape[:-1], detector.rows, detector.columns)
