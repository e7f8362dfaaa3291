"""Small pictures: registrations that went wrong, or whose verdict did, and the default geometry of figure 2."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from PIL import Image
from torch import Tensor

from experiments.common.registrations import FAILED_MM, GOOD_MM
from regtorch.drr import render
from regtorch.files import written_whole
from regtorch.imaging import Radiograph, Volume, attenuation
from regtorch.imaging.radiograph import level
from regtorch.plotting import edge_strength

_PIXELS, _COLOURS = 250, 128
_FOUND, _TRUE = np.array([1.0, 0.6, 0.1]), np.array([0.0, 0.45, 0.7])


def went_wrong(row: Mapping[str, Any]) -> bool:
    """Whether the registration failed, or is good and not trusted."""
    return row["pde_mm"] > FAILED_MM or (row["pde_mm"] < GOOD_MM and row["status"] != "ok")


def write_picture(
    path: Path, ct: Volume, radiograph: Radiograph, view: str, found: Float[Tensor, "9"], true: Float[Tensor, "9"]
) -> None:
    """The radiograph with the edges of the bones in orange where they were found, and in blue where they are."""
    small = level(radiograph, _PIXELS)
    moving = render(attenuation(ct), torch.stack([true, found]), small.detector, view)
    picture = _grey(small)[..., None].repeat(3, axis=2)
    for drr, colour in zip(moving, (_TRUE, _FOUND), strict=True):
        share = 0.8 * edge_strength(drr).numpy()[..., None]
        picture = picture * (1 - share) + share * colour
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray((255 * picture).astype(np.uint8)).quantize(_COLOURS).save(path, optimize=True)


def write_default(path: Path, radiograph: Radiograph) -> None:
    """The radiograph of the default geometry: the background of figure 2."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with written_whole(path, path.suffix) as temporary:
        Image.fromarray((255 * _grey(level(radiograph, _PIXELS))).astype(np.uint8)).save(temporary, optimize=True)


def _grey(radiograph: Radiograph) -> np.ndarray:
    """Grey values from 0, dark, to 1."""
    grey = radiograph.image.numpy()
    low, high = np.quantile(grey, (0.005, 0.995))
    return np.clip((grey - low) / max(high - low, 1e-12), 0, 1)
