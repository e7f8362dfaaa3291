"""A realistic radiograph: a DRR with every effect of this package, and its true geometry."""

from collections.abc import Mapping
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.errors import RegtorchError
from regtorch.geometry import Detector
from regtorch.imaging import Volume
from regtorch.simulation.blur import add_scatter, blur_detector, blur_focal_spot
from regtorch.simulation.devices import add_devices
from regtorch.simulation.no_grid import add_scatter_without_grid
from regtorch.simulation.noise import add_quantum_noise
from regtorch.simulation.presentation import STRENGTHS, process_for_presentation
from regtorch.simulation.readout import add_gain_and_offset, digitise
from regtorch.simulation.simulator import DETECTOR, Simulation, bone_points, simulate
from regtorch.simulation.soft_tissue import move_soft_tissue
from regtorch.simulation.text import add_text

_LEFT, _RIGHT = (0.06, 0.06), (0.06, 0.89)
"""Position of the letters (shares of height and width): on the patient's right in PA and AP."""


def realistic(
    ct: Volume,
    parameters: Float[Tensor, "9"],
    view: str = "PA",
    detector: Detector = DETECTOR,
    *,
    seed: int = 0,
    targets: Mapping[str, tuple[float, float, float]] | None = None,
    soft_tissue_mm: float = 8.0,
    devices: int = 3,
    spot_mm: float = 0.6,
    scatter_to_primary: float = 0.3,
    scatter_without_grid: float = 0.0,
    photons: float | None = 20000.0,
    fwhm_mm: float = 0.5,
    gain_rms: float = 0.005,
    bits: int | None = 12,
    full_scale: float = 0.5,
    text: str = "R",
    processing: str | None = None,
) -> Simulation:
    """Simulate a radiograph of the whole CT with the effects of a real beam and detector.

    Effects apply in the order of their arguments. An effect whose argument is 0, None or "" is left out, without any
    change to the random numbers of the others. Parameters, matrix and targets are those of ``simulate``. Raises
    ``RegtorchError`` as ``simulate`` and the single effects do.

    Args:
        targets: Named points (LPS mm); by default, points spread over the bones.
        soft_tissue_mm: RMS length of the movement of soft tissue; bones stay.
        devices: Number of wires; a block is added too.
        spot_mm: FWHM of the focal spot.
        scatter_to_primary: Ratio behind 20 cm of water, as ``add_scatter`` adds it.
        scatter_without_grid: Ratio behind the thickest part of the patient, as ``add_scatter_without_grid`` adds it.
        photons: Per pixel of the open beam; adds quantum noise.
        fwhm_mm: FWHM of the detector's point spread, which blurs the noise too.
        gain_rms: Relative deviation of the pixels' gain.
        bits: Bits of a stored count.
        full_scale: Intensity of the highest count, as a share of the open beam; 0.5 overexposes air.
        text: Letters in the image.
        processing: ``soft`` or ``hard`` processing for presentation, ``STRENGTHS``; the image is then 0 to 1.
    """
    seeds = torch.randint(2**62, (4,), generator=torch.Generator().manual_seed(seed)).tolist()
    tissue, metal, quanta, pixels = (torch.Generator().manual_seed(s) for s in seeds)
    targets = targets or bone_points(ct)
    if soft_tissue_mm:
        ct = move_soft_tissue(ct, rms_mm=soft_tissue_mm, generator=tissue)
    simulation = simulate(ct, parameters, view, detector=detector, targets=targets, seed=seed)
    image = simulation.image
    if devices:
        image, _ = add_devices(image, detector, count=devices, generator=metal)
    if spot_mm:
        image = blur_focal_spot(image, detector, simulation.parameters, spot_mm=spot_mm)
    image = _scattered(image, detector, simulation.image, scatter_to_primary, scatter_without_grid)
    if photons:
        image = add_quantum_noise(image, photons, quanta)
    if fwhm_mm:
        image = blur_detector(image, detector, fwhm_mm=fwhm_mm)
    image = _read_out(image, gain_rms, bits, full_scale, pixels)
    return replace(simulation, image=_shown(image, detector, view, text, processing))


def _scattered(
    image: Float[Tensor, "h w"], detector: Detector, patient: Float[Tensor, "h w"], with_grid: float, without: float
) -> Float[Tensor, "h w"]:
    if with_grid:
        image = add_scatter(image, detector, scatter_to_primary=with_grid)
    if without:
        image = add_scatter_without_grid(image, detector, patient, scatter_to_primary=without)
    return image


def _read_out(
    image: Float[Tensor, "h w"], gain_rms: float, bits: int | None, full_scale: float, generator: torch.Generator
) -> Float[Tensor, "h w"]:
    if gain_rms:
        image = add_gain_and_offset(image, gain_rms=gain_rms, generator=generator)
    if bits:
        _, image = digitise(image, bits=bits, full_scale=full_scale)
    return image


def _shown(
    image: Float[Tensor, "h w"], detector: Detector, view: str, text: str, processing: str | None
) -> Float[Tensor, "h w"]:
    if text:
        image, _ = add_text(image, detector, text=text, place=_RIGHT if view == "PA" else _LEFT)
    if not processing:
        return image
    if processing not in STRENGTHS:
        raise RegtorchError(f"processing {processing!r}: expected one of {', '.join(STRENGTHS)}")
    return process_for_presentation(image, detector, **STRENGTHS[processing])
