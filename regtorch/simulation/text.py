"""Letters burnt into a radiograph, such as the marker of the patient's side."""

import math

import numpy as np
import torch
from jaxtyping import Bool, Float
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

from regtorch.errors import RegtorchError
from regtorch.geometry import Detector


def add_text(
    line_integrals: Float[Tensor, "h w"],
    detector: Detector,
    *,
    text: str = "R",
    height_mm: float = 15.0,
    place: tuple[float, float] = (0.06, 0.06),
    line_integral: float | None = None,
) -> tuple[Float[Tensor, "h w"], Bool[Tensor, "h w"]]:
    """Line integrals with letters in Pillow's own font, all of one value, and the pixels that they replace.

    ``place`` is where the upper left corner of the letters lies, as shares of the image's height and width;
    ``height_mm`` is the height of the letters. The value is the image's highest unless ``line_integral`` is given.
    """
    if not text.strip() or not 0 < height_mm < math.inf:
        raise RegtorchError(f"text {text!r} of {height_mm:g} mm: expected letters and a positive height")
    if not all(0 <= share < 1 for share in place):
        raise RegtorchError(f"text at {place}: expected shares of height and width, 0 to 1")
    rows, columns = line_integrals.shape
    drawn = _letters(text, max(3, round(height_mm / detector.pixel_mm)))
    row, column = (round(share * n) for share, n in zip(place, (rows, columns), strict=True))
    mask = torch.zeros(rows, columns, dtype=torch.bool)
    window = mask[row:, column:]
    window[: drawn.shape[0], : drawn.shape[1]] = drawn[: window.shape[0], : window.shape[1]]
    mask = mask.to(line_integrals.device)
    value = line_integrals.max() if line_integral is None else line_integrals.new_tensor(line_integral)
    return torch.where(mask, value, line_integrals), mask


def _letters(text: str, height: int) -> Bool[Tensor, "h w"]:
    """The letters, ``height`` pixels high and cut to it."""
    font = ImageFont.load_default(4 * height)
    left, top, right, bottom = font.getbbox(text)
    canvas = Image.new("L", (math.ceil(right - left) + 2, math.ceil(bottom - top) + 2))
    ImageDraw.Draw(canvas).text((1 - left, 1 - top), text, fill=255, font=font)
    canvas = canvas.crop(canvas.getbbox())
    width = max(1, round(canvas.width * height / canvas.height))
    return torch.from_numpy(np.asarray(canvas.resize((width, height), Image.Resampling.BOX)) > 127)
