"""CMA-ES behind Levenberg-Marquardt's interface."""

import torch

from regtorch.optimization.evolution_climbing import evolve

TOP = torch.tensor([1.0, -2.0, 0.5], dtype=torch.float64)


def _equations(x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    off = x - TOP
    return 1 - off.square().sum(1), torch.eye(3, dtype=x.dtype).expand(len(x), 3, 3), off


def test_climbs_from_every_start_within_bounds():
    start = torch.tensor([[0.0, 0, 0], [3, 3, 3]], dtype=torch.float64)
    limit = torch.tensor([5.0, 1.5, 5], dtype=torch.float64)
    scale = torch.full((3,), 0.2, dtype=torch.float64)
    found = evolve(_equations, start, lower=-limit, upper=limit, scale=scale, steps=40)
    best = torch.tensor([1.0, -1.5, 0.5], dtype=torch.float64)
    torch.testing.assert_close(found.x, best.expand(2, 3), atol=0.02, rtol=0)
    torch.testing.assert_close(found.similarity, _equations(found.x)[0])
    assert found.evaluations > 100


def test_evaluations_are_the_poses_that_were_evaluated():
    calls = []

    def counted(x):
        calls.append(len(x))
        return _equations(x)

    start, limit, scale = torch.zeros(2, 3).double(), torch.full((3,), 5.0).double(), torch.full((3,), 0.2).double()
    found = evolve(counted, start, lower=-limit, upper=limit, scale=scale, steps=3)
    assert found.evaluations == sum(calls)


def test_units_of_parameters_do_not_matter_and_the_first_step_is_in_units_of_the_scale():
    units = torch.tensor([4.0, 0.125, 1.0], dtype=torch.float64)  # powers of two: no rounding
    seen = []

    def scaled(x):
        seen.append(x / units)
        return _equations(x / units)

    start, limit, scale = torch.zeros(1, 3).double(), torch.full((3,), 500.0).double(), torch.full((3,), 0.2).double()
    plain = evolve(_equations, start, lower=-limit, upper=limit, scale=scale, steps=3)
    other = evolve(scaled, start, lower=-limit * units, upper=limit * units, scale=scale * units, steps=3)
    torch.testing.assert_close(other.x / units, plain.x)
    first = float(seen[0].std())
    seen.clear()
    evolve(scaled, start, lower=-limit * units, upper=limit * units, scale=scale * units, steps=3, damping=16e-2)
    assert float(seen[0].std()) == 2 * first  # the fourth root of 16
