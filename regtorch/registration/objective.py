"""One level of the pyramid, ready to say how well any pose explains the radiograph."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.drr import render
from regtorch.imaging import Radiograph, Volume, coarsen, level
from regtorch.scoring import gradient_correlations
from regtorch.similarity import gradient_correlation
from regtorch.similarity.gram import FixedGradients, fixed_gradients

Similarity = Callable[..., Float[Tensor, " b"]]

_PIXELS_AT_ONCE = 1 << 22


@dataclass(frozen=True)
class Level:
    """A radiograph averaged onto few pixels and a CT averaged onto voxels to match."""

    volume: Volume
    fixed: Radiograph
    view: str
    similarity: Similarity

    @classmethod
    def of(
        cls,
        attenuating: Volume,
        radiograph: Radiograph,
        view: str,
        similarity: Similarity,
        longest: int,
        magnification: float,
        voxel_per_pixel: float,
        least_ratio: float,
    ) -> "Level":
        """At most ``longest`` pixels a side; voxels of ``voxel_per_pixel`` times a pixel's size in the patient.

        Those that would not grow more than ``least_ratio`` times stay as they are.
        """
        fixed = level(radiograph, longest)
        voxel_mm = voxel_per_pixel * fixed.detector.pixel_mm / magnification
        volume = coarsen(attenuating, voxel_mm, least_ratio=least_ratio)
        fixed = replace(fixed, image=fixed.image.to(volume.data), weight=fixed.weight.to(volume.data))
        return cls(volume, fixed, view, similarity)

    @cached_property
    def _fixed_gradients(self) -> FixedGradients:
        return fixed_gradients(self.fixed.image, self.fixed.weight)

    def similarities(self, parameters: Float[Tensor, "m 9"]) -> Float[Tensor, " m"]:
        """One number per pose, in bounded memory; only these and the parameters travel to and from the device."""
        detector = self.fixed.detector
        if self.similarity is gradient_correlation:
            return gradient_correlations(self.volume, parameters, detector, self.view, self._fixed_gradients).cpu()
        at_once = max(1, _PIXELS_AT_ONCE // (detector.rows * detector.columns))
        found = []
        with torch.no_grad():
            for some in parameters.split(at_once):
                moving = render(self.volume, some, detector, self.view)
                found.append(self.similarity(moving, self.fixed.image, weight=self.fixed.weight))
        return torch.cat(found).cpu().double() if found else parameters.new_zeros(0)
