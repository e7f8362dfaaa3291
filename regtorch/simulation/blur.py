"""The blur of a radiograph: detector, focal spot and scattered photons, each a Gaussian in the intensity."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.errors import RegtorchError
from regtorch.geometry import Detector

_SIGMA_PER_FWHM = 1 / math.sqrt(8 * math.log(2))

_SLAB = 4.0
"""Line integral of the patient for whom a scatter-to-primary ratio is meant."""


def blur_detector(
    line_integrals: Float[Tensor, "*b h w"], detector: Detector, *, fwhm_mm: float = 0.5
) -> Float[Tensor, "*b h w"]:
    """Line integrals as a detector sees them whose point spread is a Gaussian of ``fwhm_mm``."""
    _check(fwhm_mm, "point spread")
    return _log(_gaussian(_exp(line_integrals), fwhm_mm * _SIGMA_PER_FWHM / detector.pixel_mm), line_integrals)


def blur_focal_spot(
    line_integrals: Float[Tensor, "*b h w"],
    detector: Detector,
    parameters: Float[Tensor, "9"],
    *,
    spot_mm: float = 0.6,
) -> Float[Tensor, "*b h w"]:
    """Line integrals under a focal spot that is a Gaussian of FWHM ``spot_mm``.

    The penumbra in the detector plane is that of the middle of the CT, spot ODD / SOD (z_obj over z_s - z_obj), for
    all of the patient.
    """
    _check(spot_mm, "focal spot")
    sdd, odd = float(parameters[2]), float(parameters[5])
    if not 0 <= odd < sdd:
        raise RegtorchError(f"CT at {odd:g} mm, source at {sdd:g} mm: expected the CT between detector and source")
    return blur_detector(line_integrals, detector, fwhm_mm=spot_mm * odd / (sdd - odd))


def add_scatter(
    line_integrals: Float[Tensor, "*b h w"],
    detector: Detector,
    *,
    scatter_to_primary: float = 0.3,
    width_mm: float = 50.0,
) -> Float[Tensor, "*b h w"]:
    """Line integrals under a haze of photons that the patient scattered.

    They come from p exp(-p), what is scattered once and gets out (Ohnesorge et al. 1999): air sends none. They are
    spread by a Gaussian of standard deviation ``width_mm`` in the detector plane. ``scatter_to_primary`` is their ratio
    behind a wide uniform patient of 20 cm of water (p = 4); it grows as p does. I0 stays that of the primary beam, so
    bare detector beside a patient may go below 0.
    """
    _check(scatter_to_primary, "scatter-to-primary ratio", unit="")
    _check(width_mm, "scatter width")
    primary = _exp(line_integrals)
    scattered = primary * line_integrals.double().clamp(min=0) / _SLAB
    haze = _gaussian(scattered, width_mm / detector.pixel_mm)
    return _log(primary + scatter_to_primary * haze, line_integrals)


def _exp(line_integrals: Float[Tensor, "*b h w"]) -> Float[Tensor, "*b h w"]:
    return torch.exp(-line_integrals.double())


def _log(intensity: Float[Tensor, "*b h w"], like: Float[Tensor, "*b h w"]) -> Float[Tensor, "*b h w"]:
    return -intensity.clamp(min=torch.finfo(torch.float64).tiny).log().to(like)


def _gaussian(image: Float[Tensor, "*b h w"], sigma: float) -> Float[Tensor, "*b h w"]:
    """Blurred by ``sigma`` pixels; the image goes on mirrored at its borders, so nothing is lost there."""
    rows, columns = (_heat(n, sigma).to(image) for n in image.shape[-2:])
    return rows @ image @ columns


def _heat(n: int, sigma: float) -> Float[Tensor, "n n"]:
    """Discrete Gaussian (Lindeberg 1990): exp(sigma^2 / 2 of the second difference), whose modes are cosines.

    Unlike a sampled Gaussian it is right for a sigma far below a pixel.
    """
    mode = torch.arange(n, dtype=torch.float64)
    cosines = torch.cos(math.pi / n * mode[:, None] * (mode + 0.5))
    cosines = cosines / cosines.norm(dim=1, keepdim=True)
    decay = torch.exp(sigma**2 * (torch.cos(math.pi / n * mode) - 1))
    # Weights that should be 0 are so but for rounding, of either sign, which a dense shadow would show.
    return ((cosines.mT * decay) @ cosines).clamp(min=0)


def _check(value: float, what: str, unit: str = " mm") -> None:
    if not 0 <= value < math.inf:
        raise RegtorchError(f"{what} of {value:g}{unit}: expected 0 or more")
