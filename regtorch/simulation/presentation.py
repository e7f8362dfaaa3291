"""What a digital radiography unit makes of its log image before it writes it FOR PRESENTATION."""

import math
from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.errors import RegtorchError
from regtorch.geometry import Detector
from regtorch.simulation.blur import gaussian

STRENGTHS = {
    "soft": {"equalisation": 0.2, "edges": 0.5, "gradation": 1.2, "bits": 12},
    "hard": {"equalisation": 0.4, "edges": 1.0, "gradation": 1.6, "bits": 8},
}
"""Declared settings of ``process_for_presentation``: makers do not publish theirs."""

_RANGE = (0.02, 0.995)
"""Quantiles of the patient's line integrals that become 0 and 1."""
_AIR = 0.5
"""Line integrals less than this above the lowest are air, which units leave out of the range."""
_OCTAVES_MM = (1.4, 2.8, 5.6, 11.2, 22.4, 44.8)
"""Standard deviations of the Gaussians between the bands; what is finer is mostly noise and stays as it is."""
_CORE = 0.05
"""Share of a band's largest value below which its amplification is constant, so that noise is not lifted further."""
_EDGE_MM = 1.5
"""Standard deviation of the Gaussian of the unsharp mask."""


def process_for_presentation(
    line_integrals: Float[Tensor, "h w"],
    detector: Detector,
    *,
    equalisation: float = 0.2,
    edges: float = 0.5,
    gradation: float = 1.2,
    bits: int | None = 12,
    inverted: bool = False,
) -> Float[Tensor, "h w"]:
    """The image as a reader hands it over after a unit's processing for display: stretched to 0 to 1.

    The steps are those of Prokop et al. 2003, doi 10.1097/00005382-200307000-00004. The range of the image is
    normalised. Its bands are equalised, edges enhanced, and greys follow a look-up table. It is stored in whole numbers
    and stretched as ``read_radiograph`` does. With zeros and without bits it is the image up to gain and offset.
    Raises ``RegtorchError`` for numbers out of their range or an image without contrast.

    Args:
        line_integrals: The image.
        detector: Gives the pixel size; all scales are mm in the detector plane.
        equalisation: 0 to less than 1; bands follow a power of 1 less this, so weak structures are amplified
            (Vuylsteke and Schoeters 1994).
        edges: Gain of the unsharp mask.
        gradation: Slope in the middle of the sigmoid of DICOM PS3.3 C.11.2.1.3.1, whose window is 1 / slope; 0 for a
            linear table.
        bits: Bits of a stored value, 1 to 16; None to store no whole numbers.
        inverted: Whether the file stores bone dark. A reader turns a DICOM file round by MONOCHROME1, but no PNG.
    """
    if not (0 <= equalisation < 1 and 0 <= edges < math.inf and 0 <= gradation < math.inf):
        raise RegtorchError(
            f"equalisation {equalisation:g}, edges {edges:g}, gradation {gradation:g}: expected the first below 1 and "
            "none below 0"
        )
    if bits is not None and not 1 <= bits <= 16:
        raise RegtorchError(f"{bits} bits: expected 1 to 16")
    image = _normalised(line_integrals.double())
    if equalisation:
        image = _equalised(image, detector, 1 - equalisation)
    if edges:
        image = image + edges * (image - gaussian(image, _EDGE_MM / detector.pixel_mm))
    if gradation:
        image = torch.sigmoid(4 * gradation * (image - 0.5))
    image = -image if inverted else image
    if bits is not None:
        image = _stored(image, inverted, 2**bits - 1)
    low, high = image.amin(), image.amax()
    if not high > low:
        raise RegtorchError(f"image of one grey in {bits} bits: expected a radiograph to process for presentation")
    return ((image - low) / (high - low)).to(line_integrals)


def _stored(image: Float[Tensor, "h w"], inverted: bool, highest: int) -> Float[Tensor, "h w"]:
    """Whole numbers from 0 to ``highest``; what a linear table leaves over its ends is cut off."""
    return ((image + inverted) * highest).round().clamp(0, highest)


def _normalised(image: Float[Tensor, "h w"]) -> Float[Tensor, "h w"]:
    some = image[::2, ::2].flatten()
    patient = some[some > some.min() + _AIR]
    if not len(patient):
        raise RegtorchError("image without contrast: expected a radiograph to process for presentation")
    low, high = torch.quantile(patient, torch.tensor(_RANGE, dtype=image.dtype, device=image.device))
    return (image - low) / (high - low).clamp(min=_AIR)


def _equalised(image: Float[Tensor, "h w"], detector: Detector, power: float) -> Float[Tensor, "h w"]:
    """Each band's values x become M sign(x) (|x| / M)^power, where M is its largest; below ``_CORE`` M linear."""
    smooth = [gaussian(image, mm / detector.pixel_mm) for mm in _OCTAVES_MM]
    total = image - smooth[0] + smooth[-1]
    for finer, coarser in pairwise(smooth):
        band = finer - coarser
        share = band.abs() / band.abs().max().clamp(min=torch.finfo(band.dtype).tiny)
        total += band * share.clamp(min=_CORE) ** (power - 1)
    return total
