"""Each stopping rule of the tutorial's appendix B.3 by an objective made for it."""

import math

import pytest
import torch

from regtorch.optimization import cma_es
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
