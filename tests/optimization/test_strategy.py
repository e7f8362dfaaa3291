"""The strategy parameters of CMA-ES: numbers of the tutorial's formulas by hand, and what the weights must obey."""

import math

import pytest
import torch

from regtorch.errors import RegtorchError
from regtorch.optimization.strategy import default_strategy

SIZES = [(1, None), (2, None), (9, None), (9, 30), (20, 200)]


def test_constants_of_ten_parameters_are_those_worked_out_by_hand():
    """Table 1 with lambda = 10, mu = 5: mu_eff is (sum w)^2 / sum w^2 of ln 5.5 - ln i."""
    s = default_strategy(10, None)
    assert (s.lam, s.lazy_gap) == (10, 1)
    assert s.mu_eff == pytest.approx(3.1673, abs=1e-4)
    assert s.c_sigma == pytest.approx(5.1673 / 18.1673, abs=1e-5)
    assert s.d_sigma == pytest.approx(1 + 5.1673 / 18.1673, abs=1e-5)
    assert s.c_c == pytest.approx(4.31673 / 14.63346, abs=1e-5)
    assert s.c_1 == pytest.approx(2 / (127.69 + 3.1673), abs=1e-6)
    assert s.c_mu == pytest.approx(2 * (0.25 + 3.1673 + 0.31573 - 2) / (144 + 3.1673), abs=1e-5)
    assert s.w[:5].tolist() == pytest.approx([0.4563, 0.2708, 0.1622, 0.0852, 0.0255], abs=1e-4)


@pytest.mark.parametrize(("n", "population"), SIZES)
def test_weights_fall_and_keep_the_covariance_positive(n, population):
    s = default_strategy(n, population)
    positive, negative = s.w[s.w > 0], -s.w[s.w < 0]
    assert len(s.w) == s.lam
    assert bool((s.w.diff() < 0).all())
    assert float(positive.sum()) == pytest.approx(1)
    assert s.mu_eff == pytest.approx(float(1 / positive.square().sum()))
    # eqs. 50-52: each of the three bounds holds, and one of them is met.
    mu_eff_minus = float(negative.sum() ** 2 / negative.square().sum())
    bounds = [1 + s.c_1 / s.c_mu, 1 + 2 * mu_eff_minus / (s.mu_eff + 2), (1 - s.c_1 - s.c_mu) / (n * s.c_mu)]
    assert float(negative.sum()) == pytest.approx(min(bounds), rel=0.02)


@pytest.mark.parametrize("n", [1, 2, 9, 40])
def test_the_expected_length_is_that_of_a_normal_vector(n):
    exact = math.sqrt(2) * math.exp(math.lgamma((n + 1) / 2) - math.lgamma(n / 2))
    assert default_strategy(n, None).chi_n == pytest.approx(exact, rel=2e-2 / n**2)


def test_large_populations_damp_the_step_and_axes_are_renewed_less_often_in_many_parameters():
    wide = default_strategy(9, 200)
    assert wide.d_sigma == pytest.approx(1 + 2 * (math.sqrt((wide.mu_eff - 1) / 10) - 1) + wide.c_sigma)
    many = default_strategy(1000, None)
    assert many.lazy_gap == math.floor(1 / (10_000 * (many.c_1 + many.c_mu))) > 1


def test_a_population_of_four_is_the_smallest():
    assert default_strategy(3, 4).lam == 4
    with pytest.raises(RegtorchError, match="population of 3"):
        default_strategy(3, 3)
    assert torch.isfinite(default_strategy(1, None).w).all()
