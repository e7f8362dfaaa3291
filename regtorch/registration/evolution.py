"""The paper's method (section 2.2.3): many starts of CMA-ES at once, on two levels of a pyramid.

What the paper's lost Table 1 held (population, first step sizes, stopping, how many starts go on) is declared here.
"""

from collections.abc import Callable
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.optimization import Optimum, cma_es, multi_start
from regtorch.registration.candidates import distinct
from regtorch.registration.matcher import Matcher, Tally
from regtorch.registration.objective import Level
from regtorch.registration.problem import Found, Problem
from regtorch.registration.uncertainty import covariance
from regtorch.similarity import gradient_correlation
from regtorch.similarity.gram import fixed_gradients

_SMALL = 1e-3


def evolution(
    problem: Problem,
    *,
    starts: int = 100,
    pixels: tuple[int, int] = (125, 500),
    voxel_per_pixel: float = 1.3,
    population: int | None = None,
    sigma_fraction: float = 0.3,
    generations: int = 60,
    survivors: int = 5,
    finalists: int = 2,
    least_share: float = 0.8,
    restart_shift_mm: float = 0.3,
    final_generations: int = 300,
    tolerances: tuple[float, float, float] = (1e-4, 1e-5, 1e-6),
    optimizer: Callable[..., Optimum] = cma_es,
) -> Found:
    """Split the range into ``starts`` cells of a kD-tree, search from each, finish the best on the second level.

    ``pixels`` is the longer side of either level's image; a voxel is ``voxel_per_pixel`` times what a pixel covers in
    the patient. Every start has ``generations`` on the first level. The best ``survivors`` that differ converge there;
    of these the ``finalists`` that reach ``least_share`` of the best similarity converge on the second level. Whoever
    goes on does so with the distribution it has learned, scaled to move the anatomy by ``restart_shift_mm`` in the
    detector plane, and ends when the similarities of its generations spread by less than the stage's tolerance.
    """
    lower, upper = problem.lower, problem.upper
    coarse, fine = (problem.level(longest, voxel_per_pixel) for longest in pixels)

    def searcher(level: Level, stage: int, share: tuple[float, float], limit: int, n: int) -> Callable[..., Optimum]:
        def report(generation: int, running: int, cost: Float[Tensor, " n"]) -> None:
            done = share[0] + (share[1] - share[0]) * generation / limit
            detector = level.fixed.detector
            what = f"{detector.columns} x {detector.rows} pixels, starts: {running}"
            problem.progress(done, f"{what}, similarity: {-float(cost.min()):.4f}")

        return partial(
            optimizer,
            lambda values: -level.similarities(problem.embed(values)),
            population=population,
            max_generations=limit,
            tol_fun=tolerances[stage],
            seed=problem.seed,
            streams=range(stage * starts, stage * starts + n),
            on_generation=report,
        )

    def go_on(level: Level, stage: int, share: tuple[float, float], before: Optimum, chosen: list[int]) -> Optimum:
        x, covariance = before.x[chosen], before.covariance[chosen]
        deviations = covariance.diagonal(dim1=1, dim2=2).sqrt()
        factor = restart_shift_mm / _shift_mm(problem, x, covariance)
        search = searcher(level, stage, share, final_generations, len(chosen))
        return search(x, deviations * factor[:, None], lower=lower, upper=upper, covariance=covariance)

    all_starts = multi_start(
        searcher(coarse, 0, (0.0, 0.6), generations, starts),
        lower,
        upper,
        starts=starts,
        scale=1 / problem.sensitivity(),
        sigma_fraction=sigma_fraction,
    )
    apart_mm = coarse.fixed.detector.pixel_mm
    chosen = _distinct(problem, all_starts, apart_mm)[:survivors]
    converged = go_on(coarse, 1, (0.6, 0.7), all_starts, chosen)
    best = converged.cost.min()
    worst = torch.maximum(best, least_share * best)
    chosen = [start for start in _distinct(problem, converged, apart_mm)[:finalists] if converged.cost[start] <= worst]
    final = go_on(fine, 2, (0.7, 1.0), converged, chosen)
    order = all_starts.cost.argsort()
    best = problem.embed(final.x[final.best])
    spread = None
    if problem.similarity is gradient_correlation:
        gradients = fixed_gradients(fine.fixed.image, fine.fixed.weight)
        spread = covariance(Matcher(problem, fine, gradients, Tally()), best)
    return Found(
        parameters=best,
        similarity=-float(final.cost[final.best]),
        starts=problem.embed(all_starts.x[order]),
        start_similarity=-all_starts.cost[order],
        evaluations=int(sum(optimum.evaluations.sum() for optimum in (all_starts, converged, final))),
        covariance=spread,
    )


def _distinct(problem: Problem, found: Optimum, shift_mm: float) -> list[int]:
    """Which starts ended at places that look different, best first."""
    order = found.cost.argsort()
    kept = distinct(problem, problem.embed(found.x[order]), shift_mm, len(order))
    return order[kept].tolist()


def _shift_mm(
    problem: Problem, means: Float[Tensor, "n d"], covariances: Float[Tensor, "n d d"]
) -> Float[Tensor, " n"]:
    """How far a draw from each distribution moves the points, to first order: root of the sum over its axes."""
    values, axes = torch.linalg.eigh(covariances)
    steps = axes * values.clamp(min=0).sqrt()[:, None]
    moved = problem.embed(means[:, None] + _SMALL * steps.mT)
    return problem.shift_mm(moved, problem.embed(means)[:, None]).square().sum(1).sqrt() / _SMALL
