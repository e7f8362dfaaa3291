"""One level of the pyramid with one tissue: how similar poses are, and the way up."""

from dataclasses import dataclass, field, replace
from functools import partial
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.batches import at_once
from regtorch.drr import render, render_with_jacobian
from regtorch.imaging import Radiograph, Volume, coarsen, continued, level
from regtorch.optimization.climbing import levenberg_marquardt
from regtorch.optimization.evolution_climbing import evolve
from regtorch.registration.problem import Problem
from regtorch.registration.search.settings import Settings
from regtorch.registration.trace import Trace
from regtorch.registration.trust.uncertainty import clustered_covariance
from regtorch.registration.unknowns import normal_equations_of
from regtorch.scoring import gradient_correlations, normal_equations
from regtorch.similarity import gradient_correlation
from regtorch.similarity.gram import FixedGradients, fixed_gradients
from regtorch.similarity.robust import explained_weight


class Climbed(NamedTuple):
    """Where climbs ended (mm, rad), how similar that is, and J^T J of the unknowns there."""

    parameters: Float[Tensor, "n 9"]
    similarity: Float[Tensor, " n"]
    values: Float[Tensor, "n d"]
    jtj: Float[Tensor, "n d d"]


@dataclass(frozen=True)
class Matcher:
    """A level of the radiograph (``fixed``), a tissue's ``volume`` on voxels to match, and the fixed gradients.

    ``gradients`` carry the weight of the pixels: the radiograph's, or a robust one (``robust``).
    """

    problem: Problem
    settings: Settings
    volume: Volume
    fixed: Radiograph
    gradients: FixedGradients
    trace: Trace = field(repr=False)

    @classmethod
    def of(cls, problem: Problem, settings: Settings, tissue: Volume, pixels: int, trace: Trace) -> "Matcher":
        """At most ``pixels`` a side; voxels of ``voxel_per_pixel`` times a pixel's size in the patient."""
        fixed = level(problem.radiograph, pixels)
        voxel_mm = settings.voxel_per_pixel * fixed.detector.pixel_mm / problem.magnification
        volume = coarsen(tissue, voxel_mm, least_ratio=settings.least_averaging)
        return cls._with(problem, settings, volume, fixed, trace)

    @classmethod
    def on(cls, problem: Problem, settings: Settings, volume: Volume, pixels: int, trace: Trace) -> "Matcher":
        """The same with a volume that is coarse enough already."""
        return cls._with(problem, settings, volume, level(problem.radiograph, pixels), trace)

    @classmethod
    def _with(cls, problem: Problem, settings: Settings, volume: Volume, fixed: Radiograph, trace: Trace) -> "Matcher":
        fixed = replace(fixed, image=fixed.image.to(volume.data), weight=fixed.weight.to(volume.data))
        return cls(problem, settings, volume, fixed, fixed_gradients(fixed.image, fixed.weight), trace)

    def similarity(self, parameters: Float[Tensor, "n 9"]) -> Float[Tensor, " n"]:
        """One float64 number per pose on the CPU; poses and numbers alone travel to and from the device."""
        self.trace.evaluations += len(parameters)
        detector, view = self.fixed.detector, self.problem.view
        if self.problem.similarity is gradient_correlation:
            return gradient_correlations(self.volume, parameters, detector, view, self.gradients).cpu()
        found = [parameters.new_zeros(0)]
        with torch.no_grad():
            for some in parameters.split(at_once(detector.rows * detector.columns)) if len(parameters) else ():
                moving = render(self.volume, some, detector, view)
                similarity = self.problem.similarity(moving, self.fixed.image, weight=self.fixed.weight)
                found.append(similarity.cpu().double())
        return torch.cat(found)

    def climb(self, start: Float[Tensor, "n 9"], steps: int, damping: float | None = None) -> Climbed:
        """At most ``steps`` from each start by the unknowns, which are scaled by their effect on the image."""
        problem, settings = self.problem, self.settings
        unknowns = problem.unknowns
        optimizer = evolve
        if settings.derivatives:
            optimizer = partial(
                levenberg_marquardt,
                tolerance=settings.tolerance_mm,
                least_gain=settings.least_gain,
                least_similarity=settings.least_similarity,
            )
        ascent = optimizer(
            self._equations,
            unknowns.values(start),
            lower=unknowns.lower,
            upper=unknowns.upper,
            scale=1 / problem.sensitivity,
            steps=steps,
            damping=settings.damping if damping is None else damping,
        )
        self.trace.evaluations += ascent.evaluations
        return Climbed(problem.parameters(ascent.x), ascent.similarity, ascent.x, ascent.jtj)

    def _equations(self, values: Float[Tensor, "n d"]) -> tuple[Tensor, Tensor, Tensor]:
        """Similarity and normal equations of the unknowns, from the only image and bone that this level has."""
        unknowns = self.problem.unknowns
        place = self.fixed.detector, self.problem.view, self.gradients
        found = normal_equations(self.volume, self.problem.parameters(values), *place, free=unknowns.moved)
        similarity, jtj, jtr = (part.cpu() for part in found)
        return similarity, *normal_equations_of(unknowns.jacobian(values), jtj[:, None], jtr[:, None])

    def covariance(self, parameters: Float[Tensor, "9"]) -> Float[Tensor, "9 9"]:
        """Of the nine parameters (mm, rad; 0 for frozen ones), from ``clustered_covariance`` of the unknowns."""
        self.trace.evaluations += 1
        unknowns = self.problem.unknowns
        image, jacobian = render_with_jacobian(self.volume, parameters, self.fixed.detector, self.problem.view)
        by_unknowns = unknowns.jacobian(unknowns.values(parameters)[None])[0, 0, 0]
        slopes = torch.tensordot(by_unknowns.mT.to(jacobian), jacobian[unknowns.moved], dims=1)
        spread = clustered_covariance(image, slopes, self.gradients)
        moved = by_unknowns @ spread @ by_unknowns.mT
        if not bool(spread.isfinite().all()):
            moved = torch.full((len(moved),), torch.inf, dtype=torch.float64).diag_embed()
        result = torch.zeros(len(parameters), len(parameters), dtype=torch.float64)
        index = torch.tensor(unknowns.moved)
        result[index[:, None], index] = moved
        return result

    @property
    def pixels(self) -> int:
        """Pixels of the longer side."""
        return max(self.fixed.detector.rows, self.fixed.detector.columns)

    @property
    def pixel_mm(self) -> float:
        return self.fixed.detector.pixel_mm

    @property
    def voxel_px(self) -> float:
        """How many pixels the smallest side of a voxel covers."""
        return float(self.volume.spacing_mm.min()) / (self.pixel_mm / self.problem.magnification)

    def with_edges(self, width_px: float) -> "Matcher":
        """The same voxels read as constant up to edges that look ``width_px`` wide."""
        return replace(self, volume=self.volume.with_edges(width_px * self.pixel_mm / self.problem.magnification))

    def continued(self) -> "Matcher":
        """The same level of a patient that goes on beyond the CT; this one where the CT cuts nothing."""
        volume = continued(self.volume, self.problem.reach_mm)
        return self if volume is self.volume else replace(self, volume=volume)

    def robust(self, parameters: Float[Tensor, "9"]) -> "Matcher":
        """The same level with robust weights: pixels that the DRR of ``parameters`` does not explain count little."""
        self.trace.evaluations += 1
        moving = render(self.volume, parameters, self.fixed.detector, self.problem.view)
        weight = explained_weight(
            moving,
            self.fixed.image,
            self.fixed.weight,
            width_px=self.settings.robust_width_px,
            floor=self.settings.robust_floor,
        )
        return replace(self, gradients=fixed_gradients(self.fixed.image, weight))

    def with_gradients_of(self, other: "Matcher") -> "Matcher":
        """The same volume with the pixels' weights of another matcher of this level."""
        return replace(self, gradients=other.gradients)
