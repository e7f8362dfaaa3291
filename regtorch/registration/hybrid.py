"""The default search: screening of all shifts at once, then Levenberg-Marquardt from coarse to fine.

Soft tissue guides the search where the radiograph shows it, and bone refines: candidates come from bone alone and from
all tissue, climb with bone alone from the second level on, and are ranked by both together.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.errors import RegtorchError
from regtorch.imaging import Volume
from regtorch.optimization.levenberg_marquardt import Ascent, levenberg_marquardt
from regtorch.registration.problem import Found, Problem
from regtorch.registration.screening import screen
from regtorch.scoring import gradient_correlations, normal_equations
from regtorch.similarity import gradient_correlation
from regtorch.similarity.gram import fixed_gradients


@dataclass(frozen=True)
class Stage:
    """A level of the pyramid: the longer side of its image, how many candidates climb there, how many steps each."""

    pixels: int
    candidates: int
    steps: int


_PLACE_MM = 10.0
_STAGES = (Stage(125, 24, 15), Stage(250, 6, 12), Stage(500, 2, 20))


def hybrid(
    problem: Problem,
    *,
    poses: int = 2000,
    first: Stage = Stage(50, 100, 15),
    stages: tuple[Stage, ...] = _STAGES,
    voxel_per_pixel: float = 1.3,
    trusted_similarity: float = 0.9,
) -> Found:
    """Screen ``poses`` draws for bone alone and for all tissue, climb from the best, keep what explains most.

    Each tissue's best candidates climb on the first level with that tissue; those that go on are the best ones, but at
    most three of a place. From there on all climb with bone alone, fewer on each level, and the mean of the
    similarities of bone and of all tissue ranks them. If all tissue in the end reaches ``trusted_similarity``, and
    more than bone, it has not moved, and makes the answer. A voxel is ``voxel_per_pixel`` times what a pixel covers in
    the patient. ``Found.starts`` are the ends of the second level's climbs, by that mean.

    Raises ``RegtorchError`` for another similarity than gradient correlation, and for no poses, candidates or stages.
    """
    if problem.similarity is not gradient_correlation:
        raise RegtorchError("similarity other than gradient correlation: expected that, or the method evolution")
    if not stages or min(poses, *(stage.candidates for stage in (first, *stages))) < 1:
        raise RegtorchError("no poses, stages or candidates: expected at least one of each")
    total, tally = len(stages) + 3.0, _Tally()
    bone, whole = problem.attenuating, problem.whole
    alike = bone.data.shape == whole.data.shape and torch.equal(bone.data, whole.data)
    tissues = (bone,) if alike else (bone, whole)
    candidates = []
    for number, tissue in enumerate(tissues):
        problem.progress(number / total, f"screening {poses} poses")
        matcher = _Matcher(problem, first.pixels, voxel_per_pixel, tissue, tally)
        screened = screen(problem, matcher.level, poses, (problem.seed + number) % 2**32).parameters
        tally.evaluations += poses
        chosen = _distinct(problem, screened, matcher.level.fixed.detector.pixel_mm, first.candidates)
        climbed = matcher.climb(screened[chosen], first)
        places = problem.embed(climbed.x[climbed.similarity.argsort(descending=True)])
        goes_on = max(1, stages[0].candidates // len(tissues))
        candidates.append(places[_distinct(problem, places, _PLACE_MM, goes_on, each=3)])
    parameters, starts = torch.cat(candidates), None
    for number, stage in enumerate(stages):
        problem.progress((number + 2) / total, f"{stage.pixels} pixels, {len(parameters)} candidates")
        matchers = [_Matcher(problem, stage.pixels, voxel_per_pixel, tissue, tally) for tissue in tissues]
        climbed = matchers[0].climb(parameters[: stage.candidates], stage)
        parameters = problem.embed(climbed.x)
        together = sum([matcher.similarity(parameters) for matcher in matchers[1:]], climbed.similarity) / len(tissues)
        order = together.argsort(descending=True)
        parameters, together = parameters[order], together[order]
        starts = (parameters, together) if starts is None else starts
        best, similarity = parameters[0], float(climbed.similarity[order[0]])
        parameters = parameters[_distinct(problem, parameters, 1.0, len(parameters))]
    if not alike:
        problem.progress((len(stages) + 2) / total, "all tissue")
        by_whole = matchers[1].climb(best[None], stages[-1])
        if float(by_whole.similarity[0]) > max(similarity, trusted_similarity):
            best, similarity = problem.embed(by_whole.x[0]), float(by_whole.similarity[0])
    return Found(
        parameters=best,
        similarity=similarity,
        starts=starts[0],
        start_similarity=starts[1],
        evaluations=tally.evaluations,
    )


@dataclass
class _Tally:
    evaluations: int = 0


class _Matcher:
    """One level of the pyramid with one choice of tissue."""

    def __init__(self, problem: Problem, pixels: int, voxel_per_pixel: float, volume: Volume, tally: _Tally) -> None:
        self.problem, self.tally = problem, tally
        self.level = problem.level(pixels, voxel_per_pixel, volume)
        self.gradients = fixed_gradients(self.level.fixed.image, self.level.fixed.weight)

    def similarity(self, parameters: Float[Tensor, "n 9"]) -> Float[Tensor, " n"]:
        self.tally.evaluations += len(parameters)
        place = self.level.fixed.detector, self.problem.view, self.gradients
        return gradient_correlations(self.level.volume, parameters, *place).cpu()

    def climb(self, start: Float[Tensor, "n 9"], stage: Stage) -> Ascent:
        problem = self.problem

        def equations(values: Float[Tensor, "n d"]) -> tuple[Tensor, ...]:
            place = self.level.fixed.detector, problem.view, self.gradients
            found = normal_equations(self.level.volume, problem.embed(values), *place, free=problem.free)
            return tuple(part.cpu() for part in found)

        ascent = levenberg_marquardt(
            equations,
            start[:, problem.free],
            lower=problem.lower,
            upper=problem.upper,
            scale=1 / problem.sensitivity().clamp(1e-3, 1e6),
            steps=stage.steps,
        )
        self.tally.evaluations += ascent.evaluations
        return ascent


def _distinct(
    problem: Problem, parameters: Float[Tensor, "n 9"], shift_mm: float, most: int, each: int = 1
) -> list[int]:
    """The first ``most`` of which no more than ``each`` put the anatomy at the same place."""
    kept: list[int] = []
    for index in range(len(parameters)):
        if len(kept) == most:
            break
        if not kept or int((problem.shift_mm(parameters[kept], parameters[index]) <= shift_mm).sum()) < each:
            kept.append(index)
    return kept
