"""Each stopping rule of the tutorial's appendix B.3 by an objective made for it."""

import math
from dataclasses import replace

import pytest
import torch

from regtorch.optimization import cma_es
from regtorch.optimization.rows import Rows, first_rows
from regtorch.optimization.start import prepare
from regtorch.optimization.stopping import STAGNATION_EVERY, Tolerances, converged, degenerate
from regtorch.optimization.strategy import default_strategy

from .problems import ellipsoid, sphere

OFF = {"tol_fun": 0.0, "tol_x": 0.0}


def _noise(x):
    return (x @ torch.tensor([12345.678, 34567.89], dtype=torch.float64)).sin()


@pytest.mark.parametrize(
    ("reason", "objective", "start", "options"),
    [
        ("TolFun", sphere, 1.0, {}),
        ("EqualFunValues", lambda x: torch.ones(len(x)), 1.0, OFF),
        ("TolFunHist", lambda x: sphere(x) + 3, 1.0, OFF | {"tol_fun_hist": 1e-6}),
        ("Stagnation", _noise, 1.0, OFF),
        ("TolX", sphere, 1.0, OFF | {"tol_x": 1e-4}),
        ("TolXUp", lambda x: x.sum(1), 1.0, OFF),
        # A unit in the last place of 2^57 is 32, of 2^50 a quarter.
        ("NoEffectCoord", sphere, 2.0**57, OFF),
        ("NoEffectAxis", lambda x: sphere(x - 2.0**50), 2.0**50, OFF),
        ("ConditionCov", lambda x: ellipsoid(x, 1e20), 1.0, OFF),
        ("MaxGenerations", sphere, 1.0, {"max_generations": 7}),
        ("MaxEvaluations", sphere, 1.0, {"max_evaluations": 50, "population": 7}),
    ],
)
def test_rule(reason, objective, start, options):
    optimum = cma_es(objective, torch.full((3, 2), start, dtype=torch.float64), torch.ones(2), **options)
    either = {"NoEffectAxis", "NoEffectCoord"}  # an axis may be lost by way of a coordinate, as the draws have it
    assert reason in optimum.reason
    assert set(optimum.reason) <= (either if reason == "NoEffectAxis" else {reason})
    if reason == "MaxEvaluations":
        assert optimum.evaluations.tolist() == [49] * 3
    if reason == "EqualFunValues":
        assert optimum.generations.tolist() == [10 + math.ceil(30 * 2 / 6)] * 3


def test_tol_x_is_relative_to_sigma():
    run = [cma_es(sphere, torch.ones(1, 2), torch.ones(2) * s, **OFF | {"tol_x": 1e-3}) for s in (1.0, 1e-2)]
    for optimum, sigma in zip(run, (1.0, 1e-2), strict=True):
        deviations = optimum.covariance.diagonal(dim1=1, dim2=2).sqrt()
        assert 1e-5 < float(deviations.max()) / sigma < 1e-3


def test_default_strategy_is_pycmas():
    cma = pytest.importorskip("cma")
    for n, population in ((2, None), (9, None), (9, 30), (20, None)):
        s = default_strategy(n, population)
        peer = cma.CMAEvolutionStrategy(n * [0.0], 1.0, {"verbose": -9, **({"popsize": s.lam} if population else {})})
        assert peer.popsize == s.lam
        weights = torch.tensor(list(peer.sp.weights), dtype=torch.float64)
        torch.testing.assert_close(s.w[s.w > 0], weights[weights > 0])
        assert s.mu_eff == pytest.approx(peer.sp.weights.mueff)
        assert s.c_1 == pytest.approx(peer.sp.c1)
        assert s.c_c == pytest.approx(peer.sp.cc, rel=0.02)
        assert s.c_mu == pytest.approx(peer.sp.cmu, rel=0.3)
        assert float(s.w.sum()) == pytest.approx(float(weights.sum()), abs=0.3)


TIGHT = Tolerances(fun=0.5, fun_hist=0.25, x=1e-3)
WINDOW = 10 + 30 * 2 // 6


def _state(n: int = 2, **changes: list[float]) -> Rows:
    """One row of n parameters, C = 1, sigma = 1, at the origin."""
    rows = first_rows(prepare(torch.zeros(1, n), torch.ones(n), None, None, None))
    return replace(rows, **{name: torch.tensor([value], dtype=torch.float64) for name, value in changes.items()})


def _degenerate(name: str, g: int = 1, n: int = 2, **changes: list[float]) -> bool:
    return bool(degenerate(g, _state(n, **changes), TIGHT)[name])


