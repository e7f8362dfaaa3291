"""Poses drawn over the whole range, each at all in-plane shifts at once: where a search should begin."""

import math
from functools import reduce
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn.functional import pad
from torch.quasirandom import SobolEngine

from regtorch.batches import CACHED, at_once
from regtorch.drr import render
from regtorch.geometry import Z_OBJ, Z_S, Detector
from regtorch.imaging import Radiograph
from regtorch.registration.problem import SHIFTED, Problem
from regtorch.registration.search.matcher import Matcher
from regtorch.similarity.gradients import gradient_weight, image_gradients

_TINY = 1e-12
_MOST_AT_ONCE = 64


class Candidates(NamedTuple):
    """Poses (mm, rad), best first, and their gradient correlation: exact, or the estimate of ``screen``."""

    parameters: Float[Tensor, "n 9"]
    similarity: Float[Tensor, " n"]


def screen(matcher: Matcher, poses: int, seed: int) -> Candidates:
    """The best in-plane shifts of each of ``poses`` draws, by correlation of gradients.

    Moving the patient in the plane of the detector moves its image and hardly changes it. So one DRR, wide enough for
    every shift in the range, gives the correlation at all shifts by Fourier transforms. It is a masked normalised
    cross-correlation of both directions' gradients: the product with the fixed image's, over the root of the DRR's
    energy under the fixed image. ``least_energy`` bounds that energy from below. Frozen shifts are not searched. Draws
    are a scrambled Sobol sequence over the other free parameters.
    """
    problem, settings, fixed = matcher.problem, matcher.settings, matcher.fixed
    detector = fixed.detector
    draws = _draws(problem, poses, seed)
    margins = _margins(problem, detector, draws, settings.most_magnified)
    wide = Detector(
        detector.rows + 2 * margins[1], detector.columns + 2 * margins[0], detector.pixel_mm, detector.centre_mm
    )
    size = [_fast_size(n) for n in (wide.rows, wide.columns)]
    fixed_terms, weight_term = _fixed_terms(fixed, size)
    found, values = [], []
    for some in draws.split(at_once(wide.rows * wide.columns, share=CACHED, most=_MOST_AT_ONCE)):
        moving = torch.stack(image_gradients(render(matcher.volume, some, wide, problem.view)), dim=1)
        product = _correlate(moving, fixed_terms, size, margins)
        energy = _correlate(moving.square().sum(1, keepdim=True), weight_term, size, margins)
        least = settings.least_energy * energy.flatten(1).amax(1)[:, None, None].clamp_min(1e-20)
        score = (product / torch.maximum(energy, least).sqrt()).cpu()
        score = score.masked_fill(~_in_range(problem, detector, some, margins), -1)
        value, at = _peaks(score, settings.peaks)
        shift_px = torch.stack([at[..., 1] - margins[0], at[..., 0] - margins[1]], dim=-1)
        found.append(_shifted(problem, some, shift_px * detector.pixel_mm))
        values.append(value)
    matcher.trace.evaluations += poses
    return best_first(torch.cat(found).flatten(0, 1), torch.cat(values).flatten())


def screen_one_by_one(matcher: Matcher, poses: int, seed: int) -> Candidates:
    """As ``screen``, but each of ``poses`` draws over all free parameters stands for itself; similarities are exact."""
    draws = _draws(matcher.problem, poses, seed, shifted=())
    return best_first(draws, matcher.similarity(draws).double())


def best_first(parameters: Float[Tensor, "n 9"], similarity: Float[Tensor, " n"]) -> Candidates:
    order = similarity.argsort(descending=True)
    return Candidates(parameters[order], similarity[order])


