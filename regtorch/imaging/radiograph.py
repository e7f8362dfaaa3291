"""The radiograph: line integrals up to gain and offset, seen from the source, and the map to the file's pixels."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.errors import RegtorchError
from regtorch.geometry import Detector
from regtorch.imaging.averaging import overlaps


@dataclass(frozen=True)
class Radiograph:
    """One X-ray image, bone bright, as seen from the source. Raises ``RegtorchError`` for shapes that disagree.

    Args:
        image: Line integrals up to gain and offset.
        detector: The whole detector, centred on (0, 0), until ``level`` crops it.
        weight: From 0 to 1; 0 outside the collimated field and where masked.
        stored_from_pixel: Maps homogeneous (column, row) of ``image`` to (column, row) of the file (float64).
        sdd_mm: Source-detector distance, if the file states it.
        name: Name of the radiograph in messages.
        warnings: Faults found while reading, one line each.
    """

    image: Float[Tensor, "h w"]
    detector: Detector
    weight: Float[Tensor, "h w"]
    stored_from_pixel: Float[Tensor, "3 3"]
    sdd_mm: float | None = None
    name: str = "radiograph"
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        shape = (self.detector.rows, self.detector.columns)
        if tuple(self.image.shape) != shape or tuple(self.weight.shape) != shape:
            raise RegtorchError(
                f"{self.name}: image of {tuple(self.image.shape)} and weight of {tuple(self.weight.shape)}, "
                f"expected the detector's {shape}"
            )

    @classmethod
    def from_image(
        cls,
        image: Float[Tensor, "h w"],
        detector: Detector,
        *,
        weight: Float[Tensor, "h w"] | None = None,
        sdd_mm: float | None = None,
        name: str = "radiograph",
    ) -> "Radiograph":
        """A radiograph from an image that is already seen from the source, as a DRR is; ``weight`` is 1 by default."""
        weight = torch.ones_like(image) if weight is None else weight
        return cls(image, detector, weight, torch.eye(3, dtype=torch.float64), sdd_mm, name)

    @property
    def mirrored(self) -> bool:
        """Whether the file shows the image mirrored, as seen towards the source."""
        return float(torch.linalg.det(self.stored_from_pixel)) < 0

    @property
    def stored_size(self) -> tuple[int, int]:
        """Columns and rows of the file's image."""
        size = torch.tensor([self.detector.columns, self.detector.rows], dtype=torch.float64)
        columns, rows = (self.stored_from_pixel[:2, :2].abs() @ size).int().tolist()
        return columns, rows


def level(radiograph: Radiograph, longest: int) -> Radiograph:
    """One level of the pyramid: the box of pixels with weight, averaged onto at most ``longest`` pixels a side.

    The average is weighted, so masked pixels and pixels outside the field do not leak into their neighbours. A pixel
    without weight holds the weighted mean of the image. Raises ``RegtorchError`` for ``longest`` below 1 or if no
    pixel has weight.
    """
    if longest < 1:
        raise RegtorchError(f"pyramid level of {longest} pixels: expected at least 1")
    rows, columns = (radiograph.weight.amax(dim).nonzero().flatten() for dim in (1, 0))
    if not len(rows):
        raise RegtorchError(f"{radiograph.name}: every pixel is masked or outside the field, expected some to register")
    box = slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)
    image, weight = radiograph.image[box], radiograph.weight[box]
    cropped = radiograph.detector.crop(box[0].start, box[0].stop, box[1].start, box[1].stop)
    fitted = cropped.fit(longest)
    ratio = fitted.pixel_mm / cropped.pixel_mm
    down = overlaps(cropped.rows, fitted.rows, ratio).to(image)
    across = overlaps(cropped.columns, fitted.columns, ratio).to(image).mT
    mean = (image * weight).sum(dtype=torch.float64) / weight.sum(dtype=torch.float64)
    # Averaging differences from the mean keeps float32 precision if the image has a large offset.
    coarse_weight = down @ weight @ across
    difference = down @ ((image - mean.to(image)) * weight) @ across
    counts = coarse_weight > 1e-6
    coarse = torch.where(counts, difference / coarse_weight.clamp(min=1e-6), 0) + mean.to(image)
    pixel_from_coarse = radiograph.detector.pixel_from_plane() @ torch.linalg.inv(fitted.pixel_from_plane())
    return replace(
        radiograph,
        image=coarse,
        weight=torch.where(counts, coarse_weight, 0).clamp(max=1),
        detector=fitted,
        stored_from_pixel=radiograph.stored_from_pixel @ pixel_from_coarse,
    )
