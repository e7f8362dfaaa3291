"""CMA-ES: convergence, invariances, bounds, reproducibility, warm start, bad input."""

from functools import partial

import numpy as np
import pytest
import torch

from regtorch.errors import RegtorchError
from regtorch.optimization import cma_es, evolution_strategy
from regtorch.optimization.evolution_strategy import _generation
from regtorch.optimization.rows import first_rows
from regtorch.optimization.start import prepare
from regtorch.optimization.strategy import Strategy, default_strategy

from .problems import HitTime, ellipsoid, random_rotation, rosenbrock, sphere


def _starts(n: int, d: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(n, d, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("d", [1, 2, 6, 9])
def test_converges_on_the_sphere(d):
    optimum = cma_es(sphere, _starts(8, d), torch.full((d,), 0.5))
    assert optimum.x.shape == (8, d)
    assert bool((optimum.cost < 1e-10).all())
    torch.testing.assert_close(optimum.cost, sphere(optimum.x))
    assert optimum.best == int(optimum.cost.argmin())
    assert set(optimum.reason) == {"TolFun"}


def test_counts_are_the_calls():
    calls = []

    def counted(x):
        calls.append(len(x))
        return sphere(x)

    running = []
    optimum = cma_es(
        counted, _starts(7, 3), torch.ones(3), population=8, on_generation=lambda g, n, cost: running.append(n)
    )
    assert len(calls) == int(optimum.generations.max())
    assert sum(calls) == int(optimum.evaluations.sum())
    assert calls == [8 * n for n in running]
    assert running[0] == 7
    assert running[-1] < 7, "starts that have ended leave the batch"
    assert running == sorted(running, reverse=True)
    assert torch.equal(optimum.evaluations, 8 * optimum.generations)


def test_same_seed_same_digits_and_another_seed_others():
    run = partial(cma_es, rosenbrock, _starts(5, 4), torch.full((4,), 0.5))
    first, again, other = run(seed=3), run(seed=3), run(seed=4)
    for name in ("x", "cost", "mean", "covariance", "generations"):
        assert torch.equal(getattr(first, name), getattr(again, name))
    assert not torch.equal(first.x, other.x)


@pytest.mark.parametrize("subset", [[7], [11, 2], [0, 3, 6, 9]])
@pytest.mark.parametrize("d", [2, 6, 9])
def test_a_start_does_not_depend_on_its_company(d, subset):
    starts, sigma = _starts(12, d), torch.rand(12, d, dtype=torch.float64) + 0.2
    box = {"lower": torch.full((d,), -8.0), "upper": torch.full((d,), 9.0)}
    every = cma_es(rosenbrock, starts, sigma, **box, max_generations=400)
    some = cma_es(rosenbrock, starts[subset], sigma[subset], **box, max_generations=400, streams=subset)
    for name in ("x", "cost", "mean", "covariance", "generations", "evaluations"):
        assert torch.equal(getattr(every, name)[subset], getattr(some, name)), name
    assert some.reason == tuple(every.reason[i] for i in subset)


def test_equal_starts_draw_different_numbers():
    optimum = cma_es(sphere, torch.ones(2, 3), torch.ones(3), max_generations=3)
    assert not torch.equal(optimum.x[0], optimum.x[1])


def test_only_the_ranks_of_costs_matter():
    run = partial(cma_es, start=_starts(4, 5), sigma=torch.ones(5), max_generations=60, tol_fun=0.0)
    assert torch.equal(run(sphere).mean, run(lambda x: 8 * sphere(x) ** 3).mean)


def test_units_of_parameters_do_not_matter():
    units = torch.tensor([1.0, 1024.0, 2**-20, 8.0], dtype=torch.float64)  # powers of two: no rounding
    starts, sigma = _starts(4, 4), torch.full((4,), 0.3, dtype=torch.float64)
    plain = cma_es(rosenbrock, starts, sigma, max_generations=100)
    scaled = cma_es(lambda x: rosenbrock(x / units), starts * units, sigma * units, max_generations=100)
    assert torch.equal(plain.x * units, scaled.x)
    assert torch.equal(plain.covariance * units[:, None] * units, scaled.covariance)


def test_rotation_does_not_matter_on_average():
    rotation, starts, sigma = random_rotation(9), torch.ones(30, 9, dtype=torch.float64), torch.full((9,), 0.5)
    straight, turned = HitTime(30, 10, 1e-9), HitTime(30, 10, 1e-9)
    cma_es(ellipsoid, starts, sigma, on_generation=straight)
    cma_es(lambda x: ellipsoid(x @ rotation.T), starts @ rotation, sigma, on_generation=turned)
    assert straight.success == turned.success == 1
    assert 0.9 < turned.median / straight.median < 1.1


def test_learns_the_inverse_hessian():
    optimum = cma_es(ellipsoid, torch.ones(4, 5), torch.ones(5))
    product = optimum.covariance.diagonal(dim1=1, dim2=2) * 1e6 ** (torch.arange(5) / 4)
    assert float((product / product.mean(1, keepdim=True)).log().abs().max()) < 2.5  # against 13.8 at the start


def test_warm_start_needs_fewer_evaluations():
    rotation = random_rotation(9)
    objective = lambda x: ellipsoid(x @ rotation.T)  # noqa: E731
    sigma = torch.full((9,), 0.3)
    first = cma_es(objective, torch.ones(10, 9), sigma)
    assert bool((first.cost < 1e-9).all())
    cold, warm = HitTime(10, 10, 1e-9), HitTime(10, 10, 1e-9)
    second_start = first.mean + 1e-2 * _starts(10, 9)
    cma_es(objective, second_start, sigma, seed=1, on_generation=cold)
    cma_es(objective, second_start, sigma, seed=1, covariance=first.covariance, on_generation=warm)
    assert warm.success == 1
    assert warm.median < 0.6 * cold.median


def test_size_of_a_warm_covariance_does_not_matter():
    shape = torch.tensor([[[1.0, 0.5], [0.5, 2.0]]], dtype=torch.float64)
    run = partial(cma_es, sphere, torch.ones(1, 2), torch.tensor([0.5, 0.25]), max_generations=20)
    assert torch.equal(run(covariance=shape).x, run(covariance=shape / 1024).x)


@pytest.mark.parametrize(
    "centre",
    [(0.3, 0.5, -0.2), (2.0, 0.5, 0.0), (2.0, -3.0, 5.0), (1.0, -1.0, 0.97), (1.0 + 1e-6, 0.0, -0.9999)],
)
def test_optimum_inside_on_and_beyond_bounds(centre):
    lower, upper = torch.full((3,), -1.0, dtype=torch.float64), torch.ones(3, dtype=torch.float64)
    centre = torch.tensor(centre, dtype=torch.float64)
    seen = []

    def objective(x):
        seen.append(x)
        return ((x - centre) ** 2 * torch.tensor([1.0, 10.0, 100.0])).sum(1)

    optimum = cma_es(objective, _starts(6, 3).clamp(-1, 1), torch.full((3,), 0.3), lower=lower, upper=upper)
    seen = torch.cat(seen)
    assert bool(((seen >= lower) & (seen <= upper)).all())
    expected = centre.clamp(-1, 1).expand(6, 3)
    torch.testing.assert_close(optimum.x, expected, atol=1e-6, rtol=0)
    torch.testing.assert_close(optimum.mean, expected, atol=1e-4, rtol=0)


def test_costs_that_are_not_numbers_count_as_the_worst():
    def objective(x):
        cost = sphere(x)
        cost[x[:, 0] < -0.1] = torch.nan
        cost[x[:, 1] < -0.1] = torch.inf
        cost[x[:, 2] < -0.1] = -torch.inf
        return cost

    optimum = cma_es(objective, torch.ones(5, 3), torch.ones(3))
    assert bool((optimum.cost < 1e-9).all())


def test_no_finite_cost_at_all_ends_with_the_start():
    start = torch.tensor([[1.0, 2.0]], dtype=torch.float64)
    optimum = cma_es(lambda x: x[:, 0] * torch.nan, start, torch.ones(2))
    assert optimum.reason == ("EqualFunValues",)
    assert torch.equal(optimum.x, start)
    assert optimum.cost.tolist() == [torch.inf]


def test_objective_may_answer_in_float32_and_with_a_graph():
    weight = torch.ones(2, requires_grad=True)
    optimum = cma_es(lambda x: (x.float() ** 2 * weight).sum(1), torch.ones(2, 2), torch.ones(2))
    assert optimum.cost.dtype == torch.float64
    assert not optimum.cost.requires_grad
    assert bool((optimum.cost < 1e-9).all())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sigma": torch.tensor([1.0, 0.0])}, "sigma"),
        ({"start": torch.tensor([[torch.nan, 0.0]])}, "finite"),
        ({"lower": torch.zeros(2)}, "upper"),
        ({"lower": torch.zeros(2), "upper": torch.tensor([1.0, 0.0])}, "bounds"),
        ({"lower": torch.zeros(2), "upper": torch.full((2,), torch.inf)}, "bounds"),
        ({"lower": torch.full((2,), 2.0), "upper": torch.full((2,), 3.0)}, "outside"),
        ({"covariance": torch.tensor([[[1.0, 2.0], [2.0, 1.0]]])}, "positive definite"),
        ({"population": 3}, "population"),
        ({"max_evaluations": 5}, "budget"),
        ({"max_generations": 0}, "budget"),
        ({"streams": [0, 1]}, "streams"),
        ({"objective": lambda x: x}, "shape"),
    ],
)
def test_bad_arguments_are_named(change, message):
    arguments = {"objective": sphere, "start": torch.ones(1, 2), "sigma": torch.ones(2), **change}
    with pytest.raises(RegtorchError, match=message):
        cma_es(**arguments)


