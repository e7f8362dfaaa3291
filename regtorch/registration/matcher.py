"""One level of the pyramid with one choice of tissue: how similar poses are, and the way up."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

from jaxtyping import Float
from torch import Tensor

from regtorch.drr import render
from regtorch.imaging import Volume, continued
from regtorch.optimization.climbing import Ascent, levenberg_marquardt
from regtorch.registration.objective import Level
from regtorch.registration.problem import Problem
from regtorch.scoring import gradient_correlations, normal_equations
from regtorch.similarity.gram import FixedGradients, fixed_gradients
from regtorch.similarity.robust import explained_weight

Climb = Callable[..., Ascent]

_WORTH_AVERAGING = 1.6
"""Voxels that would grow less are left: with a climb or two a level, averaging takes longer than it saves."""


@dataclass
class Tally:
    """How many poses were looked at."""

    evaluations: int = 0


@dataclass(frozen=True)
class Matcher:
    """Gradient correlation with ``gradients`` of a level's radiograph, which its weight or a sterner one has made."""

    problem: Problem
    level: Level
    gradients: FixedGradients
    tally: Tally = field(repr=False)
    optimizer: Climb = levenberg_marquardt

    @classmethod
    def of(
        cls,
        problem: Problem,
        pixels: int,
        voxel_per_pixel: float,
        volume: Volume,
        tally: Tally,
        optimizer: Climb = levenberg_marquardt,
    ) -> "Matcher":
        level = problem.level(pixels, voxel_per_pixel, volume, least_ratio=_WORTH_AVERAGING)
        return cls(problem, level, fixed_gradients(level.fixed.image, level.fixed.weight), tally, optimizer)

    def similarity(self, parameters: Float[Tensor, "n 9"]) -> Float[Tensor, " n"]:
        """Float64, on the CPU."""
        self.tally.evaluations += len(parameters)
        place = self.level.fixed.detector, self.problem.view, self.gradients
        return gradient_correlations(self.level.volume, parameters, *place).cpu()

    def climb(self, start: Float[Tensor, "n 9"], steps: int, damping: float = 1e-2) -> Ascent:
        """At most ``steps`` of the optimiser by what is free; parameters are scaled by what they move."""
        problem = self.problem

        def equations(values: Float[Tensor, "n d"]) -> tuple[Tensor, ...]:
            place = self.level.fixed.detector, problem.view, self.gradients
            found = normal_equations(self.level.volume, problem.embed(values), *place, free=problem.free)
            return tuple(part.cpu() for part in found)

        ascent = self.optimizer(
            equations,
            start[:, problem.free],
            lower=problem.lower,
            upper=problem.upper,
            scale=1 / problem.sensitivity(),
            steps=steps,
            damping=damping,
        )
        self.tally.evaluations += ascent.evaluations
        return ascent

    @property
    def voxel_px(self) -> float:
        """How many pixels the smallest side of a voxel covers."""
        pixel_mm = self.level.fixed.detector.pixel_mm / self.problem.magnification
        return float(self.level.volume.spacing_mm.min()) / pixel_mm

    def with_edges(self, width_px: float) -> "Matcher":
        """The same voxels read as constant up to edges that a pixel shows ``width_px`` wide."""
        level = self.level
        width_mm = width_px * level.fixed.detector.pixel_mm / self.problem.magnification
        return replace(self, level=replace(level, volume=level.volume.with_edges(width_mm)))

    def continued(self) -> "Matcher":
        """The same level of a patient that goes on beyond the CT."""
        volume = continued(self.level.volume, self.problem.reach_mm)
        return self if volume is self.level.volume else replace(self, level=replace(self.level, volume=volume))

    def forgiving(self, parameters: Float[Tensor, "9"]) -> "Matcher":
        """The same level where pixels that the DRR of ``parameters`` does not explain count little."""
        self.tally.evaluations += 1
        fixed = self.level.fixed
        moving = render(self.level.volume, parameters, fixed.detector, self.problem.view)
        weight = explained_weight(moving, fixed.image, fixed.weight)
        return replace(self, gradients=fixed_gradients(fixed.image, weight))
