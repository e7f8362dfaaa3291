"""The default search: screening of all shifts at once, then Levenberg-Marquardt from coarse to fine.

Soft tissue guides the search where the radiograph shows it; bone refines it, and forgives what bone cannot explain.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.errors import RegtorchError
from regtorch.optimization.climbing import levenberg_marquardt
from regtorch.registration.candidates import PLACE_MM, Stage, distinct, evolved, more_candidates
from regtorch.registration.matcher import Climb, Matcher
from regtorch.registration.problem import MIRROR, Found, Problem
from regtorch.registration.pyramids import Pyramids, Search, screened
from regtorch.registration.refinement import (
    Answer,
    End,
    along_the_flat,
    best_edges_px,
    explained,
    finished,
    gain,
    refined,
    released,
)
from regtorch.registration.screening import SHIFTED, Candidates, screen
from regtorch.registration.verdict import at_limit, convincing
from regtorch.similarity import gradient_correlation

_WEAK = 0.2
"""The best start's mean similarity of bone and all tissue: 0.3 and more for right radiographs of 350 mm, 0.2 for those
of 150; for another patient's, mirrored ones and those upside down mostly less, but at times 0.4."""
_MORE = 8
"""How many times as many poses are screened where the first do not convince."""
_CONFINED = 1.3
"""What is gained by marking down what bone does not explain, below which more poses are screened."""
_GENERATIONS = 60
"""Of CMA-ES on the first level, where these do not either."""
_AS_THEY_ARE = 1e-3
"""Voxels per pixel for a volume that is coarse already."""

_FIRST, _STAGES, _FINEST = Stage(50, 40, 12), (Stage(125, 12, 12), Stage(250, 3, 10)), Stage(500, 1, 8)


def hybrid(
    problem: Problem,
    *,
    poses: int = 250,
    first: Stage = _FIRST,
    stages: Sequence[Stage] = _STAGES,
    finest: Stage = _FINEST,
    voxel_per_pixel: float = 1.3,
    edges_px: Sequence[float] = (1.0, 0.3),
    trusted_similarity: float = 0.9,
    soft_tissue: bool = True,
    contrast: bool = True,
    screening: Callable[..., Candidates] = screen,
    climb: Climb = levenberg_marquardt,
) -> Found:
    """Screen ``poses`` draws and a quarter more, climb from the best, refine what explains most.

    A quarter of the draws are screened for either tissue, the others for the one that explained more. The best
    candidates climb on the ``first`` level with their tissue, the better half of them all the way; those that go on are
    the best ones, but at most three of a place, and a quarter of them the other tissue's. On the second level all climb
    with bone alone, and the mean of bone's similarity and that of all tissue ranks them: ``Found.starts``. Where no two
    of them agree on the best place, or another is nearly as good, eight times as many poses are screened besides; and
    where that does not help, CMA-ES searches on from the best places. The best goes on, and where it still does not
    convince a few others with it, fewer on each level. Where it convinced and yet ends at a limit of the range, or what
    it does not explain is everywhere in the image (``gain``), more poses are screened after all.
    On each level, and on the ``finest``, the best one then climbs again, where what it did not explain is marked down
    (``explained_weight``); on the second also from places beside it, along the flattest directions.

    A CT that cuts the body has edges that a radiograph does not: all tissue is ``continued`` beyond it, and goes on so
    where the radiograph agrees more than with the CT as it is, of which it may have been simulated.

    Where all tissue explained more than bone, of a CT that has soft tissue, this is in the radiograph too, and bone
    shows by its ``contrast`` to that (``bone_contrast``); else by all that it attenuates, as in a radiograph of bone
    alone.

    Voxels are ``voxel_per_pixel`` times what a pixel covers in the patient, where the CT's are much smaller. They are
    read as linear from centre to centre or as constant, whichever the radiograph agrees with more; constant ones have
    edges that look a pixel wide, on the finest level ``edges_px`` wide in turn, or only the last of these where noise
    decides: where bone is not more similar than ``trusted_similarity``, what it does not explain marked down. If in the
    end all tissue is more similar than that on the second level, nothing marked down, it has not moved, and makes the
    answer if it is more similar than bone on the finest. Parameters that are frozen are released in the end, to see
    whether they fit.

    For ablations: without ``soft_tissue`` bone does all, and by all that it attenuates; ``screening`` may be
    ``screen_one_by_one``, and ``climb`` be ``optimization.evolve``, which knows no derivatives.

    Raises ``RegtorchError`` for another similarity than gradient correlation, and for no poses, candidates or stages.
    """
    if problem.similarity is not gradient_correlation:
        raise RegtorchError("similarity other than gradient correlation: expected that, or the method evolution")
    if not (stages and edges_px) or min(poses, *(stage.candidates for stage in (first, *stages))) < 1:
        raise RegtorchError("no poses, stages, candidates or edges: expected at least one of each")
    search = Search(problem, (first, *stages), poses, voxel_per_pixel, screening, climb)
    places, pyramids = screened(search, soft_tissue, contrast)

    problem.progress(0.4, f"{stages[0].pixels} pixels, {len(places)} candidates")
    starts, together = _ranked(pyramids, pyramids.bone[1], places, stages[0])
    enough = convincing(problem, starts, together)
    if not enough:
        starts, together = _looked_further(search, pyramids, starts, together)
    end = _sharpened(search, pyramids, starts, together)
    gained = gain(pyramids.bone[-1], end)
    if enough and (at_limit(problem, end.parameters) or gained < _CONFINED):
        known = starts[0]
        starts, together = _looked_further(search, pyramids, starts, together)
        if not torch.equal(known, starts[0]):
            end = _sharpened(search, pyramids, starts, together)
            gained = gain(pyramids.bone[-1], end)
    whole = pyramids.whole[1] if pyramids.whole else None
    if whole and gained < _CONFINED and explained(whole, end):
        gained = math.inf

    problem.progress(0.8, f"{finest.pixels} pixels")
    widths = edges_px if end.similarity > trusted_similarity else edges_px[-1:]
    answer = finished(search.matcher(finest, pyramids.tissue), end.parameters, finest.steps, widths)
    if whole:
        problem.progress(0.9, "all tissue")
        if float(whole.similarity(answer.parameters[None])[0]) > trusted_similarity:
            other = _by_all_tissue(search, pyramids, finest, answer.parameters, edges_px)
            answer = other if other.plain_similarity > answer.plain_similarity else answer
    error, moves = answer.covariance, None
    if len(problem.free) < len(answer.parameters):
        forgives_nothing = replace(end.matcher, gradients=pyramids.bone[-1].gradients)
        moves = released(forgives_nothing, end.parameters, stages[-1].steps)
        error = error + moves.outer(moves)
    return Found(
        parameters=answer.parameters,
        similarity=answer.similarity,
        starts=starts,
        start_similarity=together,
        evaluations=search.tally.evaluations,
        covariance=error,
        weak_similarity=_WEAK if whole else 0.0,
        mirrored_similarity=_mirrored_similarity(search, pyramids, starts[0]),
        released=moves,
        gain=gained,
    )


