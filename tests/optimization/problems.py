"""Test functions of any number of parameters; minimum 0."""

import torch
from torch import Tensor


def sphere(x: Tensor) -> Tensor:
    return x.square().sum(1)


def ellipsoid(x: Tensor, condition: float = 1e6) -> Tensor:
    d = x.shape[1]
    return (condition ** (torch.arange(d).double() / (d - 1)) * x.square()).sum(1)


def rosenbrock(x: Tensor) -> Tensor:
    return (100 * (x[:, 1:] - x[:, :-1] ** 2) ** 2 + (1 - x[:, :-1]) ** 2).sum(1)


def random_rotation(d: int, seed: int = 0) -> Tensor:
    return torch.linalg.qr(torch.randn(d, d, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)))[0]


class HitTime:
    """An ``on_generation`` that remembers when each start first went below ``goal``, in evaluations per start."""

    def __init__(self, n: int, population: int, goal: float) -> None:
        self.evaluations = torch.full((n,), torch.inf)
        self.population, self.goal = population, goal

    def __call__(self, generation: int, running: int, cost: Tensor) -> None:
        new = (cost < self.goal) & self.evaluations.isinf()
        self.evaluations[new] = generation * self.population

    @property
    def median(self) -> float:
        return float(self.evaluations.median())

    @property
    def success(self) -> float:
        return float(self.evaluations.isfinite().double().mean())
