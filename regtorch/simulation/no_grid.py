"""Scatter of a radiograph taken without an anti-scatter grid, as mobile units do."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.errors import RegtorchError
from regtorch.geometry import Detector
from regtorch.simulation.blur import from_intensity, gaussian, intensity

_BEHIND_MM = 10.0
"""Standard deviation of the Gaussian average that finds the thickest part of the patient, in the detector plane."""


def add_scatter_without_grid(
    line_integrals: Float[Tensor, "h w"],
    detector: Detector,
    patient: Float[Tensor, "rows columns"] | None = None,
    *,
    scatter_to_primary: float = 5.0,
    widths_mm: tuple[float, ...] = (25.0, 80.0),
    shares: tuple[float, ...] = (0.4, 0.6),
) -> Float[Tensor, "h w"]:
    """Add all scatter of a thick patient to line integrals, scaled to its ratio behind the thickest part.

    The source is p exp(-p) as in ``add_scatter`` (Ohnesorge et al. 1999). A sum of Gaussians spreads it: one fits the
    scatter of slabs (Boone, Arnold and Seibert 1986), several fit objects better (doi 10.3233/XST-16185). Their widths
    are declared. Without a grid, about 90 % of what reaches the film behind a mediastinum is scatter (Niklason,
    Sorenson and Nelson 1981): a ratio of 9. Large phantoms reach about 5, with scatter that varies slowly (Malusek,
    Sandborg and Alm Carlsson 2003). A ratio of 0 changes nothing. Raises ``RegtorchError`` for a negative or infinite
    number, shares that do not sum to 1, or images of different shapes.

    Args:
        line_integrals: The image.
        detector: Gives the pixel size.
        patient: Line integrals of the patient alone, the source of scatter; by default the image. Metal in the beam
            would otherwise count as the thickest part.
        scatter_to_primary: Ratio behind the thickest part of the patient: least mean primary over 1 cm.
        widths_mm: Standard deviations of the Gaussians in the detector plane, mm.
        shares: Share of each Gaussian.
    """
    patient = line_integrals if patient is None else patient
    _check(scatter_to_primary, widths_mm, shares)
    if patient.shape != line_integrals.shape:
        raise RegtorchError(f"patient of {tuple(patient.shape)}, image of {tuple(line_integrals.shape)}: expected one")
    if not scatter_to_primary:
        return line_integrals
    primary = intensity(patient)
    source = primary * patient.double().clamp(min=0)
    spread = [share * gaussian(source, mm / detector.pixel_mm) for mm, share in zip(widths_mm, shares, strict=True)]
    haze = torch.stack(spread).sum(0)
    behind = gaussian(primary, _BEHIND_MM / detector.pixel_mm)
    thickest = behind.argmin()
    found = haze.flatten()[thickest] / behind.flatten()[thickest]
    if not found > 0:
        return line_integrals
    return from_intensity(intensity(line_integrals) + scatter_to_primary / found * haze, line_integrals)


def _check(ratio: float, widths_mm: tuple[float, ...], shares: tuple[float, ...]) -> None:
    if not all(0 <= value < math.inf for value in (ratio, *widths_mm, *shares)):
        raise RegtorchError(f"scatter-to-primary ratio {ratio:g}, widths {widths_mm} mm: expected 0 or more")
    if len(widths_mm) != len(shares) or not math.isclose(sum(shares), 1):
        raise RegtorchError(f"shares {shares} of widths {widths_mm} mm: expected one for each, with a sum of 1")