def _ranked(
    pyramids: Pyramids, by_bone: Matcher, places: Float[Tensor, "n 9"], stage: Stage
) -> tuple[Float[Tensor, "m 9"], Float[Tensor, " m"]]:
    return _best_first(*pyramids.climbed(by_bone, places[: stage.candidates], stage.steps))


def _looked_further(
    search: Search, pyramids: Pyramids, places: Float[Tensor, "n 9"], together: Float[Tensor, " n"]
) -> tuple[Float[Tensor, "m 9"], Float[Tensor, " m"]]:
    """With more poses; where these do not convince either, CMA-ES tries from the best places."""
    problem, (first, stage) = search.problem, search.stages[:2]
    if set(problem.free) <= set(SHIFTED):
        return places, together
    by_bone, wide = pyramids.bone[1], pyramids.leading
    more = more_candidates(problem, wide, search.screening, _MORE * search.poses, first, stage.candidates)
    both = zip((places, together), pyramids.climbed(by_bone, more, stage.steps), strict=True)
    places, together = _best_first(*(torch.cat(pair) for pair in both))
    if convincing(problem, places, together):
        return places, together
    apart = distinct(problem, places, PLACE_MM, stage.candidates)
    ends, reached = pyramids.climbed(by_bone, evolved(problem, wide, places[apart], _GENERATIONS), stage.steps)
    before = places.clone()
    for index, end, value in zip(apart, ends, reached, strict=True):
        if value > together[index]:  # for the start and those beside it: an end confirms nothing by itself
            there = (problem.shift_mm(before, before[index]) <= PLACE_MM) & (together < value)
            places[there], together[there] = end, value
    return _best_first(places, together)


def _sharpened(search: Search, pyramids: Pyramids, places: Float[Tensor, "n 9"], together: Float[Tensor, " n"]) -> End:
    """The best place up to the level before the finest, and a few others with it where it does not convince."""
    problem, stages = search.problem, search.stages[1:]
    sure = convincing(problem, places, together)
    edges = torch.inf
    for number, (stage, level) in enumerate(zip(stages, pyramids.bone[1:], strict=True)):
        by_bone = level.with_edges(edges)
        if number:
            problem.progress(0.4 + 0.2 * number, f"{stage.pixels} pixels, {len(places)} candidates")
            places, _ = _ranked(pyramids, by_bone, places, stage)
        best = places[0]
        edges, linear = best_edges_px(by_bone, best)
        forgiving = linear if edges == torch.inf else by_bone.with_edges(edges).forgiving(best)
        if not number:
            best = along_the_flat(forgiving, best, stage.steps)
            forgiving = by_bone.with_edges(edges).forgiving(best)
        end = refined(forgiving, best, stage.steps)
        rest = [] if sure else distinct(problem, places, PLACE_MM, len(places))[1:]
        places = torch.cat([end.parameters[None], places[rest]])
    return end


def _by_all_tissue(
    search: Search, pyramids: Pyramids, finest: Stage, parameters: Float[Tensor, "9"], edges_px: Sequence[float]
) -> Answer:
    whole = search.matcher(finest, search.problem.whole)
    return finished(whole.continued() if pyramids.goes_on else whole, parameters, finest.steps, edges_px)


def _best_first(places: Float[Tensor, "n 9"], similarity: Float[Tensor, " n"]) -> tuple[Tensor, Tensor]:
    order = similarity.argsort(descending=True)
    return places[order], similarity[order]


def _mirrored_similarity(search: Search, pyramids: Pyramids, start: Float[Tensor, "9"]) -> float:
    """As the best start's, for the radiograph mirrored: from the start mirrored up the first two levels.

    Bodies are nearly symmetric, so that a search is content with the mirror image of what it should have found.
    """
    stages, mirrored = search.stages[:2], search.problem.mirrored()

    def seen(levels: Sequence[Matcher]) -> list[Matcher]:
        return [
            Matcher.of(mirrored, stage.pixels, _AS_THEY_ARE, level.level.volume, level.tally, level.optimizer)
            for stage, level in zip(stages, levels, strict=False)
        ]

    there = replace(pyramids, bone=seen(pyramids.bone), whole=seen(pyramids.whole))
    widest = (there.whole or there.bone)[0].climb((start * MIRROR)[None], stages[0].steps)
    return float(there.climbed(there.bone[1], mirrored.embed(widest.x), stages[1].steps)[1][0])
