"""A whole radiograph with all that makes a real one unlike a DRR, and the truth about it."""

from collections.abc import Mapping
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.geometry import Detector
from regtorch.imaging import Volume
from regtorch.simulation.blur import add_scatter, blur_detector, blur_focal_spot
from regtorch.simulation.devices import add_devices
from regtorch.simulation.noise import add_quantum_noise
from regtorch.simulation.readout import add_gain_and_offset, digitise
from regtorch.simulation.simulator import DETECTOR, Simulation, bone_points, simulate
from regtorch.simulation.soft_tissue import move_soft_tissue
from regtorch.simulation.text import add_text

_LEFT, _RIGHT = (0.06, 0.06), (0.06, 0.89)
"""Where letters go: on the patient's right in PA and AP."""


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
    photons: float | None = 20000.0,
    fwhm_mm: float = 0.5,
    gain_rms: float = 0.005,
    bits: int | None = 12,
    full_scale: float = 0.5,
    text: str = "R",
) -> Simulation:
    """``simulate`` of the whole CT and then, in their order, the effects on the beam and on its image.

    Soft tissue moves, bones stay; devices; focal spot; scatter; photons are counted; the detector's blur (which the
    noise shares), gain, and range, which air overexposes; letters. An effect whose argument is 0, None or "" is left
    out and changes none of the others' random numbers. Parameters, matrix and targets are ``simulate``'s.
    """
    root = torch.Generator().manual_seed(seed)
    seeds = torch.randint(2**62, (4,), generator=root).tolist()
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
    if scatter_to_primary:
        image = add_scatter(image, detector, scatter_to_primary=scatter_to_primary)
    if photons:
        image = add_quantum_noise(image, photons, quanta)
    if fwhm_mm:
        image = blur_detector(image, detector, fwhm_mm=fwhm_mm)
    if gain_rms:
        image = add_gain_and_offset(image, gain_rms=gain_rms, generator=pixels)
    if bits:
        _, image = digitise(image, bits=bits, full_scale=full_scale)
    if text:
        image, _ = add_text(image, detector, text=text, place=_RIGHT if view == "PA" else _LEFT)
    return replace(simulation, image=image)
