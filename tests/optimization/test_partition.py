"""The kD-tree of starts."""

from functools import partial

import pytest
import torch

from regtorch.errors import RegtorchError
from regtorch.optimization import cma_es, kd_partition, multi_start, pycma


@pytest.mark.parametrize(("n", "d"), [(1, 2), (2, 1), (3, 2), (7, 3), (64, 6), (100, 9)])
def test_cells_tile_the_box_evenly(n, d):
    lower = torch.linspace(-2, 1, d, dtype=torch.float64)
    upper = lower + torch.linspace(1, 4, d, dtype=torch.float64)
    low, high = kd_partition(lower, upper, n, scale=torch.ones(d, dtype=torch.float64))
    assert low.shape == high.shape == (n, d)
    assert bool(((low >= lower) & (high <= upper)).all())
    volumes = (high - low).prod(1)
    torch.testing.assert_close(volumes, (upper - lower).prod().expand(n) / n)
    overlap = (torch.minimum(high[:, None], high) - torch.maximum(low[:, None], low)).clamp_min(0).prod(2)
    torch.testing.assert_close(overlap, torch.diag(volumes))
    # Equal volumes that add up to the box's and do not overlap: every point is in some cell.
    points = lower + (upper - lower) * torch.rand(200, d, dtype=torch.float64)
    assert bool(((points[:, None] >= low) & (points[:, None] <= high)).all(2).any(1).all())


def test_splits_the_axis_that_is_longest_by_its_scale():
    lower, upper = torch.zeros(2), torch.tensor([100.0, 0.3])
    low, high = kd_partition(lower, upper, 2, scale=torch.tensor([100.0, 0.1]))
    torch.testing.assert_close(high - low, torch.tensor([[100.0, 0.15]] * 2))
    low, high = kd_partition(lower, upper, 5, scale=torch.tensor([1.0, 1.0]))
    torch.testing.assert_close(high[:, 0] - low[:, 0], torch.full((5,), 20.0))


def test_bad_boxes_are_refused():
    one = torch.ones(2)
    for arguments in ((one, one, 3), (one, 2 * one, 0)):
        with pytest.raises(RegtorchError):
            kd_partition(*arguments, scale=one)
    with pytest.raises(RegtorchError):
        kd_partition(one, 2 * one, 2, scale=one * 0)


def _rastrigin(x):
    return (x**2 - 2 * (2 * torch.pi * x).cos() + 2).sum(1)


@pytest.mark.parametrize(
    "search", [partial(cma_es, _rastrigin, seed=1), partial(pycma, _rastrigin, seed=1, max_generations=150)]
)
def test_finds_the_lowest_of_many_minima(search):
    lower, upper = torch.tensor([-5.0, -4.0, -3.0]), torch.tensor([4.0, 5.0, 6.0])
    optimum = multi_start(search, lower, upper, starts=40, scale=torch.ones(3))
    assert optimum.x.shape == (40, 3)
    assert float(optimum.cost[optimum.best]) < 1e-6
    assert float(optimum.cost.median()) > 0.1, "one start is not enough: that is what the others are for"
    assert bool(((optimum.x >= lower) & (optimum.x <= upper)).all())


def test_starts_are_the_centres_and_sigma_a_fraction_of_the_cells():
    seen = {}

    def search(start, sigma, *, lower, upper):
        seen.update(start=start, sigma=sigma, lower=lower, upper=upper)
        return cma_es(_rastrigin, start, sigma, lower=lower, upper=upper, max_generations=1)

    lower, upper = torch.zeros(1), torch.full((1,), 8.0)
    multi_start(search, lower, upper, starts=4, scale=torch.ones(1), sigma_fraction=0.25)
    assert seen["start"][:, 0].tolist() == [1, 3, 5, 7]
    assert seen["sigma"][:, 0].tolist() == [0.5] * 4
    assert (float(seen["lower"]), float(seen["upper"])) == (0, 8)
