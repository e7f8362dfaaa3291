"""Intervals and tests of the studies agree with known values and with scipy."""

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binom, wilcoxon

from experiments.common.statistics import holm, median_interval, paired, share_interval


def test_the_interval_of_a_median_is_that_of_order_statistics():
    values = np.sort(np.random.default_rng(3).lognormal(size=301))
    low, high = median_interval(pd.Series(values))
    # A median drawn anew is below the k-th value as often as more than half of 301 draws are among the first k.
    places = [int(np.searchsorted(values, value)) for value in (low, high)]
    below = [float(binom.sf(150, 301, (place + 1) / 301)) for place in places]
    assert below == pytest.approx([0.025, 0.975], abs=0.012)
    assert low < np.median(values) < high
    assert median_interval(pd.Series(values)) == (low, high)


def test_the_interval_of_a_median_without_spread_or_values_and_with_infinite_ones():
    assert median_interval(pd.Series([2.0] * 5)) == (2, 2)
    assert np.isnan(median_interval(pd.Series([], dtype=float))).all()
    assert median_interval(pd.Series([1.0, 2.0, np.inf, np.inf, np.inf]))[1] == np.inf


@pytest.mark.parametrize(
    ("count", "n", "low", "high"), [(10, 20, 0.2993, 0.7007), (0, 10, 0, 0.2775), (10, 10, 0.7225, 1)]
)
def test_the_interval_of_a_share_is_wilsons(count, n, low, high):
    assert share_interval(count, n) == pytest.approx((low, high), abs=1e-4)


def test_holm_corrects_the_smallest_most_and_keeps_the_order():
    assert holm(np.array([0.01, 0.04, 0.03])) == pytest.approx([0.03, 0.06, 0.06])
    assert holm(np.array([0.9, 0.8])) == pytest.approx([1, 1])
    assert holm(np.array([])).size == 0


def test_arms_are_compared_over_the_cases_that_both_have():
    reference = np.random.default_rng(0).lognormal(size=40)
    arms = {"b": reference, "a": 2 * reference, "c": reference[:9] * np.linspace(0.9, 1.2, 9)}
    parts = [pd.DataFrame({"arm": arm, "view": "PA", "seed": range(len(v)), "pde_mm": v}) for arm, v in arms.items()]
    shuffled = pd.concat(parts).sample(frac=1, random_state=0)
    found = paired(shuffled, "b", ["view", "seed"], "pde_mm")
    assert list(found.index) == ["a", "c"]
    assert list(found.pairs) == [40, 9]
    assert found.ratio.tolist() == pytest.approx([2, 1.05])
    assert found.loc["c", "p"] == pytest.approx(wilcoxon(np.log(np.linspace(0.9, 1.2, 9))).pvalue)
    assert found.loc["a", "p"] < 1e-6
    assert found.p_holm.tolist() == pytest.approx([2 * found.loc["a", "p"], found.loc["c", "p"]])


def test_arms_that_are_alike_do_not_differ():
    rows = pd.DataFrame({"arm": list("aabb"), "seed": [0, 1, 0, 1], "pde_mm": [1.0, 2, 1, 2]})
    assert paired(rows, "a", ["seed"], "pde_mm").loc["b"].tolist() == [2, 1, 1, 1]


def test_an_arm_that_shares_no_case_is_not_tested_and_does_not_count():
    ratios = 1 + np.linspace(0.1, 0.5, 9)
    arms = {"a": (0, np.ones(9)), "b": (0, ratios), "c": (100, ratios)}
    parts = [pd.DataFrame({"arm": a, "seed": range(n, n + 9), "pde_mm": v}) for a, (n, v) in arms.items()]
    found = paired(pd.concat(parts), "a", ["seed"], "pde_mm")
    assert found.pairs.tolist() == [9, 0]
    assert found.p_holm["b"] == found.p["b"] < 0.01
    assert found.loc["c", ["ratio", "p", "p_holm"]].isna().all()
    assert paired(pd.concat(parts[::2]), "a", ["seed"], "pde_mm").p_holm.isna().all()
