"""Pictures of a registration."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from torch import Tensor

from regtorch.drr import render
from regtorch.geometry import project
from regtorch.imaging import Radiograph, Volume
from regtorch.imaging.orientation import turned
from regtorch.imaging.radiograph import level
from regtorch.registration import Registration

_INCHES, _DPI, _PIXELS = 8.0, 120, 1000
_EDGE = np.array([1.0, 0.6, 0.1])  # orange over grey: told apart by colour-blind readers
_DARK = 0.4  # of its brightness is what did not count
_STATUS_COLOURS = {"ok": "#0072b2", "doubtful": "#e69f00", "failed": "#d55e00"}


def write_overlay(
    path: str | Path,
    attenuating: Volume,
    radiograph: Radiograph,
    registration: Registration,
    targets: Mapping[str, tuple[float, float, float]],
) -> None:
    """Save the radiograph as its file shows it, the edges of the bones where they were found, and named targets.

    ``attenuating`` (1/mm) gives the edges; targets are in LPS mm. Pixels that did not count, masked or beyond
    collimators, are dark.
    """
    everywhere = torch.ones_like(radiograph.weight)
    shown, counted = (
        level(replace(radiograph, image=image, weight=everywhere), _PIXELS)
        for image in (radiograph.image, radiograph.weight)
    )
    moving = render(attenuating, registration.parameters, shown.detector, registration.view)
    pixel_from_stored = torch.linalg.inv(shown.stored_from_pixel)
    grey = turned(shown.image, pixel_from_stored).numpy()
    edges = turned(edge_strength(moving), pixel_from_stored).numpy()
    low, high = np.quantile(grey, (0.005, 0.995))
    picture = np.clip((grey - low) / max(high - low, 1e-12), 0, 1)[..., None].repeat(3, axis=2)
    picture *= _DARK + (1 - _DARK) * turned(counted.image, pixel_from_stored).numpy()[..., None]
    picture = picture * (1 - 0.8 * edges[..., None]) + 0.8 * edges[..., None] * _EDGE

    height, width = grey.shape
    figure = Figure(figsize=(_INCHES, _INCHES * height / width + 0.5), dpi=_DPI, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    rows, columns = shown.image.shape
    corners = torch.tensor([[-0.5, columns - 0.5], [-0.5, rows - 0.5], [1, 1]], dtype=torch.float64)
    (left, right), (top, bottom) = (shown.stored_from_pixel[:2] @ corners).sort().values.tolist()
    axes.imshow(picture, interpolation="antialiased", extent=(left, right, bottom, top))
    points = torch.tensor(list(targets.values()), dtype=torch.float64).reshape(-1, 3)
    for name, (column, row) in zip(targets, project(registration.pixel_from_patient, points).tolist(), strict=True):
        if left <= column <= right and top <= row <= bottom:
            axes.plot(column, row, "+", color="#56b4e9", markersize=9, markeredgewidth=1.8)
            axes.annotate(
                name, (column, row), (6, 4), textcoords="offset points", color="#56b4e9", fontsize=10, weight="bold"
            )
    axes.set_axis_off()
    axes.set_title(
        f"{registration.view}, similarity {registration.similarity:.3f}: {registration.status}",
        color=_STATUS_COLOURS[registration.status],
        fontsize=11,
    )
    figure.savefig(path)


def edge_strength(image: Float[Tensor, "h w"]) -> Float[Tensor, "h w"]:
    """Thin edges, 0 to 1: where the gradient is strong and largest across itself."""
    gy, gx = torch.gradient(image.double())
    length = torch.hypot(gx, gy)
    angle = torch.atan2(gy, gx)
    across = length.new_zeros(length.shape)
    for step in (-1, 1):
        r, c = torch.meshgrid(*(torch.arange(n) for n in length.shape), indexing="ij")
        r = (r + step * angle.sin().round()).long().clamp(0, length.shape[0] - 1)
        c = (c + step * angle.cos().round()).long().clamp(0, length.shape[1] - 1)
        across = torch.maximum(across, length[r, c])
    strong = torch.quantile(length.flatten()[:: max(1, length.numel() // 500_000)], 0.95).clamp(min=1e-12)
    return torch.where(length >= across, (length / strong).clamp(max=1), 0)
