"""The paper's method (section 2.2.3): many starts of CMA-ES at once, on two levels of a pyramid.

The numbers of the paper's lost Table 1 (population, first step sizes, stopping, starts that go on) are declared here.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.optimization import Optimum, cma_es, multi_start
from regtorch.registration.found import Found
from regtorch.registration.problem import Problem
from regtorch.registration.search.matcher import Matcher
from regtorch.registration.search.settings import Settings
from regtorch.registration.trace import Trace
from regtorch.registration.trust.evidence import measure
from regtorch.similarity import gradient_correlation

_SMALL = 1e-3
"""Share of a standard deviation by which a distribution's effect on the image is measured."""

_DONE = ((0.0, 0.6), (0.6, 0.7), (0.7, 1.0))
"""Shares of the progress that the three stages begin and end at."""


@dataclass(frozen=True)
class _Run:
    """The part that the three stages share."""

    problem: Problem
    optimizer: Callable[..., Optimum]
    population: int | None
    starts: int
    tolerances: tuple[float, float, float]

    def searcher(self, level: Matcher, stage: int, limit: int, n: int) -> Callable[..., Optimum]:
        """The optimiser of one stage: at most ``limit`` generations of ``n`` starts, random streams of its own."""
        begin, end = _DONE[stage]
        detector = level.fixed.detector

        def report(generation: int, running: int, cost: Float[Tensor, " n"]) -> None:
            what = f"{detector.columns} x {detector.rows} pixels, starts: {running}"
            share = begin + (end - begin) * generation / limit
            self.problem.progress(share, f"{what}, similarity: {-float(cost.min()):.4f}")

        return partial(
            self.optimizer,
            lambda values: -level.similarity(self.problem.parameters(values)),
            population=self.population,
            max_generations=limit,
            tol_fun=self.tolerances[stage],
            seed=self.problem.seed,
            streams=range(stage * self.starts, stage * self.starts + n),
            on_generation=report,
        )

    def go_on(
        self, level: Matcher, stage: int, limit: int, before: Optimum, chosen: list[int], shift_mm: float
    ) -> Optimum:
        """From the ends of ``before``, with their distributions scaled to move the anatomy by ``shift_mm``."""
        unknowns = self.problem.unknowns
        x, covariance = before.x[chosen], before.covariance[chosen]
        deviations = covariance.diagonal(dim1=1, dim2=2).sqrt()
        factor = shift_mm / _spread_mm(self.problem, x, covariance)
        search = self.searcher(level, stage, limit, len(chosen))
        box = {"lower": unknowns.lower, "upper": unknowns.upper}
        found = search(x, deviations * factor[:, None], **box, covariance=covariance)
        _note(level, found, ("", "converge", "finish")[stage])
        return found

    def distinct(self, found: Optimum, within_mm: float) -> list[int]:
        """Indices of the starts that ended at different places, best first."""
        order = found.cost.argsort()
        parameters = self.problem.parameters(found.x[order])
        return order[self.problem.distinct(parameters, within_mm, len(order))].tolist()


def cmaes(
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
    """Search from every cell of a kD-tree on the first level, and finish the best on the second.

    A start that goes on keeps the distribution that it has learned, scaled.

    Args:
        starts: Cells that the range is split into, each with a start.
        pixels: Pixels of the longer side on either level.
        voxel_per_pixel: Voxel of a level, as a multiple of a pixel's size in the patient.
        population: Poses of a generation; None: the optimiser's default.
        sigma_fraction: First standard deviations, as a share of the cell's sides.
        generations: Generations of every start on the first level.
        survivors: Different starts that converge on the first level.
        finalists: Different starts that converge on the second level.
        least_share: Least similarity of a finalist, as a share of the best one's.
        restart_shift_mm: Move of the anatomy, mm in the detector plane, that a distribution is scaled to.
        final_generations: Most generations of the two later stages.
        tolerances: Spread of the similarity over generations at which each stage ends.
        optimizer: ``cma_es`` or ``pycma``.
    """
    unknowns, trace = problem.unknowns, Trace()
    settings = Settings(voxel_per_pixel=voxel_per_pixel, least_averaging=1.0)
    coarse, fine = (Matcher.of(problem, settings, problem.attenuating, longest, trace) for longest in pixels)
    run = _Run(problem, optimizer, population, starts, tolerances)
    all_starts = multi_start(
        run.searcher(coarse, 0, generations, starts),
        unknowns.lower,
        unknowns.upper,
        starts=starts,
        scale=1 / problem.sensitivity,
        sigma_fraction=sigma_fraction,
    )
    _note(coarse, all_starts, "starts")
    chosen = run.distinct(all_starts, coarse.pixel_mm)[:survivors]
    converged = run.go_on(coarse, 1, final_generations, all_starts, chosen, restart_shift_mm)
    best = converged.cost.min()
    worst = torch.maximum(best, least_share * best)
    chosen = [start for start in run.distinct(converged, coarse.pixel_mm)[:finalists] if converged.cost[start] <= worst]
    final = run.go_on(fine, 2, final_generations, converged, chosen, restart_shift_mm)
    return _found(problem, all_starts, final, fine)


def _found(problem: Problem, all_starts: Optimum, final: Optimum, fine: Matcher) -> Found:
    order = all_starts.cost.argsort()
    best, similarity = problem.parameters(final.x[final.best]), -float(final.cost[final.best])
    starts, start_similarity = problem.parameters(all_starts.x[order]), -all_starts.cost[order]
    comparable = problem.similarity is gradient_correlation
    evaluations = fine.trace.evaluations
    covariance = fine.covariance(best) if comparable else None
    return Found(
        parameters=best,
        similarity=similarity,
        starts=starts,
        start_similarity=start_similarity,
        evaluations=evaluations,
        covariance=covariance,
        evidence=measure(
            problem, best, similarity, starts, start_similarity, comparable=comparable, covariance=covariance
        ),
        trace=tuple(fine.trace.steps),
    )


def _note(level: Matcher, found: Optimum, name: str) -> None:
    level.trace.add(name, level.pixels, len(found.x), -float(found.cost.min()))


def _spread_mm(
    problem: Problem, means: Float[Tensor, "n d"], covariances: Float[Tensor, "n d d"]
) -> Float[Tensor, " n"]:
    """How far a draw from each distribution moves the points, to first order: root of the sum over its axes."""
    values, axes = torch.linalg.eigh(covariances)
    steps = axes * values.clamp(min=0).sqrt()[:, None]
    moved = problem.parameters(means[:, None] + _SMALL * steps.mT)
    return problem.shift_mm(moved, problem.parameters(means)[:, None]).square().sum(1).sqrt() / _SMALL
