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
from regtorch.scoring import normal_equations
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
    evaluations, total = 0, len(stages) + 3.0
    candidates = []
    for done, volume in enumerate((problem.attenuating, problem.whole)):
        problem.progress(done / total, f"screening {poses} poses")
        level = problem.level(first.pixels, voxel_per_pixel, volume)
        screened = screen(problem, level.volume, first.pixels, poses)
        evaluations += poses
        chosen = screened.parameters[_distinct(problem, screened.parameters, level.fixed.detector.pixel_mm, first.candidates)]
        climbed = _climb(problem, chosen, first, voxel_per_pixel, volume)
        evaluations += climbed.evaluations
        order = climbed.similarity.argsort(descending=True)[: stages[0].candidates // 2]
        candidates.append(problem.embed(climbed.x[order]))
    starts, parameters = None, torch.cat(candidates)
    climbed = None
    for number, stage in enumerate(stages):
        problem.progress((number + 2) / total, f"{stage.pixels} pixels, {len(parameters)} candidates")
        climbed = _climb(problem, parameters[: stage.candidates], stage, voxel_per_pixel, problem.attenuating)
        evaluations += climbed.evaluations
        order = climbed.similarity.argsort(descending=True)
        parameters, similarity = problem.embed(climbed.x[order]), climbed.similarity[order]
        if starts is None:
            starts = parameters, similarity
        parameters = parameters[_distinct(problem, parameters, 1.0, len(parameters))]
    best, similarity = problem.embed(climbed.x[order[0]]), float(climbed.similarity[order[0]])
    problem.progress((len(stages) + 2) / total, "all tissue")
    whole = _climb(problem, best[None], stages[-1], voxel_per_pixel, problem.whole)
    evaluations += whole.evaluations
    if float(whole.similarity[0]) > max(similarity, trusted_similarity):
        best, similarity = problem.embed(whole.x[0]), float(whole.similarity[0])
    return Found(
        parameters=best,
        similarity=similarity,
        starts=starts[0],
        start_similarity=starts[1],
        evaluations=evaluations,
    )


def _climb(
    problem: Problem, start: Float[Tensor, "n 9"], stage: Stage, voxel_per_pixel: float, volume: Volume
) -> Ascent:
    level = problem.level(stage.pixels, voxel_per_pixel, volume)
    fixed = fixed_gradients(level.fixed.image, level.fixed.weight)

    def equations(values: Float[Tensor, "n d"]):
        found = normal_equations(
            level.volume, problem.embed(values), level.fixed.detector, problem.view, fixed, free=problem.free
        )
        return tuple(part.cpu() for part in found)

    return levenberg_marquardt(
        equations,
        start[:, problem.free],
        lower=problem.lower,
        upper=problem.upper,
        scale=1 / problem.sensitivity(),
        steps=stage.steps,
    )


def _distinct(problem: Problem, parameters: Float[Tensor, "n 9"], shift_mm: float, most: int) -> list[int]:
    """The first ``most`` that put the anatomy at different places."""
    kept: list[int] = []
    for index in range(len(parameters)):
        if len(kept) == most:
            break
        if not kept or float(problem.shift_mm(parameters[kept], parameters[index]).min()) > shift_mm:
            kept.append(index)
    return kept
