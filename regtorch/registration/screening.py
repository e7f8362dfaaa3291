"""Poses drawn over the whole range, each at all in-plane shifts at once: where a search should begin."""

import math
from functools import reduce
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn.functional import pad
from torch.quasirandom import SobolEngine

from regtorch.drr import render
from regtorch.geometry import Detector
from regtorch.registration.objective import Level
from regtorch.registration.problem import Problem
from regtorch.similarity.gradients import gradient_weight, image_gradients

SHIFTED = (3, 4)
"""Which of the nine parameters move the image, and hardly change it."""

_LEAST_ENERGY = 0.1
_MOST_MAGNIFIED = 1.3
_POSES_AT_ONCE = 64
_PIXELS_AT_ONCE = 1 << 21


class Candidates(NamedTuple):
    """Poses and their gradient correlation, exact or by the estimate that ``screen`` makes, best first."""

    parameters: Float[Tensor, "n 9"]
    similarity: Float[Tensor, " n"]


def screen(problem: Problem, level: Level, poses: int, seed: int, peaks: int = 2) -> Candidates:
    """For each of ``poses`` draws, the ``peaks`` best in-plane shifts, by correlation of gradients.

    Moving the patient in the plane of the detector moves its image and hardly changes it. So one DRR, wide enough for
    every shift in the range, tells the correlation at all shifts by a Fourier transform: of the fixed image's gradients
    with the DRR's, over the root of the DRR's energy where the fixed image lies (masked normalised cross-correlation,
    of both directions together), or of a tenth of the highest energy, where it has less. Shifts that are frozen are not
    searched; the draws are a scrambled Sobol sequence over the other free parameters.
    """
    fixed, detector = level.fixed, level.fixed.detector
    draws = _draws(problem, poses, seed)
    margins = _margins(problem, detector, draws)
    wide = Detector(
        detector.rows + 2 * margins[1], detector.columns + 2 * margins[0], detector.pixel_mm, detector.centre_mm
    )
    size = [_fast_size(n) for n in (wide.rows, wide.columns)]
    weight = gradient_weight(fixed.weight)
    gradients = torch.cat(image_gradients(fixed.image[None]))
    weighted = (gradients - (gradients * weight).sum((1, 2), keepdim=True) / weight.sum().clamp_min(1e-12)) * weight
    norm = (weighted.square() / weight.clamp_min(1e-12)).sum().sqrt().clamp_min(1e-12)
    fixed_terms = torch.fft.rfft2(weighted / norm, s=size).conj()
    weight_term = torch.fft.rfft2(weight, s=size).conj()
    found, values = [], []
    at_once = max(1, min(_POSES_AT_ONCE, _PIXELS_AT_ONCE // (wide.rows * wide.columns)))
    for some in draws.split(at_once):
        moving = torch.stack(image_gradients(render(level.volume, some, wide, problem.view)), dim=1)
        product = _correlate(moving, fixed_terms, size, margins)
        energy = _correlate(moving.square().sum(1, keepdim=True), weight_term, size, margins)
        least = _LEAST_ENERGY * energy.flatten(1).amax(1)[:, None, None].clamp_min(1e-20)
        score = (product / torch.maximum(energy, least).sqrt()).cpu()
        score = score.masked_fill(~_in_range(problem, detector, some, margins), -1)
        value, at = _peaks(score, peaks)
        shift_px = torch.stack([at[..., 1] - margins[0], at[..., 0] - margins[1]], dim=-1)
        found.append(_shifted(problem, some, shift_px * detector.pixel_mm))
        values.append(value)
    parameters, similarity = torch.cat(found).flatten(0, 1), torch.cat(values).flatten()
    order = similarity.argsort(descending=True)
    return Candidates(parameters[order], similarity[order])


def screen_one_by_one(problem: Problem, level: Level, poses: int, seed: int) -> Candidates:
    """As ``screen``, but each of ``poses`` draws over all free parameters tells of itself alone: what shifts are worth.

    The similarity is exact.
    """
    draws = _draws(problem, poses, seed, shifted=())
    similarity = level.similarities(draws).double()
    order = similarity.argsort(descending=True)
    return Candidates(draws[order], similarity[order])


def _draws(problem: Problem, poses: int, seed: int, shifted: tuple[int, ...] = SHIFTED) -> Float[Tensor, "n 9"]:
    kept = [i for i, p in enumerate(problem.free) if p not in shifted]
    poses = poses if kept else 1
    unit = SobolEngine(max(1, len(kept)), scramble=True, seed=seed).draw(poses, dtype=torch.float64)
    values = problem.initial[problem.free].expand(poses, -1).clone()
    lower, upper = problem.lower[kept], problem.upper[kept]
    values[:, kept] = lower + unit[:, : len(kept)] * (upper - lower)
    return problem.embed(values)


def _magnification(parameters: Float[Tensor, "*b 9"]) -> Float[Tensor, "*b"]:
    return parameters[..., 2] / (parameters[..., 2] - parameters[..., 5]).clamp_min(1)


def _margins(problem: Problem, detector: Detector, draws: Float[Tensor, "n 9"]) -> tuple[int, int]:
    """How many columns and rows the anatomy may move to either side, magnified up to so much more than at the start."""
    most = min(float(_magnification(draws).max()), _MOST_MAGNIFIED * float(_magnification(problem.initial)))
    across = most * problem.half_range[list(SHIFTED)] / detector.pixel_mm
    margins = [math.ceil(float(n)) if p in problem.free else 0 for p, n in zip(SHIFTED, across, strict=True)]
    return margins[0], margins[1]


def _fast_size(least: int) -> int:
    """The next whole number without prime factors over 5: transforms like it."""
    rest = least
    for p in (2, 3, 5):
        while rest % p == 0:
            rest //= p
    return least if rest == 1 else _fast_size(least + 1)


def _correlate(images: Tensor, terms: Tensor, size: list[int], margins: tuple[int, int]) -> Tensor:
    """Sum over the fixed image's pixels and over images [n, m, h, w] shifted by 0 ... twice the margin, times what the
    m ``terms`` are of."""
    product = torch.fft.irfft2((torch.fft.rfft2(images, s=size) * terms).sum(1), s=size)
    return product[:, : 2 * margins[1] + 1, : 2 * margins[0] + 1]


def _in_range(
    problem: Problem, detector: Detector, poses: Float[Tensor, "n 9"], margins: tuple[int, int]
) -> Bool[Tensor, "n r c"]:
    """Which shifts the range holds, half a pixel more at least."""
    inside = []
    for axis, margin in zip(SHIFTED, margins, strict=True):
        offset = (torch.arange(2 * margin + 1) - margin).abs() * detector.pixel_mm
        most = problem.half_range[axis] * _magnification(poses) + detector.pixel_mm / 2
        inside.append(offset <= most[:, None])
    return inside[1][:, :, None] & inside[0][:, None, :]


def _peaks(score: Float[Tensor, "n r c"], peaks: int) -> tuple[Float[Tensor, "n k"], Tensor]:
    """Values and (row, column) of the highest blocks of 3 x 3 that none of the eight beside them exceeds."""
    rows, columns = score.shape[1:]
    score = pad(score, (0, -columns % 3, 0, -rows % 3), value=-torch.inf)
    in_block = torch.cartesian_prod(torch.arange(3), torch.arange(3))
    block = reduce(torch.maximum, (score[:, i::3, j::3] for i, j in in_block.tolist()))
    down, across = block.shape[1:]
    around = pad(block, (1, 1, 1, 1), value=-torch.inf)
    highest = reduce(torch.maximum, (around[:, i : i + down, j : j + across] for i, j in in_block.tolist()))
    at_peak = torch.where(block >= highest, block, -torch.inf).flatten(1)
    value, of_block = at_peak.topk(min(peaks, at_peak.shape[1]), dim=1)
    pixels = 3 * torch.stack([of_block // across, of_block % across], dim=-1)[:, :, None] + in_block
    pose = torch.arange(len(score))[:, None, None]
    highest_pixel = score[pose, pixels[..., 0], pixels[..., 1]].argmax(2)[..., None, None]
    at = pixels.gather(2, highest_pixel.expand(-1, -1, 1, 2))[:, :, 0]
    return value.double().nan_to_num(nan=-1, neginf=-1), at


def _shifted(
    problem: Problem, poses: Float[Tensor, "n 9"], offset_mm: Float[Tensor, "n k 2"]
) -> Float[Tensor, "n k 9"]:
    """The patient moved so that what the wide image shows at an offset (right, down) comes to the detector's middle."""
    moved = poses[:, None].expand(-1, offset_mm.shape[1], -1).clone()
    by = offset_mm / _magnification(poses)[:, None, None]
    moved[..., 3] -= by[..., 0]
    moved[..., 4] += by[..., 1]
    return problem.embed(moved[..., problem.free].clamp(problem.lower, problem.upper))