def _tutorial(points: np.ndarray, cost: np.ndarray, s: Strategy, g: int, state: dict[str, np.ndarray]) -> None:
    """One generation of the tutorial's figure 6 for one start, in plain numpy: eqs. 41-47."""
    m, C, n = state["m"], state["C"], s.n
    y = ((points - m) / state["sigma"])[np.argsort(cost)]
    w, mu = s.w.numpy(), s.lam // 2
    y_w = w[:mu] @ y[:mu]
    values, axes = np.linalg.eigh(C)
    whitening = axes @ np.diag(values**-0.5) @ axes.T
    state["m"] = m + state["sigma"] * y_w
    p_sigma = (1 - s.c_sigma) * state["p_sigma"]
    p_sigma = p_sigma + np.sqrt(s.c_sigma * (2 - s.c_sigma) * s.mu_eff) * whitening @ y_w
    length = np.linalg.norm(p_sigma)
    h = float(length / np.sqrt(1 - (1 - s.c_sigma) ** (2 * g)) < (1.4 + 2 / (n + 1)) * s.chi_n)
    p_c = (1 - s.c_c) * state["p_c"] + h * np.sqrt(s.c_c * (2 - s.c_c) * s.mu_eff) * y_w
    white = np.linalg.norm(y @ whitening, axis=1)
    weights = np.where(w >= 0, w, w * n / white**2)
    rank_mu = sum(weight * np.outer(each, each) for weight, each in zip(weights, y, strict=True))
    keep = 1 + s.c_1 * (1 - h) * s.c_c * (2 - s.c_c) - s.c_1 - s.c_mu * w.sum()
    state["C"] = keep * C + s.c_1 * np.outer(p_c, p_c) + s.c_mu * rank_mu
    state["sigma"] = state["sigma"] * np.exp(s.c_sigma / s.d_sigma * (length / s.chi_n - 1))
    state["p_sigma"], state["p_c"], state["h"] = p_sigma, p_c, h


