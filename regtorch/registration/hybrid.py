"""The default search: screening of all shifts at once, then Levenberg-Marquardt from coarse to fine.

Soft tissue guides the search where the radiograph shows it; bone refines it, and forgives what bone cannot explain.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.errors import RegtorchError
from regtorch.imaging import Volume, bone_contrast
from regtorch.optimization.levenberg_marquardt import levenberg_marquardt
from regtorch.registration.matcher import Climb, Matcher, Tally
from regtorch.registration.problem import MIRROR, Found, Problem
from regtorch.registration.screening import Candidates, screen
from regtorch.registration.uncertainty import covariance
from regtorch.similarity import gradient_correlation


@dataclass(frozen=True)
class Stage:
    """A level of the pyramid: the longer side of its image, how many candidates climb there, how many steps each."""

    pixels: int
    candidates: int
    steps: int


_PLACE_MM = 10.0
_FIRST_LOOK = 0.25
"""The share of the poses that either tissue is screened with; the one that explains more gets the others as well."""
_WEAK = 0.3
"""The best start's mean similarity of bone and all tissue: 0.35 and more for right radiographs, up to 0.29 for another
patient's, mirrored ones and those upside down, but for some that had a rival or lay at a limit of the range."""
_AS_THEY_ARE = 1e-3
"""Voxels per pixel for a volume that is coarse already."""

_NEAR = 1e-5
"""First damping of a climb that begins near its end: more would keep SDD and ODD, which hardly matter, from moving."""
_FLATTEST, _LOSSES, _LEAST_CURVATURE = 2, (0.01, 0.04), 1e-12
_STAGES = (Stage(125, 12, 12), Stage(250, 3, 10))


