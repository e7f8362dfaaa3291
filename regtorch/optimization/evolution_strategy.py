"""CMA-ES for many starts at once. Hansen, The CMA Evolution Strategy: A Tutorial, arXiv 1604.00772 (equations below).

All starts share the generation counter g. Each running start is a row of every tensor; an ended start leaves the batch.
"""

from collections.abc import Callable, Sequence

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from regtorch.errors import RegtorchError
from regtorch.optimization.optimum import Optimum
from regtorch.optimization.rows import Rows, first_rows, principal_axes
from regtorch.optimization.start import Start, prepare
from regtorch.optimization.stopping import Tolerances, converged, degenerate
from regtorch.optimization.strategy import Strategy, default_strategy

Objective = Callable[[Float[Tensor, "m d"]], Float[Tensor, " m"]]

BLOCK = 32  # generations whose random numbers a start draws at once


def cma_es(
    objective: Objective,
    start: Float[Tensor, "n d"],
    sigma: Float[Tensor, " d"] | Float[Tensor, "n d"],
    *,
    lower: Float[Tensor, " d"] | None = None,
    upper: Float[Tensor, " d"] | None = None,
    covariance: Float[Tensor, "n d d"] | None = None,
    population: int | None = None,
    max_generations: int = 5000,
    max_evaluations: int | None = None,
    tol_fun: float = 1e-12,
    tol_fun_hist: float = 0.0,
    tol_x: float = 1e-12,
    seed: int = 0,
    streams: Sequence[int] | None = None,
    on_generation: Callable[[int, int, Float[Tensor, " n"]], None] | None = None,
) -> Optimum:
    """Minimise from n starts by active CMA-ES with the tutorial's defaults, stopping rules and bounds by ``Box``.

    To the last digit a start's path is independent of the others. Bad arguments raise ``RegtorchError``. A start ends
    for one of: TolFun, EqualFunValues, TolFunHist (pycma's), Stagnation, TolX, TolXUp, NoEffectCoord, NoEffectAxis,
    ConditionCov (appendix B.3), MaxEvaluations, MaxGenerations.

    Args:
        objective: gets the populations of all running starts (float64, CPU) once per generation. It returns one cost
            each; a cost that is not finite counts as the worst.
        start, sigma, lower, upper: first means and standard deviations, and bounds, in the parameters' units.
        covariance: shape of the first distribution, at any scale. It is scaled until one deviation reaches ``sigma``.
        population: lambda; None means 4 + floor(3 ln d).
        max_generations, max_evaluations: budget of each start.
        tol_fun, tol_fun_hist, tol_x: the first two in units of the cost (0: off), the last relative to ``sigma``.
        seed, streams: seed, and the random stream of each start; None means i for start i.
        on_generation: is told the generation, the number of running starts and each start's best cost so far.
    """
    begin = prepare(start, sigma, lower, upper, covariance)
    n, d = begin.u.shape
    strategy = default_strategy(d, population)
    tolerances = Tolerances(tol_fun, tol_fun_hist, tol_x)
    limit, at_limit = _limit(strategy.lam, max_generations, max_evaluations)
    random = _generators(seed, n, streams)
    rows, end, reasons = first_rows(begin), _empty(begin), [at_limit] * n
    for g in range(1, limit + 1):
        if (g - 1) % BLOCK == 0:
            block = _drawn(random, rows, (BLOCK, strategy.lam, d))
        cost = _generation(objective, begin, strategy, rows, block[:, (g - 1) % BLOCK], g)
        end.cost[rows.start] = rows.best_cost
        if on_generation is not None:
            on_generation(g, len(rows.start), end.cost.clone())
        rules = converged(g, cost, rows, tolerances) | degenerate(g, rows, tolerances)
        ended = _ended(rules, rows, reasons)
        ended = ended if g < limit else torch.ones_like(ended)
        if not bool(ended.any()):
            continue
        _write(end, begin, rows, ended, g, strategy.lam)
        rows.keep(~ended)
        block = block[~ended]
        if len(rows.start) == 0:
            break
    return Optimum(end.x, end.cost, end.evaluations, end.generations, tuple(reasons), end.mean, end.covariance)


def _limit(population: int, max_generations: int, max_evaluations: int | None) -> tuple[int, str]:
    """Generations within the budget, and the reason of a start that ends there."""
    limit, reason = max_generations, "MaxGenerations"
    if max_evaluations is not None and max_evaluations // population < limit:
        limit, reason = max_evaluations // population, "MaxEvaluations"
    if limit < 1:
        raise RegtorchError(f"a budget of {limit} generations of {population} evaluations: expected at least one")
    return limit, reason


def _generators(seed: int, n: int, streams: Sequence[int] | None) -> list[torch.Generator]:
    """One generator per start, of a hashed seed: neighbouring seeds share no stream."""
    states = [np.random.SeedSequence([seed, stream]) for stream in (range(n) if streams is None else streams)]
    if len(states) != n:
        raise RegtorchError(f"{len(states)} random streams for {n} starts: expected one each")
    return [torch.Generator().manual_seed(int(state.generate_state(1)[0])) for state in states]


def _drawn(random: list[torch.Generator], rows: Rows, shape: tuple[int, int, int]) -> Float[Tensor, "a g lam d"]:
    """Standard normal numbers of some generations for every running start."""
    drawn = [torch.randn(shape, generator=random[i], dtype=torch.float64) for i in rows.start.tolist()]
    return torch.stack(drawn)


