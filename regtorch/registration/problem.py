"""The problem that every search method gets."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from regtorch.evaluation import projection_distances
from regtorch.geometry import X_OBJ, Y_OBJ, Z_OBJ, Z_S, pixel_from_patient
from regtorch.imaging import Radiograph, Volume
from regtorch.registration.unknowns import Range, Unknowns, selection

Progress = Callable[[float, str], None]
Similarity = Callable[..., Float[Tensor, " b"]]

SHIFTED = (X_OBJ, Y_OBJ)
"""The parameters that move the image in its plane and hardly change it."""

_STEP = 1e-3
"""Share of an unknown's step by which its effect on the image is measured."""

_EFFECT = (1e-3, 1e6)
"""Least and largest effect of an unknown, mm in the detector plane per unit: optimisers scale by the inverse."""


@dataclass(frozen=True)
class Problem:
    """A pair to register, and where to look.

    Args:
        attenuating: The CT above ``threshold_hu``, cropped to it, per mm.
        threshold_hu: From which HU on the CT counts as bone; None: all tissue.
        whole: All tissue of the CT, per mm.
        radiograph: The fixed image.
        view: How the patient stands at zero rotation.
        similarity: How alike two images are.
        searched: The start and the range of the nine parameters.
        points: Points on the anatomy in the image (LPS mm), by which moves of the image are measured.
        seed: Of all random numbers.
        progress: Called with the share done and a short text.
        coordinates: Which numbers the climbs vary: ``selection`` or ``detector_frame``.
    """

    attenuating: Volume
    threshold_hu: float | None
    whole: Volume
    radiograph: Radiograph
    view: str
    similarity: Similarity
    searched: Range
    points: Float[Tensor, "n 3"]
    seed: int
    progress: Progress
    coordinates: Callable[[Range], Unknowns] = selection

    @cached_property
    def unknowns(self) -> Unknowns:
        """The numbers that climbs vary."""
        return self.coordinates(self.searched)

    def parameters(self, values: Float[Tensor, "*b d"]) -> Float[Tensor, "*b 9"]:
        """The nine parameters of the only image and bone."""
        return self.unknowns.parameters(values)[..., 0, 0, :]

    @property
    def magnification(self) -> float:
        """Magnification of the patient's middle at the start."""
        initial = self.searched.initial
        return float(initial[Z_S] / (initial[Z_S] - initial[Z_OBJ]))

    @property
    def reach_mm(self) -> float:
        """Distance from the CT's origin along the body beyond which no pose in the range shows the patient."""
        half_image = max(self.radiograph.detector.rows, self.radiograph.detector.columns) / 2
        aside = float(self.searched.initial[Y_OBJ].abs() + self.searched.half_range[Y_OBJ])
        return half_image * self.radiograph.detector.pixel_mm + aside

    def pixel_from_patient(self, parameters: Float[Tensor, "*b 9"]) -> Float[Tensor, "*b 3 4"]:
        """Projection from LPS mm to (column, row) of the whole radiograph, seen from the source."""
        return pixel_from_patient(parameters, self.radiograph.detector, self.view, self.attenuating.origin_patient_mm)

    def all_free(self, half_range: Float[Tensor, "9"]) -> "Problem":
        """The same with all nine parameters free: frozen ones within ``half_range`` (mm, rad)."""
        return replace(self, searched=self.searched.released(half_range))

    def mirrored(self) -> "Problem":
        """The same with the radiograph mirrored left to right, and source and patient with it."""
        image, weight = self.radiograph.image.flip(1), self.radiograph.weight.flip(1)
        return replace(
            self,
            radiograph=replace(self.radiograph, image=image, weight=weight),
            searched=self.searched.mirrored(),
        )

    def shift_mm(self, parameters: Float[Tensor, "*b 9"], others: Float[Tensor, "*#b 9"]) -> Float[Tensor, "*b"]:
        """Mean distance in the detector plane between the projections of the points by two poses."""
        matrices = [self.pixel_from_patient(p) for p in (parameters, others)]
        return projection_distances(*matrices, self.points, self.radiograph.detector.pixel_mm).mean(-1)

    def same_place(
        self, parameters: Float[Tensor, "*b 9"], others: Float[Tensor, "*#b 9"], within_mm: float
    ) -> Bool[Tensor, "*b"]:
        """Whether two poses put the anatomy at the same place of the image, to within a mean distance."""
        return self.shift_mm(parameters, others) <= within_mm

    def distinct(self, parameters: Float[Tensor, "n 9"], within_mm: float, most: int, each: int = 1) -> list[int]:
        """Indices of the first ``most`` poses of which no more than ``each`` are at the same place."""
        kept: list[int] = []
        for index in range(len(parameters)):
            if len(kept) == most:
                break
            if not kept or int(self.same_place(parameters[kept], parameters[index], within_mm).sum()) < each:
                kept.append(index)
        return kept

    @cached_property
    def sensitivity(self) -> Float[Tensor, " d"]:
        """How far a unit of each unknown moves the points in the detector plane, mm; kept away from 0 and infinity."""
        step = self.unknowns.step * _STEP
        moved = self.parameters(self.unknowns.values(self.searched.initial) + torch.diag(step))
        return (self.shift_mm(moved, self.searched.initial) / step).clamp(*_EFFECT)
