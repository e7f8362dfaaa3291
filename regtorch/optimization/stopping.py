"""Stopping rules for all starts at once: appendix B.3 of Hansen's tutorial, arXiv 1604.00772."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from regtorch.optimization.rows import Rows

STAGNATION_EVERY = 10
"""Generations between two tests of long histories, the only costly rule."""


@dataclass(frozen=True)
class Tolerances:
    """``fun`` and ``fun_hist`` are in units of the cost, ``x`` in units of the first standard deviations."""

    fun: float
    fun_hist: float
    x: float
    x_up: float = 1e4
    condition: float = 1e14


def converged(
    g: int, cost: Float[Tensor, "a lam"], rows: Rows, tolerances: Tolerances
) -> dict[str, Bool[Tensor, " a"]]:
    """Rules on the costs, after generation ``g`` (counted from 1) with costs ``cost``."""
    n, lam = rows.m.shape[1], cost.shape[1]
    best, median = rows.best[:, :g], rows.median[:, :g]
    rules = {}
    window = 10 + math.ceil(30 * n / lam)
    if g >= window:
        recent = best[:, -window:]
        low, high = recent.amin(1), recent.amax(1)
        both = torch.maximum(high, cost.amax(1)) - torch.minimum(low, cost.amin(1))
        rules["TolFun"] = both < tolerances.fun
        rules["EqualFunValues"] = low == high
        rules["TolFunHist"] = high - low < tolerances.fun_hist
    window = max(min(g // 5, 20_000), math.ceil(120 + 30 * n / lam))
    if g >= window and g % STAGNATION_EVERY == 0:
        third = math.ceil(0.3 * window)
        stagnant = torch.ones(len(cost), dtype=torch.bool)
        for history in (best[:, -window:], median[:, -window:]):
            stagnant &= history[:, -third:].median(1).values >= history[:, :third].median(1).values
        rules["Stagnation"] = stagnant
    return rules


def degenerate(g: int, rows: Rows, tolerances: Tolerances) -> dict[str, Bool[Tensor, " a"]]:
    """Rules on the search distribution."""
    step, m = rows.sigma[:, None], rows.m
    deviation = step * rows.C.diagonal(dim1=1, dim2=2).sqrt()
    axis = (g - 1) % m.shape[1]
    along = 0.1 * step * rows.D[:, axis, None] * rows.B[:, :, axis]
    longest, shortest = rows.D[:, -1], rows.D[:, 0]
    return {
        "TolX": torch.maximum(deviation, (step * rows.p_c).abs()).amax(1) < tolerances.x,
        "TolXUp": rows.sigma * longest > tolerances.x_up * rows.first_length,
        "NoEffectCoord": (m == m + 0.2 * deviation).any(1),
        "NoEffectAxis": (m == m + along).all(1),
        "ConditionCov": longest > math.sqrt(tolerances.condition) * shortest,
    }
