"""The global stage: places from which the search climbs, for bone and for all tissue."""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.optimization import cma_es
from regtorch.registration.search.matcher import Matcher
from regtorch.registration.search.screening import Candidates, screen, screen_one_by_one

_STREAMS = 4
"""Streams of random numbers of a seed: one for each tissue, one for the better one's rest, one for the second look."""


def first_look(tissues: Sequence[Matcher]) -> tuple[Float[Tensor, "n 9"], int]:
    """Places (mm, rad) to go on from, and the index of the tissue that explains the radiograph better.

    ``tissues`` are one or two matchers of the widest level. Each is screened with a share of the poses, the better one
    with the rest as well. Most places are the better one's, best first; a share is the other's.
    """
    problem, settings = tissues[0].problem, tissues[0].settings
    most = settings.levels[1].candidates
    if len(tissues) == 1:
        return _look(tissues[0], 1.0, 0).parameters, 0
    looks = [_look(tissue, settings.first_look, turn) for turn, tissue in enumerate(tissues)]
    better = int(looks[1].similarity[0] > looks[0].similarity[0])
    rest = _look(tissues[better], 1 - settings.first_look, 2)
    order = torch.cat([looks[better].similarity, rest.similarity]).argsort(descending=True)
    places = torch.cat([looks[better].parameters, rest.parameters])[order]
    few = int(settings.other_share * most)
    kept = problem.distinct(places, settings.place_mm, most - few, each=settings.at_a_place)
    return torch.cat([places[kept], looks[1 - better].parameters[:few]]), better


def second_look(tissue: Matcher) -> Float[Tensor, "n 9"]:
    """More places of one tissue, from ``more`` times as many other poses."""
    return _look(tissue, 1.0, _STREAMS - 1, times=tissue.settings.more).parameters


def evolved(tissue: Matcher, places: Float[Tensor, "n 9"]) -> Float[Tensor, "n 9"]:
    """Ends of CMA-ES from each place, which needs no slope: for rough basins. The first step is a pixel."""
    problem, settings = tissue.problem, tissue.settings
    unknowns = problem.unknowns
    problem.progress(0.5, f"CMA-ES from {len(places)} places")
    found = cma_es(
        lambda values: -tissue.similarity(problem.parameters(values)),
        unknowns.values(places).clamp(unknowns.lower, unknowns.upper),
        torch.minimum(tissue.pixel_mm / problem.sensitivity, settings.narrowest * (unknowns.upper - unknowns.lower)),
        lower=unknowns.lower,
        upper=unknowns.upper,
        max_generations=settings.generations,
        tol_fun=settings.spread,
        seed=problem.seed,
    )
    return problem.parameters(found.x)


def _look(tissue: Matcher, share: float, turn: int, *, times: int = 1) -> Candidates:
    """Screens a share of the poses and climbs from the best, the better half of them all the way."""
    problem, settings = tissue.problem, tissue.settings
    widest, following = settings.levels[:2]
    poses = math.ceil(share * times * settings.poses)
    seed = (_STREAMS * problem.seed + turn) % 2**32
    problem.progress(*_told(turn, poses))
    screened = (screen if settings.all_shifts else screen_one_by_one)(tissue, poses, seed).parameters
    chosen = problem.distinct(screened, tissue.pixel_mm, math.ceil(share * widest.candidates))
    half = math.ceil(settings.halfway * widest.steps)
    halfway = tissue.climb(screened[chosen], half)
    better = halfway.similarity.argsort(descending=True)[: math.ceil(settings.better_half * len(chosen))]
    climbed = tissue.climb(halfway.parameters[better], max(1, widest.steps - half))
    order = climbed.similarity.argsort(descending=True)
    places = climbed.parameters[order]
    kept = problem.distinct(places, settings.place_mm, following.candidates, each=settings.at_a_place)
    tissue.trace.add("screen", tissue.pixels, len(chosen), float(climbed.similarity.max()))
    return Candidates(places[kept], climbed.similarity[order][kept])


def _told(turn: int, poses: int) -> tuple[float, str]:
    """Share done and text of the progress."""
    if turn == _STREAMS - 1:
        return 0.4, f"screening {poses} poses more"
    return 0.1 * turn, f"screening {poses} poses"
