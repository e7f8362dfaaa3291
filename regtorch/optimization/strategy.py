"""The strategy parameters of CMA-ES: Hansen, The CMA Evolution Strategy: A Tutorial, arXiv 1604.00772, table 1."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.errors import RegtorchError


@dataclass(frozen=True)
class Strategy:
    """Constants of one search in ``n`` parameters, named as in the tutorial; ``lam`` is lambda, the population."""

    n: int
    lam: int
    w: Float[Tensor, " lam"]
    mu_eff: float
    c_sigma: float
    d_sigma: float
    c_c: float
    c_1: float
    c_mu: float
    chi_n: float
    lazy_gap: int


def default_strategy(n: int, population: int | None) -> Strategy:
    """The tutorial's defaults for ``n`` parameters; ``population`` None: 4 + floor(3 ln n)."""
    lam = 4 + math.floor(3 * math.log(n)) if population is None else population  # eq. 48
    if lam < 4:
        raise RegtorchError(f"population of {lam}: expected at least 4")
    mu = lam // 2
    w = math.log((lam + 1) / 2) - torch.arange(1, lam + 1, dtype=torch.float64).log()  # eq. 49
    mu_eff = float(w[:mu].sum() ** 2 / w[:mu].square().sum())
    mu_eff_minus = float(w[mu:].sum() ** 2 / w[mu:].square().sum())

    c_sigma = (mu_eff + 2) / (n + mu_eff + 5)  # eq. 55
    d_sigma = 1 + 2 * max(0.0, math.sqrt((mu_eff - 1) / (n + 1)) - 1) + c_sigma
    c_c = (4 + mu_eff / n) / (n + 4 + 2 * mu_eff / n)  # eq. 56
    c_1 = 2 / ((n + 1.3) ** 2 + mu_eff)  # eq. 57 with alpha_cov = 2
    c_mu = min(1 - c_1, 2 * (0.25 + mu_eff + 1 / mu_eff - 2) / ((n + 2) ** 2 + mu_eff))  # eq. 58

    alpha = min(
        1 + c_1 / c_mu,  # eq. 50
        1 + 2 * mu_eff_minus / (mu_eff + 2),  # eq. 51
        (1 - c_1 - c_mu) / (n * c_mu),  # eq. 52
    )
    w = torch.where(w >= 0, w / w[w > 0].sum(), alpha * w / -w[w < 0].sum())  # eq. 53
    chi_n = math.sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n**2))
    lazy_gap = max(1, math.floor(1 / (10 * n * (c_1 + c_mu))))  # appendix B.2
    return Strategy(n, lam, w, mu_eff, c_sigma, d_sigma, c_c, c_1, c_mu, chi_n, lazy_gap)
