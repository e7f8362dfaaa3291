"""The global stage: places where a search should climb, for bone alone and for all tissue."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.optimization.evolution_strategy import cma_es
from regtorch.registration.matcher import Matcher
from regtorch.registration.problem import Problem
from regtorch.registration.screening import Candidates

PLACE_MM = 10.0
"""Poses that project the anatomy nearer to each other than this are at the same place."""

_FIRST_LOOK = 0.25
"""The share of the poses that either tissue is screened with; the one that explains more gets the others as well."""

_SPREAD = 1e-4
"""Of similarity over recent generations, below which CMA-ES has converged."""


@dataclass(frozen=True)
class Stage:
    """A level of the pyramid: the longer side of its image, how many candidates climb there, how many steps each."""

    pixels: int
    candidates: int
    steps: int


def candidates(
    problem: Problem,
    tissues: Sequence[Matcher],
    screening: Callable[..., Candidates],
    poses: int,
    stage: Stage,
    most: int,
) -> tuple[Float[Tensor, "n 9"], int]:
    """At most ``most`` places, and which of the ``tissues``, one or two matchers of one level, explains more.

    A quarter of the poses are screened for either tissue, the others for the one that explained more, which most places
    are of, best first; a quarter are the other's.
    """

    def look(tissue: int, share: float, turn: int) -> Candidates:
        some = math.ceil(share * poses)
        problem.progress(0.1 * turn, f"screening {some} poses")
        climbing = replace(stage, candidates=math.ceil(share * stage.candidates))
        return _climbed(problem, tissues[tissue], screening, some, climbing, most, (4 * problem.seed + turn) % 2**32)

    if len(tissues) == 1:
        return look(0, 1.0, 0).parameters, 0
    looks = [look(tissue, _FIRST_LOOK, tissue) for tissue in (0, 1)]
    better = int(looks[1].similarity[0] > looks[0].similarity[0])
    rest = look(better, 1 - _FIRST_LOOK, 2)
    order = torch.cat([looks[better].similarity, rest.similarity]).argsort(descending=True)
    places = torch.cat([looks[better].parameters, rest.parameters])[order]
    few = most // 4
    places = places[distinct(problem, places, PLACE_MM, most - few, each=3)]
    return torch.cat([places, looks[1 - better].parameters[:few]]), better


def more_candidates(
    problem: Problem, tissue: Matcher, screening: Callable[..., Candidates], poses: int, stage: Stage, most: int
) -> Float[Tensor, "n 9"]:
    """As many again of one tissue, from other poses."""
    problem.progress(0.4, f"screening {poses} poses more")
    return _climbed(problem, tissue, screening, poses, stage, most, (4 * problem.seed + 3) % 2**32).parameters


def evolved(problem: Problem, tissue: Matcher, places: Float[Tensor, "n 9"], generations: int) -> Float[Tensor, "n 9"]:
    """Where CMA-ES ends that begins there a pixel wide, and needs no slope: for basins that are rough."""
    problem.progress(0.5, f"CMA-ES from {len(places)} places")
    sigma = tissue.level.fixed.detector.pixel_mm / problem.sensitivity()
    found = cma_es(
        lambda values: -tissue.similarity(problem.embed(values)),
        places[:, problem.free].clamp(problem.lower, problem.upper),
        torch.minimum(sigma, (problem.upper - problem.lower) / 4),
        lower=problem.lower,
        upper=problem.upper,
        max_generations=generations,
        tol_fun=_SPREAD,
        seed=problem.seed,
    )
    return problem.embed(found.x)


def _climbed(
    problem: Problem,
    matcher: Matcher,
    screening: Callable[..., Candidates],
    poses: int,
    stage: Stage,
    most: int,
    seed: int,
) -> Candidates:
    """Ends of climbs from the best that are screened, the better half of them all the way; at most three of a place."""
    screened = screening(problem, matcher.level, poses, seed).parameters
    matcher.tally.evaluations += poses
    chosen = distinct(problem, screened, matcher.level.fixed.detector.pixel_mm, stage.candidates)
    half = math.ceil(stage.steps / 2)
    halfway = matcher.climb(screened[chosen], half)
    better = halfway.similarity.argsort(descending=True)[: math.ceil(len(chosen) / 2)]
    climbed = matcher.climb(problem.embed(halfway.x[better]), max(1, stage.steps - half))
    order = climbed.similarity.argsort(descending=True)
    places = problem.embed(climbed.x[order])
    kept = distinct(problem, places, PLACE_MM, most, each=3)
    return Candidates(places[kept], climbed.similarity[order][kept])


def distinct(
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
