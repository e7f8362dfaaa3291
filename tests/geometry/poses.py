"""Random poses within and beyond the simulation's ranges."""

import torch

MIDDLE = torch.tensor([0, 0, 1000, 0, 0, 300, 0, 0, 0], dtype=torch.float64)
SPREAD = torch.tensor([60, 60, 300, 60, 60, 120, 0.6, 0.6, 0.6], dtype=torch.float64)
ORIGIN_MM = torch.tensor([12.5, -140.0, 830.0], dtype=torch.float64)


def random_poses(*batch: int, seed: int = 0, dtype: torch.dtype = torch.float64) -> torch.Tensor:
    uniform = 2 * torch.rand(*batch, 9, generator=torch.Generator().manual_seed(seed), dtype=torch.float64) - 1
    return (MIDDLE + uniform * SPREAD).to(dtype)


def random_points(n: int, seed: int = 0, reach_mm: float = 150.0) -> torch.Tensor:
    """LPS mm, around ``ORIGIN_MM``."""
    points = 2 * torch.rand(n, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64) - 1
    return ORIGIN_MM + reach_mm * points