@pytest.mark.parametrize("generations", [1, 2, 30])
@pytest.mark.parametrize("far", [1.0, 50.0], ids=["near", "far: h_sigma is 0 at times"])
def test_generations_are_those_of_the_tutorials_equations(generations, far):
    """From the points that were sampled alone: mean, step size and covariance."""
    n, seen = 4, []

    def objective(x):
        seen.append(x.clone())
        return rosenbrock(x)

    start = far * _starts(1, n, seed=2)
    found = cma_es(objective, start, torch.ones(n), max_generations=generations)
    s, zero = default_strategy(n, None), np.zeros(n)
    assert s.lazy_gap == 1
    state = {"m": start[0].numpy(), "sigma": 1.0, "C": np.eye(n), "p_sigma": zero, "p_c": zero}
    held = []
    for g, points in enumerate(seen, start=1):
        _tutorial(points.numpy(), rosenbrock(points).numpy(), s, g, state)
        held.append(state["h"])
    assert min(held) == (0 if far > 1 and generations > 2 else min(held))
    np.testing.assert_allclose(found.mean[0].numpy(), state["m"], rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(found.covariance[0].numpy(), state["sigma"] ** 2 * state["C"], rtol=1e-6, atol=1e-9)


def test_histories_hold_the_best_and_the_median_cost_of_each_generation():
    begin = prepare(torch.zeros(2, 3), torch.ones(3), None, None, None)
    rows, strategy, seen = first_rows(begin), default_strategy(3, 9), []

    def objective(x):
        seen.append(sphere(x).view(2, 9))
        return seen[-1].flatten()

    for g in (1, 2):
        z = torch.randn(2, 9, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(g))
        _generation(objective, begin, strategy, rows, z, g)
        assert torch.equal(rows.best[:, g - 1], seen[-1].amin(1))
        assert torch.equal(rows.median[:, g - 1], seen[-1].median(1).values)
    assert torch.equal(rows.best_cost, torch.stack(seen).amin((0, 2)))


def test_no_generation_repeats_the_random_numbers_of_another(monkeypatch):
    """Also beyond the block that a start draws at once."""
    drawn = []

    def watched(objective, begin, strategy, rows, z, g):
        drawn.append(z.clone())
        return _generation(objective, begin, strategy, rows, z, g)

    monkeypatch.setattr(evolution_strategy, "_generation", watched)
    cma_es(rosenbrock, torch.full((2, 3), 4.0), torch.ones(3), max_generations=2 * evolution_strategy.BLOCK + 5)
    numbers = torch.stack(drawn).flatten()
    assert len(drawn) == 2 * evolution_strategy.BLOCK + 5
    assert len(numbers.unique()) == len(numbers)


def test_a_budget_of_evaluations_is_never_exceeded():
    optimum = cma_es(sphere, torch.ones(2, 3), torch.ones(3), population=7, max_evaluations=27)
    assert optimum.evaluations.tolist() == [21, 21]
    assert optimum.reason == ("MaxEvaluations",) * 2
