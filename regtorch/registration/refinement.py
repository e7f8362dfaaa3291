"""The local stage: the last climbs of a level, which forgive what bone does not explain, and the finest level's."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.registration.matcher import Matcher
from regtorch.registration.uncertainty import covariance, root_mean_square_mm

_NEAR = 1e-5
"""First damping of a climb that begins near its end: more would keep SDD and ODD, which hardly matter, from moving."""

_NARROWER = 0.8
"""What an edge is of a voxel at most that is to look unlike a linear one."""

_CLEAR = 0.7
"""Bone's similarity, or all tissue's, from which there is little in the image besides."""

_FLATTEST, _LOSSES, _LEAST_CURVATURE = 2, (0.01, 0.04), 1e-12


class End(NamedTuple):
    parameters: Float[Tensor, "9"]
    similarity: float
    matcher: Matcher


class Answer(NamedTuple):
    """``plain_similarity`` forgives nothing, so that those of different tissue can be compared."""

    parameters: Float[Tensor, "9"]
    similarity: float
    plain_similarity: float
    covariance: Float[Tensor, "9 9"]


def refined(forgiving: Matcher, parameters: Float[Tensor, "9"], steps: int) -> End:
    """Where a climb ends from there."""
    climbed = forgiving.climb(parameters[None], steps, _NEAR)
    return End(forgiving.problem.embed(climbed.x[0]), float(climbed.similarity[0]), forgiving)


def gain(plain: Matcher, end: End) -> float:
    """How many times as similar bone is once what it does not explain is marked down; infinite where that is little.

    From 1.38 on in 52 right radiographs of three torsos. In a wrong place what bone does not explain is everywhere, so
    that marking it down gains little: 0.8 to 1.4 mostly, 1.14 in one that all else spoke for.
    """
    before = float(replace(end.matcher, gradients=plain.gradients).similarity(end.parameters[None])[0])
    if before >= _CLEAR:
        return math.inf
    return end.similarity / before if before > 0 else 0.0


def explained(whole: Matcher, end: End) -> bool:
    """Whether all tissue explains the radiograph, so that what bone does not explain is soft tissue, everywhere.

    Where this has not moved and nothing else is in the image, bone gains little in a right place too: 0.92 to 1.15 in
    five of 19, where all tissue's similarity was 0.74 and more, and at most 0.66 where climbs ended over 10 mm off.
    """
    return float(whole.similarity(end.parameters[None])[0]) >= _CLEAR


def along_the_flat(forgiving: Matcher, parameters: Float[Tensor, "9"], steps: int) -> Float[Tensor, "9"]:
    """The best end of climbs from this one's end and from places to both sides along the flattest directions.

    Source and patient together can move far along the beam and change little: a valley with more than one bottom.
    """
    problem = forgiving.problem
    climbed = forgiving.climb(parameters[None], steps, _NEAR)
    scale = 1 / problem.sensitivity()
    values, axes = torch.linalg.eigh(climbed.jtj[0] * scale[:, None] * scale)
    offsets = [torch.zeros_like(scale)]
    for value, axis in list(zip(values, axes.mT, strict=True))[:_FLATTEST]:
        for loss in _LOSSES:  # what a parabola would lose where the similarity is one half; the truth is no parabola
            step = (8 * loss / value.clamp_min(_LEAST_CURVATURE)).sqrt() * axis * scale
            offsets += [step, -step]
    beside = (climbed.x + torch.stack(offsets)).clamp(problem.lower, problem.upper)
    ends = forgiving.climb(problem.embed(beside), steps, _NEAR)
    return problem.embed(ends.x[ends.similarity.argmax()])


def released(matcher: Matcher, parameters: Float[Tensor, "9"], steps: int) -> Float[Tensor, "9"]:
    """How far the nine parameters go from where they fit best once those that are frozen may move as well.

    Less what noise makes of it where what is frozen is right: the covariance of all nine, where they end. Where it is
    wrong this tells about how far off the image is.
    """
    all_free = matcher.problem.all_free()
    held = refined(matcher, parameters, steps).parameters
    free = replace(matcher, problem=all_free)
    end = all_free.embed(free.climb(held[None], 2 * steps).x)[0]
    moves = end - held
    moved = root_mean_square_mm(all_free, held, moves.outer(moves))
    noise = root_mean_square_mm(all_free, end, covariance(free, end))
    if not (0 < moved < math.inf and noise < math.inf):
        return moves
    return moves * math.sqrt(max(0.0, 1 - (noise / moved) ** 2))


def best_edges_px(matcher: Matcher, parameters: Float[Tensor, "9"]) -> tuple[float, Matcher]:
    """How wide voxels' edges look in the radiograph: as wide as voxels (infinity), or a pixel and less than a voxel.

    Whichever is more similar here; and what finds that out, which sees them as wide as voxels and forgives what these
    parameters do not explain.
    """
    linear = matcher.with_edges(torch.inf).forgiving(parameters)
    width = min(1.0, _NARROWER * matcher.voxel_px)
    constant = linear.with_edges(width)
    if float((constant.similarity(parameters[None]) - linear.similarity(parameters[None]))[0]) > 0:
        return width, linear
    return torch.inf, linear


def finished(matcher: Matcher, parameters: Float[Tensor, "9"], steps: int, edges_px: Sequence[float]) -> Answer:
    """Refined on the finest level: linear, or with sharper and sharper edges."""
    edges, linear = best_edges_px(matcher, parameters)
    if edges == torch.inf:
        end = refined(linear, parameters, steps)
    else:
        for width in edges_px:
            end = refined(matcher.with_edges(width).forgiving(parameters), parameters, steps)
            parameters = end.parameters
    plain = float(replace(end.matcher, gradients=matcher.gradients).similarity(end.parameters[None])[0])
    return Answer(end.parameters, end.similarity, plain, covariance(end.matcher, end.parameters))
