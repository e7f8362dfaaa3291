"""The flat detector: how many pixels, how large, and where its image lies in the detector plane."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.errors import RegtorchError


@dataclass(frozen=True)
class Detector:
    """A grid of square pixels in the plane Z = 0 of the ``world`` frame.

    ``centre_mm`` is where the grid's centre lies, (X, Y): it is (0, 0) for a whole detector, whose centre is the
    world's origin. It moves when an image is cropped, so that the nine parameters keep their meaning.
    """

    rows: int
    columns: int
    pixel_mm: float
    centre_mm: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        if self.rows < 1 or self.columns < 1:
            raise RegtorchError(f"detector of {self.rows} x {self.columns} pixels: expected at least one each way")
        if not 0 < self.pixel_mm < float("inf"):
            raise RegtorchError(f"detector pixel of {self.pixel_mm} mm: expected a positive size")

    def pixel_from_plane(self, dtype: torch.dtype = torch.float64) -> Float[Tensor, "3 3"]:
        """Homogeneous map from (X, Y) in mm, in the detector plane, to (column, row)."""
        x, y = self.centre_mm
        return torch.tensor(
            [
                [1 / self.pixel_mm, 0, (self.columns - 1) / 2 - x / self.pixel_mm],
                [0, -1 / self.pixel_mm, (self.rows - 1) / 2 + y / self.pixel_mm],
                [0, 0, 1],
            ],
            dtype=dtype,
        )

    def crop(self, row0: int, row1: int, column0: int, column1: int) -> "Detector":
        """The detector of ``image[row0:row1, column0:column1]``."""
        x, y = self.centre_mm
        shift_x = ((column0 + column1) - self.columns) / 2 * self.pixel_mm
        shift_y = (self.rows - (row0 + row1)) / 2 * self.pixel_mm
        return Detector(row1 - row0, column1 - column0, self.pixel_mm, (x + shift_x, y + shift_y))

    def fit(self, longest: int) -> "Detector":
        """The same area on a coarser grid whose longer side has at most ``longest`` pixels; never a finer one.

        A rest that fills no whole pixel is left out evenly on both sides, so the centre stays.
        """
        factor = max(self.rows, self.columns) / longest
        if factor <= 1:
            return self
        rows, columns = (max(1, int(n / factor + 1e-9)) for n in (self.rows, self.columns))
        return Detector(rows, columns, self.pixel_mm * factor, self.centre_mm)