def _empty(begin: Start) -> Optimum:
    n = len(begin.u)
    return Optimum(
        begin.real(begin.u),
        torch.full((n,), torch.inf, dtype=torch.float64),
        torch.zeros(n, dtype=torch.int64),
        torch.zeros(n, dtype=torch.int64),
        (),
        torch.empty_like(begin.u),
        torch.empty_like(begin.shape),
    )


def _ended(rules: dict[str, Tensor], rows: Rows, reasons: list[str]) -> Bool[Tensor, " a"]:
    """Running starts that a rule ends; the first such rule becomes a start's reason."""
    names, hits = list(rules), torch.stack(list(rules.values()))
    for row in hits.any(0).nonzero()[:, 0].tolist():
        reasons[int(rows.start[row])] = names[int(hits[:, row].int().argmax())]
    return hits.any(0)


def _generation(
    objective: Objective, begin: Start, s: Strategy, rows: Rows, z: Float[Tensor, "a lam d"], g: int
) -> Float[Tensor, "a lam"]:
    """Sample, evaluate, select and adapt once, in place; returns the costs, lowest first.

    Sums of products replace matrix products, whose last digits depend on a matrix's place in the batch. For matrices
    this small, threads also cost more time than they save.
    """
    a, lam, d = z.shape
    scaled = z * rows.D[:, None]
    y = sum(scaled[:, :, j, None] * rows.B[:, None, :, j] for j in range(d))  # eqs. 38-39
    u = rows.m[:, None] + rows.sigma[:, None, None] * y  # eq. 40
    cost = objective(begin.real(u, rows.start).flatten(0, 1)).detach()
    if cost.shape != (a * lam,):
        raise RegtorchError(
            f"objective returned shape {tuple(cost.shape)}: expected one cost for each of {a * lam} points"
        )
    cost = cost.to("cpu", torch.float64).nan_to_num(nan=torch.inf, posinf=torch.inf, neginf=torch.inf).view(a, lam)
    cost, order = cost.sort(dim=1, stable=True)
    y, z = (v.gather(1, order[:, :, None].expand(a, lam, d)) for v in (y, z))

    better = cost[:, 0] < rows.best_cost
    rows.best_u = torch.where(better[:, None], u[torch.arange(a), order[:, 0]], rows.best_u)
    rows.best_cost = torch.minimum(cost[:, 0], rows.best_cost)
    if g > rows.best.shape[1]:
        more = torch.empty(a, max(256, g), dtype=torch.float64)
        rows.best, rows.median = torch.cat([rows.best, more], 1), torch.cat([rows.median, more], 1)
    rows.best[:, g - 1], rows.median[:, g - 1] = cost[:, 0], cost[:, (lam - 1) // 2]

    positive = s.w.clamp_min(0)[:, None]
    y_w, z_w = (positive * y).sum(1), (positive * z).sum(1)  # eq. 41
    rows.m = rows.m + rows.sigma[:, None] * y_w  # eq. 42, c_m = 1 (eq. 54)
    whitened = (rows.B * z_w[:, None]).sum(2)  # C^(-1/2) <y>_w, as y = B D z
    rows.p_sigma = (1 - s.c_sigma) * rows.p_sigma + (s.c_sigma * (2 - s.c_sigma) * s.mu_eff) ** 0.5 * whitened  # eq. 43
    length = rows.p_sigma.norm(dim=1)
    rows.sigma = rows.sigma * ((s.c_sigma / s.d_sigma) * (length / s.chi_n - 1)).exp()  # eq. 44

    h_sigma = (length / (1 - (1 - s.c_sigma) ** (2 * g)) ** 0.5 < (1.4 + 2 / (d + 1)) * s.chi_n).double()
    rows.p_c = (1 - s.c_c) * rows.p_c + (h_sigma * (s.c_c * (2 - s.c_c) * s.mu_eff) ** 0.5)[:, None] * y_w  # eq. 45
    w = torch.where(s.w >= 0, s.w, s.w * d / z.square().sum(2).clamp_min(1e-300))  # eq. 46, as |C^(-1/2) y| = |z|
    delta = (1 - h_sigma) * s.c_c * (2 - s.c_c)
    decay = 1 + s.c_1 * delta - s.c_1 - s.c_mu * float(s.w.sum())
    rank_one = rows.p_c[:, :, None] * rows.p_c[:, None]
    weighted = w[:, :, None] * y
    rank_mu = sum(weighted[:, k, :, None] * y[:, k, None] for k in range(lam))
    rows.C = decay[:, None, None] * rows.C + s.c_1 * rank_one + s.c_mu * rank_mu  # eq. 47
    if g % s.lazy_gap == 0:
        rows.B, rows.D = principal_axes(rows.C)
    return cost


def _write(end: Optimum, begin: Start, rows: Rows, ended: Tensor, g: int, lam: int) -> None:
    starts, scale = rows.start[ended], begin.scale[rows.start[ended]]
    end.x[starts] = begin.real(rows.best_u[ended], starts)
    end.generations[starts] = g
    end.evaluations[starts] = g * lam
    end.mean[starts] = begin.real(rows.m[ended], starts)
    C = rows.sigma[ended, None, None] ** 2 * rows.C[ended]
    end.covariance[starts] = (C + C.mT) / 2 * scale[:, :, None] * scale[:, None, :]
