"""Other things in the beam: wires and catheters across the image and one dense block, as of an instrument."""

import math
from itertools import pairwise

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from regtorch.errors import RegtorchError
from regtorch.geometry import Detector

_SEGMENTS = 64
_BLOCK_MM = ((6.0, 12.0), (15.0, 30.0))
"""Smallest and largest width, and length, of the block."""


def add_devices(
    line_integrals: Float[Tensor, "h w"],
    detector: Detector,
    *,
    count: int = 3,
    width_mm: tuple[float, float] = (0.5, 2.0),
    metal_per_mm: float = 0.5,
    block: bool = True,
    block_line_integral: float = 4.0,
    generator: torch.Generator,
) -> tuple[Float[Tensor, "h w"], Bool[Tensor, "h w"]]:
    """Line integrals with ``count`` curved wires from border to border, and the pixels that any device covers.

    All sizes are the shadows', in mm in the detector plane. A wire is a cylinder of a diameter drawn from
    ``width_mm``, whose chord adds ``metal_per_mm`` for every mm; the block is a rectangle of at most 12 x 30 mm.
    """
    if not (count >= 0 and 0 < width_mm[0] <= width_mm[1] < math.inf):
        raise RegtorchError(f"{count} wires, {width_mm[0]:g} to {width_mm[1]:g} mm wide: expected widths over 0")
    if line_integrals.shape != (detector.rows, detector.columns):
        raise RegtorchError(f"image of {tuple(line_integrals.shape)}: expected {detector.rows, detector.columns}")
    metal = torch.zeros(detector.rows, detector.columns, dtype=torch.float64)
    for _ in range(count):
        share = float(torch.rand((), generator=generator, dtype=torch.float64))
        radius = (width_mm[0] + share * (width_mm[1] - width_mm[0])) / 2
        distance = _distance_mm(_curve_mm(detector, generator), detector, 2 * (radius + detector.pixel_mm))
        metal += metal_per_mm * _chord_mm(distance, radius, detector.pixel_mm)
    if block:
        metal += block_line_integral * _block(detector, generator)
    return line_integrals + metal.to(line_integrals), (metal > 0).to(line_integrals.device)


def _pixels_mm(detector: Detector) -> tuple[Float[Tensor, " h"], Float[Tensor, " w"]]:
    """Distance of rows and columns from the image's upper left corner."""
    return tuple((torch.arange(n).double() + 0.5) * detector.pixel_mm for n in (detector.rows, detector.columns))


def _curve_mm(detector: Detector, generator: torch.Generator) -> Float[Tensor, "n 2"]:
    """Points (down, across) of a cubic Bezier curve from one border to the opposite one, and beyond both."""
    size = torch.tensor([detector.rows, detector.columns], dtype=torch.float64) * detector.pixel_mm
    along = int(torch.rand((), generator=generator) < 0.5)
    control = torch.rand(4, 2, generator=generator, dtype=torch.float64)
    control[:, along] = torch.tensor([-0.05, 0.3, 0.7, 1.05], dtype=torch.float64)
    t = torch.linspace(0, 1, _SEGMENTS + 1, dtype=torch.float64)[:, None]
    powers = torch.cat([(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3], 1)
    return powers @ (control * size)


def _distance_mm(curve: Float[Tensor, "n 2"], detector: Detector, reach: float) -> Float[Tensor, "h w"]:
    """From every pixel to the curve, where it is less than ``reach``; infinite elsewhere."""
    down, across = _pixels_mm(detector)
    distance = torch.full((detector.rows, detector.columns), math.inf, dtype=torch.float64)
    for start, end in pairwise(curve):
        low, high = torch.minimum(start, end) - reach, torch.maximum(start, end) + reach
        rows = ((down >= low[0]) & (down <= high[0])).nonzero().flatten()
        columns = ((across >= low[1]) & (across <= high[1])).nonzero().flatten()
        if not len(rows) or not len(columns):
            continue
        window = slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)
        pixels = torch.stack(torch.meshgrid(down[rows], across[columns], indexing="ij"), -1)
        step = end - start
        share = ((pixels - start) @ step / step.square().sum().clamp(min=1e-12)).clamp(0, 1)
        nearest = start + share[..., None] * step
        distance[window] = torch.minimum(distance[window], (pixels - nearest).norm(dim=-1))
    return distance


def _chord_mm(distance: Float[Tensor, "h w"], radius: float, pixel_mm: float) -> Float[Tensor, "h w"]:
    """Mean chord of a cylinder over a pixel across it, so that its mass is kept however thin it is."""

    def area(x: Float[Tensor, "h w"]) -> Float[Tensor, "h w"]:
        x = x.clamp(-radius, radius)
        return x * (radius**2 - x**2).clamp(min=0).sqrt() + radius**2 * torch.asin((x / radius).clamp(-1, 1))

    return (area(distance + pixel_mm / 2) - area(distance - pixel_mm / 2)).clamp(min=0) / pixel_mm


def _block(detector: Detector, generator: torch.Generator) -> Float[Tensor, "h w"]:
    """Coverage by a rectangle in the middle 70 % of the image, turned at random."""
    place, size = torch.rand(2, 2, generator=generator, dtype=torch.float64)
    angle = math.pi * float(torch.rand((), generator=generator, dtype=torch.float64))
    low, high = torch.tensor(_BLOCK_MM, dtype=torch.float64).T
    half = (low + size * (high - low)) / 2
    down, across = torch.meshgrid(*_pixels_mm(detector), indexing="ij")
    down = down - (0.15 + 0.7 * float(place[0])) * detector.rows * detector.pixel_mm
    across = across - (0.15 + 0.7 * float(place[1])) * detector.columns * detector.pixel_mm
    along = down * math.cos(angle) + across * math.sin(angle)
    aside = across * math.cos(angle) - down * math.sin(angle)
    covered = [((h - x.abs()) / detector.pixel_mm + 0.5).clamp(0, 1) for x, h in zip((aside, along), half, strict=True)]
    return covered[0] * covered[1]