def _fixed_terms(fixed: Radiograph, size: list[int]) -> tuple[Tensor, Tensor]:
    """Conjugate transforms of the fixed image's centred, weighted, normalised gradients, and of their weight."""
    weight = gradient_weight(fixed.weight)
    gradients = torch.cat(image_gradients(fixed.image[None]))
    mean = (gradients * weight).sum((1, 2), keepdim=True) / weight.sum().clamp_min(_TINY)
    weighted = (gradients - mean) * weight
    norm = (weighted.square() / weight.clamp_min(_TINY)).sum().sqrt().clamp_min(_TINY)
    return torch.fft.rfft2(weighted / norm, s=size).conj(), torch.fft.rfft2(weight, s=size).conj()


def _draws(problem: Problem, poses: int, seed: int, shifted: tuple[int, ...] = SHIFTED) -> Float[Tensor, "n 9"]:
    """One pose where nothing but shifts is free."""
    searched = problem.searched
    kept = [index for index in searched.free if index not in shifted]
    poses = poses if kept else 1
    unit = SobolEngine(max(1, len(kept)), scramble=True, seed=seed).draw(poses, dtype=torch.float64)
    draws = searched.initial.expand(poses, -1).clone()
    lower, upper = searched.lower[kept], searched.upper[kept]
    draws[:, kept] = lower + unit[:, : len(kept)] * (upper - lower)
    return draws


def _magnification(parameters: Float[Tensor, "*b 9"]) -> Float[Tensor, "*b"]:
    return parameters[..., Z_S] / (parameters[..., Z_S] - parameters[..., Z_OBJ]).clamp_min(1)


def _margins(
    problem: Problem, detector: Detector, draws: Float[Tensor, "n 9"], most_magnified: float
) -> tuple[int, int]:
    """Columns and rows that the anatomy may move to either side, for magnifications up to a multiple of the start's."""
    searched = problem.searched
    most = min(float(_magnification(draws).max()), most_magnified * float(_magnification(searched.initial)))
    across, down = (math.ceil(float(n)) for n in most * searched.half_range[list(SHIFTED)] / detector.pixel_mm)
    return across, down


def _fast_size(least: int) -> int:
    """The next whole number without prime factors over 5: transforms like it."""
    rest = least
    for p in (2, 3, 5):
        while rest % p == 0:
            rest //= p
    return least if rest == 1 else _fast_size(least + 1)


def _correlate(images: Tensor, terms: Tensor, size: list[int], margins: tuple[int, int]) -> Tensor:
    """Correlation of images [n, m, h, w] with the m fixed images of ``terms``, at shifts of 0 to twice the margin."""
    product = torch.fft.irfft2((torch.fft.rfft2(images, s=size) * terms).sum(1), s=size)
    return product[:, : 2 * margins[1] + 1, : 2 * margins[0] + 1]


def _in_range(
    problem: Problem, detector: Detector, poses: Float[Tensor, "n 9"], margins: tuple[int, int]
) -> Bool[Tensor, "n r c"]:
    """Whether the range holds each shift, to within half a pixel."""
    inside = []
    for axis, margin in zip(SHIFTED, margins, strict=True):
        offset = (torch.arange(2 * margin + 1) - margin).abs() * detector.pixel_mm
        most = problem.searched.half_range[axis] * _magnification(poses) + detector.pixel_mm / 2
        inside.append(offset <= most[:, None])
    return inside[1][:, :, None] & inside[0][:, None, :]


def _peaks(score: Float[Tensor, "n r c"], peaks: int) -> tuple[Float[Tensor, "n k"], Tensor]:
    """Values and (row, column) of the highest blocks of 3 x 3 pixels that exceed their eight neighbours."""
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
    """The patient moved so that the wide image's place at an offset (right, down) comes to the detector's middle."""
    moved = poses[:, None].expand(-1, offset_mm.shape[1], -1).clone()
    by = offset_mm / _magnification(poses)[:, None, None]
    x_obj, y_obj = SHIFTED
    moved[..., x_obj] -= by[..., 0]
    moved[..., y_obj] += by[..., 1]
    return problem.searched.clamped(moved)
