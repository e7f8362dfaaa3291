"""The cma package as an optimiser and as the oracle of ours."""

import numpy as np
import pytest
import torch

from regtorch.optimization import cma_es, pycma

from .problems import HitTime, ellipsoid, rosenbrock, sphere


@pytest.mark.parametrize(("objective", "start"), [(sphere, 1.0), (ellipsoid, 1.0), (rosenbrock, 0.0)])
def test_converges_as_pycma_does(objective, start):
    seeds, population = 15, 10
    evaluations = {}
    for optimizer in (cma_es, pycma):
        hits = HitTime(seeds, population, 1e-9)
        optimum = optimizer(
            objective,
            torch.full((seeds, 9), start),
            torch.full((9,), 0.5),
            population=population,
            max_evaluations=10_000,
            on_generation=hits,
        )
        assert optimum.evaluations.max() <= 10_000
        # Rosenbrock has a second minimum near (-1, 1, ..., 1).
        assert hits.success >= (0.8 if objective is rosenbrock else 1)
        evaluations[optimizer.__name__] = hits.median
    assert 0.75 < evaluations["cma_es"] / evaluations["pycma"] < 1.33, evaluations


def test_bounds_covariance_and_costs_that_are_not_numbers():
    lower, upper = torch.full((2,), -1.0), torch.full((2,), 1.0)

    def objective(x):
        assert bool(((x >= -1) & (x <= 1)).all())
        cost = ((x - torch.tensor([2.0, 0.5])) ** 2).sum(1)
        cost[x[:, 1] < 0] = torch.nan
        return cost

    covariance = torch.tensor([[[4.0, 1.0], [1.0, 1.0]]]).expand(3, 2, 2)
    starts = torch.tensor([[0.0, 0.1], [-0.9, 0.9], [0.9, 0.2]])
    optimum = pycma(objective, starts, torch.ones(2) * 0.3, lower=lower, upper=upper, covariance=covariance)
    expected = torch.tensor([1.0, 0.5], dtype=torch.float64).expand(3, 2)
    torch.testing.assert_close(optimum.x, expected, atol=1e-5, rtol=0)
    torch.testing.assert_close(optimum.mean, expected, atol=1e-4, rtol=0)


def test_leaves_numpys_generator_alone_and_repeats_itself():
    np.random.seed(5)  # noqa: NPY002
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    first = pycma(sphere, torch.ones(3, 2), torch.ones(2), max_generations=20)
    assert np.array_equal(before, np.random.get_state()[1])  # noqa: NPY002
    assert set(first.reason) == {"maxiter"}
    again = pycma(sphere, torch.ones(3, 2), torch.ones(2), max_generations=20)
    assert torch.equal(first.x, again.x)
    alone = pycma(sphere, torch.ones(1, 2), torch.ones(2), max_generations=20, streams=[2])
    assert torch.equal(first.x[2:], alone.x)


def test_covariance_is_in_the_units_of_the_parameters():
    units = torch.tensor([1.0, 1000.0])
    shape = torch.tensor([[[1.0, 900.0], [900.0, 1e6]]])
    for optimizer in (cma_es, pycma):
        optimum = optimizer(lambda x: sphere(x / units), torch.ones(1, 2), units, covariance=shape, max_generations=1)
        deviation = optimum.covariance[0].diagonal().sqrt()
        assert 0.5 < float(deviation[1] / deviation[0] / 1000) < 2
        assert 0.6 < float(optimum.covariance[0, 0, 1] / deviation.prod()) <= 1
