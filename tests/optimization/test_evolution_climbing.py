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
