"""The default search: screening of all shifts at once, then Levenberg-Marquardt from coarse to fine.

Soft tissue guides the search where the radiograph shows it, and bone has the last word: candidates come from bone
alone and from all tissue, and are compared by bone alone once they are fine enough.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.imaging import Volume
from regtorch.optimization.levenberg_marquardt import Ascent, levenberg_marquardt
from regtorch.registration.problem import Found, Problem
from regtorch.registration.screening import screen
from regtorch.scoring import gradient_correlations, normal_equations
from regtorch.similarity.gram import fixed_gradients


@dataclass(frozen=True)
class Stage:
    """A level of the pyramid: the longer side of its image, how many candidates climb there, how many steps each."""

    pixels: int
    candidates: int
    steps: int


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
    """Screen ``poses`` draws for bone alone and for all tissue, climb from the best, keep what bone likes best.

    Each tissue's best candidates climb on the first level with that tissue. From there on all climb with bone alone,
    fewer on each level. If all tissue in the end reaches ``trusted_similarity``, and more than bone, it has not moved,
    and makes the answer. A voxel is ``voxel_per_pixel`` times what a pixel covers in the patient.
    """
    total = len(stages) + 3.0
    tally = _Tally()
    bone, whole = problem.attenuating, problem.whole
    candidates = []
    for done, volume in enumerate((bone, whole)):
        problem.progress(done / total, f"screening {poses} poses")
        matcher = _Matcher(problem, first.pixels, voxel_per_pixel, volume, tally)
        screened = screen(problem, matcher.level.volume, first.pixels, poses)
        tally.evaluations += poses
        apart = matcher.level.fixed.detector.pixel_mm
        climbed = matcher.climb(
            screened.parameters[_distinct(problem, screened.parameters, apart, first.candidates)], first
        )
        order = climbed.similarity.argsort(descending=True)[: stages[0].candidates // 2]
        candidates.append(problem.embed(climbed.x[order]))
    parameters, starts = torch.cat(candidates), None
    for number, stage in enumerate(stages):
        problem.progress((number + 2) / total, f"{stage.pixels} pixels, {len(parameters)} candidates")
        of_bone, of_whole = (_Matcher(problem, stage.pixels, voxel_per_pixel, v, tally) for v in (bone, whole))
        climbed = of_bone.climb(parameters[: stage.candidates], stage)
        parameters = problem.embed(climbed.x)
        together = (climbed.similarity + of_whole.similarity(parameters)) / 2
        order = together.argsort(descending=True)
        parameters, together = parameters[order], together[order]
        if starts is None:
            starts = parameters, together
        best, similarity = parameters[0], float(climbed.similarity[order[0]])
        parameters = parameters[_distinct(problem, parameters, 1.0, len(parameters))]
    problem.progress((len(stages) + 2) / total, "all tissue")
    by_whole = of_whole.climb(best[None], stages[-1])
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
            scale=1 / problem.sensitivity(),
            steps=stage.steps,
        )
        self.tally.evaluations += ascent.evaluations
        return ascent


def _distinct(problem: Problem, parameters: Float[Tensor, "n 9"], shift_mm: float, most: int) -> list[int]:
    """The first ``most`` that put the anatomy at different places."""
    kept: list[int] = []
    for index in range(len(parameters)):
        if len(kept) == most:
            break
        if not kept or float(problem.shift_mm(parameters[kept], parameters[index]).min()) > shift_mm:
            kept.append(index)
    return kept