def hybrid(
    problem: Problem,
    *,
    poses: int = 500,
    first: Stage = Stage(50, 40, 12),
    stages: Sequence[Stage] = _STAGES,
    finest: Stage = Stage(500, 1, 8),
    voxel_per_pixel: float = 1.3,
    edges_px: Sequence[float] = (1.0, 0.3),
    trusted_similarity: float = 0.9,
    soft_tissue: bool = True,
    contrast: bool = True,
    screening: Callable[..., Candidates] = screen,
    climb: Climb = levenberg_marquardt,
) -> Found:
    """Screen ``poses`` draws for bone or for all tissue, climb from the best, refine what explains most.

    A quarter of the draws are screened for either tissue, the others for the one that explained more. The best
    candidates climb on the ``first`` level with their tissue, the better half of them all the way; those that go on are
    the best ones, but at most three of a place, and a quarter of them the other tissue's. From there on all climb with
    bone alone, fewer on each level, and the mean of bone's similarity and, on the second level, that of all tissue
    ranks them. ``Found.starts`` are the ends of the second level's climbs, by that mean. On each level, and on the
    ``finest``, the best one then climbs again, where what it did not explain is marked down (``explained_weight``); on
    the second also from places beside it, along the flattest directions.

    Where all tissue explained more than bone there is soft tissue in the radiograph, and bone shows by its
    ``contrast`` to that (``bone_contrast``); else by all that it attenuates, as in a radiograph of bone alone.

    Voxels are ``voxel_per_pixel`` times what a pixel covers in the patient, where the CT's are not larger. They are
    read as linear from centre to centre or as constant, whichever the radiograph agrees with more; constant ones have
    edges that look a pixel wide, on the finest level ``edges_px`` wide in turn. If in the end all tissue is more
    similar than ``trusted_similarity``, and than bone, it has not moved, and makes the answer.

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
        """Coarse to fine; each volume is made of the next finer one, which is far smaller than the CT."""
        matchers: list[Matcher] = []
        for stage in reversed(levels):
            matchers.insert(0, matcher(stage, matchers[0].level.volume if matchers else tissue))
        return matchers

    alone, whole = problem.attenuating, problem.whole
    alike = not soft_tissue or (alone.data.shape == whole.data.shape and torch.equal(alone.data, whole.data))
    bone = alone if alike or not contrast else bone_contrast(alone, threshold_hu=problem.threshold_hu)
    pyramids = [pyramid(bone, (first, *stages))]
    if not alike:
        pyramids.append(pyramid(whole, (first, stages[0])))

    def screened(tissue: int, share: float, turn: int) -> Candidates:
        """The best few of a share of the poses, sorted."""
        some, climbing = math.ceil(share * poses), math.ceil(share * first.candidates)
        problem.progress(0.1 * turn, f"screening {some} poses")
        seed = (3 * problem.seed + turn) % 2**32
        stage = replace(first, candidates=climbing)
        return _screened(problem, pyramids[tissue][0], screening, some, stage, stages[0].candidates, seed)

    if alike:
        parameters = screened(0, 1.0, 0).parameters
    else:
        looks = [screened(tissue, _FIRST_LOOK, tissue) for tissue in (0, 1)]
        better = int(looks[1].similarity[0] > looks[0].similarity[0])
        rest = screened(better, 1 - _FIRST_LOOK, 2)
        order = torch.cat([looks[better].similarity, rest.similarity]).argsort(descending=True)
        places = torch.cat([looks[better].parameters, rest.parameters])[order]
        few = stages[0].candidates // 4
        places = places[_distinct(problem, places, _PLACE_MM, stages[0].candidates - few, each=3)]
        parameters = torch.cat([places, looks[1 - better].parameters[:few]])
        if bone is not alone and not better:
            bone, pyramids[0] = alone, pyramid(alone, (first, *stages))
    starts, edges = None, torch.inf
    for number, stage in enumerate(stages):
        problem.progress(0.4 + 0.2 * number, f"{stage.pixels} pixels, {len(parameters)} candidates")
        by_bone = pyramids[0][number + 1].with_edges(edges)
        climbed = by_bone.climb(parameters[: stage.candidates], stage.steps)
        parameters = problem.embed(climbed.x)
        together = sum([levels[1].similarity(parameters) for levels in pyramids[1:]], climbed.similarity)
        together = together / len(pyramids)
        order = together.argsort(descending=True)
        parameters, together = parameters[order], together[order]
        starts = (parameters, together) if starts is None else starts
        edges = _edges_px(by_bone, parameters[0])
        by_bone = by_bone.with_edges(edges)
        best = parameters[0] if number else _along_the_flat(by_bone, parameters[0], stage.steps)
        best = _refined(by_bone, best, stage.steps).parameters
        rest = _distinct(problem, parameters, _PLACE_MM, len(parameters))[1:]
        parameters = torch.cat([best[None], parameters[rest]])
    problem.progress(0.8, f"{finest.pixels} pixels")
    found = _finished(matcher(finest, bone), best, finest, edges_px)
    if not alike:
        problem.progress(0.9, "all tissue")
        if float(pyramids[1][1].similarity(found.parameters[None])[0]) > trusted_similarity:
            other = _finished(matcher(finest, whole), found.parameters, finest, edges_px)
            found = other if other.plain_similarity > found.plain_similarity else found
    return Found(
        parameters=found.parameters,
        similarity=found.similarity,
        starts=starts[0],
        start_similarity=starts[1],
        evaluations=tally.evaluations,
        covariance=found.covariance,
        weak_similarity=0.0 if alike else _WEAK,
        mirrored_similarity=_mirrored_similarity(problem, pyramids, (first, stages[0]), starts[0][0]),
    )


def _screened(
    problem: Problem,
    matcher: Matcher,
    screening: Callable[..., Candidates],
    poses: int,
    stage: Stage,
    goes_on: int,
    seed: int,
) -> Candidates:
    screened = screening(problem, matcher.level, poses, seed).parameters
    matcher.tally.evaluations += poses
    chosen = _distinct(problem, screened, matcher.level.fixed.detector.pixel_mm, stage.candidates)
    halfway = matcher.climb(screened[chosen], stage.steps // 2)
    better = halfway.similarity.argsort(descending=True)[: -(-len(chosen) // 2)]
    climbed = matcher.climb(problem.embed(halfway.x[better]), stage.steps - stage.steps // 2)
    order = climbed.similarity.argsort(descending=True)
    places = problem.embed(climbed.x[order])
    kept = _distinct(problem, places, _PLACE_MM, goes_on, each=3)
    return Candidates(places[kept], climbed.similarity[order][kept])


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


class _End(NamedTuple):
    parameters: Float[Tensor, "9"]
    similarity: float
    matcher: Matcher


class _Answer(NamedTuple):
    """``plain_similarity`` forgives nothing, so that those of different tissue can be compared."""

    parameters: Float[Tensor, "9"]
    similarity: float
    plain_similarity: float
    covariance: Float[Tensor, "9 9"]


def _refined(matcher: Matcher, parameters: Float[Tensor, "9"], steps: int) -> _End:
    """Where a climb ends that forgives what its beginning does not explain."""
    forgiving = matcher.forgiving(parameters)
    climbed = forgiving.climb(parameters[None], steps, _NEAR)
    return _End(matcher.problem.embed(climbed.x[0]), float(climbed.similarity[0]), forgiving)


def _along_the_flat(matcher: Matcher, parameters: Float[Tensor, "9"], steps: int) -> Float[Tensor, "9"]:
    """The best end of climbs from this one's end and from places to both sides along the flattest directions.

    Source and patient together can move far along the beam and change little: a valley with more than one bottom.
    """
    problem, forgiving = matcher.problem, matcher.forgiving(parameters)
    climbed = forgiving.climb(parameters[None], steps, _NEAR)
    scale = 1 / problem.sensitivity().clamp(1e-3, 1e6)
    values, axes = torch.linalg.eigh(climbed.jtj[0] * scale[:, None] * scale)
    offsets = [torch.zeros_like(scale)]
    for value, axis in list(zip(values, axes.mT, strict=True))[:_FLATTEST]:
        for loss in _LOSSES:  # what a parabola would lose where the similarity is one half; the truth is no parabola
            step = (8 * loss / value.clamp_min(_LEAST_CURVATURE)).sqrt() * axis * scale
            offsets += [step, -step]
    beside = (climbed.x + torch.stack(offsets)).clamp(problem.lower, problem.upper)
    ends = forgiving.climb(problem.embed(beside), steps, _NEAR)
    return problem.embed(ends.x[ends.similarity.argmax()])


def _edges_px(matcher: Matcher, parameters: Float[Tensor, "9"]) -> float:
    """How wide voxels' edges look in the radiograph: as wide as voxels, or a pixel, whichever is more similar here."""
    linear = matcher.with_edges(torch.inf).forgiving(parameters)
    constant = linear.with_edges(1.0)
    return (
        1.0
        if float((constant.similarity(parameters[None]) - linear.similarity(parameters[None]))[0]) > 0
        else torch.inf
    )


def _finished(matcher: Matcher, parameters: Float[Tensor, "9"], stage: Stage, edges_px: Sequence[float]) -> _Answer:
    """Refined on the finest level: linear, or with sharper and sharper edges."""
    constant = _edges_px(matcher, parameters) < torch.inf
    for width in edges_px:
        end = _refined(matcher.with_edges(width if constant else torch.inf), parameters, stage.steps)
        parameters = end.parameters
    plain = float(replace(end.matcher, gradients=matcher.gradients).similarity(parameters[None])[0])
    return _Answer(parameters, end.similarity, plain, covariance(end.matcher, parameters))


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
