"""Blur of a radiograph by detector, focal spot and scatter, each a Gaussian applied to the intensity."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.errors import RegtorchError
from regtorch.geometry import Detector

_SIGMA_PER_FWHM = 1 / math.sqrt(8 * math.log(2))

_SLAB = 4.0
"""Line integral of the patient to whom a scatter-to-primary ratio refers."""


def blur_detector(
    line_integrals: Float[Tensor, "*b h w"], detector: Detector, *, fwhm_mm: float = 0.5
) -> Float[Tensor, "*b h w"]:
    """Blur line integrals by a detector whose point spread is a Gaussian with FWHM ``fwhm_mm``.

    Raises ``RegtorchError`` for a negative or infinite width.
    """
    _check(fwhm_mm, "point spread")
    return from_intensity(
        gaussian(intensity(line_integrals), fwhm_mm * _SIGMA_PER_FWHM / detector.pixel_mm), line_integrals
    )


def blur_focal_spot(
    line_integrals: Float[Tensor, "*b h w"],
    detector: Detector,
    parameters: Float[Tensor, "9"],
    *,
    spot_mm: float = 0.6,
) -> Float[Tensor, "*b h w"]:
    """Blur line integrals by a focal spot that is a Gaussian with FWHM ``spot_mm``.

    The whole patient gets the penumbra of the centre of the CT: spot ODD / SOD, which is z_obj / (z_s - z_obj), in the
    detector plane. ``parameters`` are the nine parameters (mm, rad). Raises ``RegtorchError`` for a negative or
    infinite spot, or if the CT is not between detector and source.
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
    """Add the photons that the patient scatters to line integrals.

    The scatter source is p exp(-p), the photons scattered once that leave the patient (Ohnesorge et al. 1999); air
    scatters none. I0 stays that of the primary beam, so line integrals beside the patient may become negative. Raises
    ``RegtorchError`` for a negative or infinite ratio or width.

    Args:
        line_integrals: Primary beam.
        detector: Gives the pixel size.
        scatter_to_primary: Ratio behind a wide uniform patient of 20 cm of water (p = 4); it is proportional to p.
        width_mm: Standard deviation of the Gaussian spread in the detector plane.
    """
    _check(scatter_to_primary, "scatter-to-primary ratio", unit="")
    _check(width_mm, "scatter width")
    primary = intensity(line_integrals)
    scattered = primary * line_integrals.double().clamp(min=0) / _SLAB
    haze = gaussian(scattered, width_mm / detector.pixel_mm)
    return from_intensity(primary + scatter_to_primary * haze, line_integrals)


def intensity(line_integrals: Float[Tensor, "*b h w"]) -> Float[Tensor, "*b h w"]:
    """Share of the open beam that arrives, in float64."""
    return torch.exp(-line_integrals.double())


def from_intensity(intensity: Float[Tensor, "*b h w"], like: Float[Tensor, "*b h w"]) -> Float[Tensor, "*b h w"]:
    """Line integrals of an intensity, with the type and device of ``like``."""
    return -intensity.clamp(min=torch.finfo(torch.float64).tiny).log().to(like)


def gaussian(image: Float[Tensor, "*b h w"], sigma: float) -> Float[Tensor, "*b h w"]:
    """Blur by ``sigma`` pixels; the image is mirrored at its borders, so its sum is kept."""
    rows, columns = (_heat(n, sigma).to(image) for n in image.shape[-2:])
    return rows @ image @ columns


def _heat(n: int, sigma: float) -> Float[Tensor, "n n"]:
    """Matrix of the discrete Gaussian (Lindeberg 1990): exp(sigma^2 / 2 times the second difference).

    Its modes are cosines. Unlike a sampled Gaussian it is right for a sigma far below one pixel.
    """
    mode = torch.arange(n, dtype=torch.float64)
    cosines = torch.cos(math.pi / n * mode[:, None] * (mode + 0.5))
    cosines = cosines / cosines.norm(dim=1, keepdim=True)
    decay = torch.exp(sigma**2 * (torch.cos(math.pi / n * mode) - 1))
    # Rounding makes some weights slightly negative instead of 0, which would show in a dense shadow.
    return ((cosines.mT * decay) @ cosines).clamp(min=0)


def _check(value: float, what: str, unit: str = " mm") -> None:
    if not 0 <= value < math.inf:
        raise RegtorchError(f"{what} of {value:g}{unit}: expected 0 or more")
