"""Levenberg-Marquardt for normalised correlations, many starts at once."""

from collections.abc import Callable
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

Equations = Callable[[Float[Tensor, "n d"]], tuple[Float[Tensor, " n"], Float[Tensor, "n d d"], Float[Tensor, "n d"]]]


class Ascent(NamedTuple):
    """Where each start ended, how similar that is, with which J^T J, and how many points were looked at."""

    x: Float[Tensor, "n d"]
    similarity: Float[Tensor, " n"]
    jtj: Float[Tensor, "n d d"]
    evaluations: int


def levenberg_marquardt(
    equations: Equations,
    start: Float[Tensor, "n d"],
    *,
    lower: Float[Tensor, " d"],
    upper: Float[Tensor, " d"],
    scale: Float[Tensor, " d"],
    steps: int,
    tolerance: float = 1e-3,
    damping: float = 1e-2,
    least_gain: float = 2e-5,
    least_similarity: float = 0.1,
) -> Ascent:
    """Climb the mean rho of normalised correlations M F, whose residuals are M - F with Jacobian J.

    ``equations`` gives rho, J^T J and J^T (M - F) summed over the correlations. Where M and F are unlike, the curvature
    of rho is not J^T J but rho times that: M has constant length, so F M'' = -rho J^T J and a term of the part of F
    beside M. Steps are therefore made with rho J^T J (rho from ``least_similarity`` on), Levenberg's damping in units
    of ``scale``, and taken if rho grows. A start ends when a step is shorter than ``tolerance`` in these units, or is
    not taken though strongly damped. It also ends when a hardly damped step, which no limit cuts off, gains less than
    ``least_gain`` of 1 - rho. A step that gains no more by J^T J is not tried. Points stay between ``lower`` and
    ``upper``: a parameter at a limit that wants beyond rests.
    """
    x = start.clamp(lower, upper)
    similarity, jtj, jtr = (part.clone() for part in equations(x))
    evaluations = len(x)
    factor = x.new_full((len(x),), damping)
    active = torch.arange(len(x))
    for _ in range(steps):
        if not len(active):
            break
        here = x[active]
        slope = jtr[active] * scale
        resting = ((here <= lower) & (slope > 0)) | ((here >= upper) & (slope < 0))
        curvature = jtj[active] * scale[:, None] * scale
        curvature = curvature * similarity[active].clamp(min=least_similarity)[:, None, None]
        step = _damped_step(curvature, slope, factor[active], resting)
        wanted = here + step * scale
        there = wanted.clamp(lower, upper)
        foretold = -((slope + (curvature @ step[..., None])[..., 0] / 2) * step).sum(1)
        free = (factor[active] < 1) & (there == wanted).all(1)
        near = free & (foretold < least_gain * (1 - similarity[active]))
        here, there, free, active = here[~near], there[~near], free[~near], active[~near]
        if not len(active):
            break
        found, there_jtj, there_jtr = equations(there)
        evaluations += len(there)
        gain = found - similarity[active]
        better = gain > 0
        ended = free & better & (gain < least_gain * (1 - found))
        taken = active[better]
        x[taken], similarity[taken] = there[better], found[better]
        jtj[taken], jtr[taken] = there_jtj[better], there_jtr[better]
        factor[active] *= torch.where(better, 0.25, 5.0).to(x)
        length = ((there - here) / scale).norm(dim=1)
        active = active[~(ended | (length < tolerance) | (factor[active] > 1e4))]
    return Ascent(x, similarity, jtj, evaluations)


def _damped_step(
    curvature: Float[Tensor, "n d d"],
    slope: Float[Tensor, "n d"],
    factor: Float[Tensor, " n"],
    resting: Bool[Tensor, "n d"],
) -> Float[Tensor, "n d"]:
    """Levenberg's step; 0 for resting parameters, and for all of a start whose equations cannot be solved."""
    level = curvature.diagonal(dim1=1, dim2=2)
    damped = curvature + torch.diag_embed(
        factor[:, None] * (level + level.mean(1, keepdim=True)) + torch.finfo(slope.dtype).tiny
    )
    moving = (~resting).to(slope)
    damped = damped * moving[:, :, None] * moving[:, None, :] + torch.diag_embed(1 - moving)
    step, failed = torch.linalg.solve_ex(damped, -(slope * moving)[..., None])
    return torch.where(((failed == 0)[:, None]) & step[..., 0].isfinite().all(1, keepdim=True), step[..., 0], 0)