def test_deviations_and_the_path_must_both_be_short_for_tol_x():
    path = {"p_c": [0.0, 0.0]}
    assert _degenerate("TolX", sigma=0.999e-3, **path)
    assert not _degenerate("TolX", sigma=1.001e-3, **path)
    assert _degenerate("TolX", sigma=1e-4, p_c=[0.0, -9.9])
    assert not _degenerate("TolX", sigma=1e-4, p_c=[0.0, -10.1])
    assert not _degenerate("TolX", sigma=1e-4, C=[[1.0, 0.0], [0.0, 101.0]])


def test_a_longest_axis_ten_thousand_times_the_first_is_too_long():
    assert not _degenerate("TolXUp", sigma=0.999e4)
    assert _degenerate("TolXUp", sigma=1.001e4)
    assert _degenerate("TolXUp", sigma=1.001e3, D=[1.0, 10.0])
    assert not _degenerate("TolXUp", sigma=1.001e4, first_length=2.0)


def test_a_condition_beyond_1e14_is_too_large():
    assert not _degenerate("ConditionCov", D=[1.0, 0.999e7])
    assert _degenerate("ConditionCov", D=[1.0, 1.001e7])
    assert _degenerate("ConditionCov", n=3, D=[1.0, 1.0, 1.001e7])


def test_a_fifth_of_a_deviation_must_change_a_coordinate():
    """Numbers from 2^53 on are two apart, and the half way rounds to even."""
    assert _degenerate("NoEffectCoord", m=[2.0**53, 0.0], sigma=4.9)
    assert not _degenerate("NoEffectCoord", m=[2.0**53, 0.0], sigma=5.1)


def test_a_tenth_of_each_axis_in_turn_must_change_the_mean():
    lost = {"m": [2.0**53, 2.0**53], "B": [[1.0, 0.0], [0.0, 1.0]], "D": [9.9, 10.1]}
    assert [_degenerate("NoEffectAxis", g, **lost) for g in (1, 2, 3, 4)] == [True, False, True, False]


def _converged(g: int, best: list[float], last: list[float], median: list[float] | None = None) -> dict[str, bool]:
    rows = _state(best=best, median=best if median is None else median)
    return {name: bool(hit) for name, hit in converged(g, torch.tensor([last]).double(), rows, TIGHT).items()}


def test_costs_of_a_window_and_of_the_generation_must_be_alike_for_tol_fun():
    flat = [1.0] * WINDOW
    assert _converged(WINDOW - 1, flat[1:], [1.0] * 6) == {}
    assert _converged(WINDOW, flat, [1.0] * 6) == {"TolFun": True, "EqualFunValues": True, "TolFunHist": True}
    assert _converged(WINDOW, flat, [1.0] * 5 + [1.5])["TolFun"] is False
    assert _converged(WINDOW, flat, [1.0] * 5 + [1.499])["TolFun"] is True
    step = _converged(WINDOW, [1.25, *flat[1:]], [1.0] * 6)
    assert step == {"TolFun": True, "EqualFunValues": False, "TolFunHist": False}
    assert _converged(WINDOW, [1.249, *flat[1:]], [1.0] * 6)["TolFunHist"] is True
    assert _converged(WINDOW + 1, [9.0, *flat], [1.0] * 6)["EqualFunValues"] is True


def test_stagnation_compares_the_medians_of_the_first_and_the_last_thirds():
    """30 % of a window of 130 are 39: with a majority of either that has not fallen, a start is stagnant."""
    g, window, third, flat = 140, 130, 39, [1.0] * 6
    assert window % STAGNATION_EVERY == g % STAGNATION_EVERY == 0

    def stagnant(first: int, last: int, median: list[float] | None = None, g: int = g) -> bool | None:
        """``first`` of the first third are high, ``last`` of the last third are low."""
        best = [5.0] * (g - window) + [2.0] * first + [1.0] * (window - first - last) + [0.0] * last
        return _converged(g, best, flat, median).get("Stagnation")

    assert stagnant(0, 0) is True
    assert stagnant(19, 19) is True
    assert stagnant(20, 0) is False
    assert stagnant(0, 20) is False
    assert stagnant(third, 0, g=window) is False
    assert stagnant(0, 0, g=141) is None
    assert stagnant(0, 0, median=[1.0] * (g - 20) + [0.0] * 20) is False
    assert stagnant(0, 0, median=[1.0] * (g - 19) + [0.0] * 19) is True
