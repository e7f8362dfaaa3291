"""The default search: screening of all shifts at once, then Levenberg-Marquardt from coarse to fine.

Soft tissue guides the search where the radiograph shows it; bone refines it, and forgives what bone cannot explain.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.errors import RegtorchError
from regtorch.imaging import Volume, bone_contrast
from regtorch.optimization.levenberg_marquardt import levenberg_marquardt
from regtorch.registration.candidates import PLACE_MM, Stage, candidates, distinct, evolved, more_candidates
from regtorch.registration.matcher import Climb, Matcher, Tally
from regtorch.registration.problem import MIRROR, Found, Problem
from regtorch.registration.refinement import End, along_the_flat, best_edges_px, finished, gain, refined, released
from regtorch.registration.screening import SHIFTED, Candidates, screen
from regtorch.registration.verdict import at_limit, convincing
from regtorch.similarity import gradient_correlation

_WEAK = 0.2
"""The best start's mean similarity of bone and all tissue: 0.3 and more for right radiographs of 350 mm, 0.2 for those
of 150; for another patient's, mirrored ones and those upside down mostly less, but at times 0.4."""
_LEAST_TISSUE = 3.0
"""All tissue of a CT in which soft tissue surrounds the bones, over what bone attenuates of it: from 3 on. Around dry
bones there are but voxels that they fill in part; torsos have nine times as much."""
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
    tally = Tally()

    def matcher(stage: Stage, tissue: Volume) -> Matcher:
        return Matcher.of(problem, stage.pixels, voxel_per_pixel, tissue, tally, climb)

    def pyramid(tissue: Volume, levels: Sequence[Stage]) -> list[Matcher]:
        """Coarse to fine; each volume is made of the next finer one, which is often far smaller than the CT."""
        matchers: list[Matcher] = []
        for stage in reversed(levels):
            matchers.insert(0, matcher(stage, matchers[0].level.volume if matchers else tissue))
        return matchers

    alone, whole = problem.attenuating, problem.whole
    alike = not soft_tissue or (alone.data.shape == whole.data.shape and torch.equal(alone.data, whole.data))
    bone = alone
    if contrast and not alike and bool(whole.data.sum() > _LEAST_TISSUE * alone.data.sum()):
        denser = bone_contrast(alone, threshold_hu=problem.threshold_hu)
        bone = denser if bool(denser.data.any()) else alone
    pyramids = [pyramid(bone, (first, *stages))]
    goes_on = False
    if not alike:
        as_it_is = pyramid(whole, (first, stages[0]))
        beyond = as_it_is[1].continued()
        goes_on = beyond is not as_it_is[1]
        pyramids.append([matcher(first, beyond.level.volume), beyond] if goes_on else as_it_is)
    widest = [levels[0] for levels in pyramids]
    parameters, better = candidates(problem, widest, screening, poses, first, stages[0].candidates)
    if goes_on:
        ends, beyond_ends = (levels[0].climb(parameters, first.steps // 3) for levels in (as_it_is, pyramids[1]))
        if float(ends.similarity.max()) > float(beyond_ends.similarity.max()):
            goes_on, pyramids[1] = False, as_it_is
    if bone is not alone and not better:
        bone, pyramids[0] = alone, pyramid(alone, (first, *stages))

    wide = pyramids[better][0]

    def climbed(by_bone: Matcher, places: Float[Tensor, "n 9"], steps: int) -> tuple[Tensor, Tensor]:
        """Where climbs by bone end, and bone's and all tissue's similarity together."""
        ascent = by_bone.climb(places, steps)
        ends = problem.embed(ascent.x)
        together = sum([levels[1].similarity(ends) for levels in pyramids[1:]], ascent.similarity)
        return ends, together / len(pyramids)

    def ranked(by_bone: Matcher, places: Float[Tensor, "n 9"], stage: Stage) -> tuple[Tensor, Tensor]:
        return _best_first(*climbed(by_bone, places[: stage.candidates], stage.steps))

    def looked_further(by_bone: Matcher, places: Tensor, together: Tensor) -> tuple[Tensor, Tensor]:
        """With more poses; where these do not convince either, CMA-ES tries from the best places."""
        if set(problem.free) <= set(SHIFTED):
            return places, together
        stage = stages[0]
        more = more_candidates(problem, wide, screening, _MORE * poses, first, stage.candidates)
        both = zip((places, together), climbed(by_bone, more, stage.steps), strict=True)
        places, together = _best_first(*(torch.cat(pair) for pair in both))
        if convincing(problem, places, together):
            return places, together
        apart = distinct(problem, places, PLACE_MM, stage.candidates)
        ends, reached = climbed(by_bone, evolved(problem, wide, places[apart], _GENERATIONS), stage.steps)
        before = places.clone()
        for index, end, value in zip(apart, ends, reached, strict=True):
            if value > together[index]:  # for the start and those beside it: an end confirms nothing by itself
                there = problem.shift_mm(before, before[index]) <= PLACE_MM
                places[there], together[there] = end, value
        return _best_first(places, together)

    def sharpened(parameters: Tensor, together: Tensor) -> End:
        """The best place up to the level before the finest, and a few others with it where it does not convince."""
        sure = convincing(problem, parameters, together)
        edges = torch.inf
        for number, stage in enumerate(stages):
            by_bone = pyramids[0][number + 1].with_edges(edges)
            if number:
                problem.progress(0.4 + 0.2 * number, f"{stage.pixels} pixels, {len(parameters)} candidates")
                parameters, _ = ranked(by_bone, parameters, stage)
            best = parameters[0]
            edges, linear = best_edges_px(by_bone, best)
            forgiving = linear if edges == torch.inf else by_bone.with_edges(edges).forgiving(best)
            if not number:
                best = along_the_flat(forgiving, best, stage.steps)
                forgiving = by_bone.with_edges(edges).forgiving(best)
            end = refined(forgiving, best, stage.steps)
            rest = [] if sure else distinct(problem, parameters, PLACE_MM, len(parameters))[1:]
            parameters = torch.cat([end.parameters[None], parameters[rest]])
        return end

    problem.progress(0.4, f"{stages[0].pixels} pixels, {len(parameters)} candidates")
    by_bone = pyramids[0][1]
    starts = ranked(by_bone, parameters, stages[0])
    enough = convincing(problem, *starts)
    if not enough:
        starts = looked_further(by_bone, *starts)
    end = sharpened(*starts)
    if enough and (at_limit(problem, end.parameters) or gain(pyramids[0][-1], end) < _CONFINED):
        known, starts = starts[0][0], looked_further(by_bone, *starts)
        if not torch.equal(known, starts[0][0]):
            end = sharpened(*starts)
    problem.progress(0.8, f"{finest.pixels} pixels")
    widths = edges_px if end.similarity > trusted_similarity else edges_px[-1:]
    found = finished(matcher(finest, bone), end.parameters, finest.steps, widths)
    if not alike:
        problem.progress(0.9, "all tissue")
        if float(pyramids[1][1].similarity(found.parameters[None])[0]) > trusted_similarity:
            level = matcher(finest, whole)
            level = level.continued() if goes_on else level
            other = finished(level, found.parameters, finest.steps, edges_px)
            found = other if other.plain_similarity > found.plain_similarity else found
    error, moves = found.covariance, None
    if len(problem.free) < len(found.parameters):
        forgives_nothing = replace(end.matcher, gradients=pyramids[0][-1].gradients)
        moves = released(forgives_nothing, end.parameters, stages[-1].steps)
        error = error + moves.outer(moves)
    return Found(
        parameters=found.parameters,
        similarity=found.similarity,
        starts=starts[0],
        start_similarity=starts[1],
        evaluations=tally.evaluations,
        covariance=error,
        weak_similarity=0.0 if alike else _WEAK,
        mirrored_similarity=_mirrored_similarity(problem, pyramids, (first, stages[0]), starts[0][0]),
        released=moves,
        gain=gain(pyramids[0][-1], end),
    )


def _best_first(places: Float[Tensor, "n 9"], similarity: Float[Tensor, " n"]) -> tuple[Tensor, Tensor]:
    order = similarity.argsort(descending=True)
    return places[order], similarity[order]


def _mirrored_similarity(
    problem: Problem, pyramids: list[list[Matcher]], stages: tuple[Stage, Stage], start: Float[Tensor, "9"]
) -> float:
    """As the best start's, for the radiograph mirrored: from the start mirrored up the first two levels.

    Bodies are nearly symmetric, so that a search is content with the mirror image of what it should have found.
    """
    mirrored = problem.mirrored()
    parameters = start * MIRROR
    levels = [
        [
            Matcher.of(mirrored, stage.pixels, _AS_THEY_ARE, matcher.level.volume, matcher.tally, matcher.optimizer)
            for stage, matcher in zip(stages, pyramid, strict=False)
        ]
        for pyramid in pyramids
    ]
    wide = levels[-1][0].climb(parameters[None], stages[0].steps)
    climbed = levels[0][1].climb(mirrored.embed(wide.x), stages[1].steps)
    others = [level[1].similarity(mirrored.embed(climbed.x)) for level in levels[1:]]
    return float(sum(others, climbed.similarity)[0]) / len(levels)
