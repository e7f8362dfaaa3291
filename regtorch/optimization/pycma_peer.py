"""The ``cma`` package (N. Hansen's pycma) behind the same call: an established alternative and the tests' oracle."""

import sys
import warnings
from collections.abc import Callable, Sequence

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.errors import RegtorchError
from regtorch.optimization.evolution_strategy import Objective
from regtorch.optimization.optimum import Optimum
from regtorch.optimization.start import Start, prepare


def pycma(
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
    """Minimise from n starts, with the arguments and errors of ``cma_es`` and one call of ``objective`` per generation.

    Bounds and a first covariance become a change of coordinates, as in ``cma_es``. So pycma sees an unbounded problem
    that starts with a unit step. ``reason`` holds pycma's own names ("tolfun", "tolstagnation"), whose rules differ a
    little from the tutorial's. numpy's global generator is neither read nor changed.
    """
    import cma  # half a second, for those who ask for it

    begin = prepare(start, sigma, lower, upper, covariance)
    n = len(begin.u)
    squares, axes = torch.linalg.eigh(begin.shape)
    u_from_v = axes * squares.sqrt()[:, None]
    v_start = torch.linalg.solve(u_from_v, begin.u[:, :, None])[:, :, 0]
    options = {
        "verbose": -10,
        "seed": np.nan,
        "maxiter": max_generations,
        "maxfevals": sys.maxsize if max_evaluations is None else max_evaluations,
        "tolfun": tol_fun,
        "tolfunhist": tol_fun_hist,
        "tolx": tol_x,
        "tolfacupx": 1e4,
    }
    if population is not None:
        options["popsize"] = population
    ids = range(n) if streams is None else streams
    if len(ids) != n:
        raise RegtorchError(f"{len(ids)} random streams for {n} starts: expected one each")
    searches = [
        cma.CMAEvolutionStrategy(v, 1.0, options | {"randn": _standard_normal(seed, stream)})
        for stream, v in zip(ids, v_start.numpy(), strict=True)
    ]
    best_u, best_cost = _searched(objective, begin, u_from_v, searches, on_generation)
    return _optimum(begin, u_from_v, searches, best_u, best_cost)


def _standard_normal(seed: int, stream: int) -> Callable[..., np.ndarray]:
    """A generator of its own for a start, in the form of numpy's ``randn``."""
    generator = np.random.default_rng([seed, stream])
    return lambda *shape: generator.standard_normal(shape)


def _searched(
    objective: Objective,
    begin: Start,
    u_from_v: Float[Tensor, "n d d"],
    searches: list,
    on_generation: Callable[[int, int, Float[Tensor, " n"]], None] | None,
) -> tuple[Float[Tensor, "n d"], Float[Tensor, " n"]]:
    """Runs all searches to their ends; the best point of each (unfolded) and its cost."""
    best_u = begin.u.clone()
    best_cost = torch.full((len(best_u),), torch.inf, dtype=torch.float64)
    running, generation = list(range(len(best_u))), 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # pycma warns of flat costs; its stopping rules act on them
        while running:
            generation += 1
            asked = [searches[i].ask() for i in running]
            v = torch.from_numpy(np.array(asked))
            u = v @ u_from_v[running].mT
            cost = objective(begin.real(u, torch.tensor(running)).flatten(0, 1)).detach().to("cpu", torch.float64)
            cost = cost.nan_to_num(nan=torch.inf, posinf=torch.inf, neginf=torch.inf).view(v.shape[:2])
            for row, i in enumerate(running):
                searches[i].tell(asked[row], cost[row].clamp_max(1e300).tolist())  # it cannot rank infinities
                lowest = int(cost[row].argmin())
                if cost[row, lowest] < best_cost[i]:
                    best_cost[i], best_u[i] = cost[row, lowest], u[row, lowest]
            if on_generation is not None:
                on_generation(generation, len(running), best_cost)
            running = [i for i in running if not searches[i].stop()]
    return best_u, best_cost


def _optimum(
    begin: Start,
    u_from_v: Float[Tensor, "n d d"],
    searches: list,
    best_u: Float[Tensor, "n d"],
    best_cost: Float[Tensor, " n"],
) -> Optimum:
    mean = u_from_v @ torch.from_numpy(np.stack([s.mean for s in searches]))[:, :, None]
    C = torch.from_numpy(np.stack([s.sigma**2 * s.sm.covariance_matrix for s in searches]))
    to_real = begin.scale[:, :, None] * u_from_v
    return Optimum(
        begin.real(best_u),
        best_cost,
        torch.tensor([s.countevals for s in searches]),
        torch.tensor([s.countiter for s in searches]),
        tuple(next(iter(s.stop())) for s in searches),
        begin.real(mean[:, :, 0]),
        to_real @ C @ to_real.mT,
    )
