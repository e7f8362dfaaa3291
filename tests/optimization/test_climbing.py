"""Climbing normalised correlations whose optimum is known."""

from functools import partial

import pytest
import torch

from regtorch.optimization.climbing import levenberg_marquardt

SCALE = torch.tensor([1.0, 0.05], dtype=torch.float64)
TRUE = torch.tensor([3.0, 0.4], dtype=torch.float64)
LOWER, UPPER = torch.tensor([-10.0, -1.0]).double(), torch.tensor([10.0, 1.0]).double()


def _signal(x: torch.Tensor) -> torch.Tensor:
    t = torch.linspace(-6, 10, 200, dtype=torch.float64)
    return torch.exp(-0.5 * ((t - x[0]) / (1.5 + x[1])) ** 2)


def _equations(clutter: float):
    """Correlation of the signal with the signal at TRUE plus a disturbance that no parameter explains."""
    noise = torch.randn(200, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    fixed = _signal(TRUE) + clutter * noise
    fixed = fixed / fixed.norm()

    def unit(x):
        signal = _signal(x)
        return signal / signal.norm()

    def equations(points):
        found = []
        for x in points:
            jacobian = torch.autograd.functional.jacobian(unit, x)
            residual = unit(x) - fixed
            found.append((unit(x) @ fixed, jacobian.mT @ jacobian, jacobian.mT @ residual))
        return tuple(torch.stack(part) for part in zip(*found, strict=True))

    return equations


def _climb(start, clutter=0.0, **changes):
    settings = {"lower": LOWER, "upper": UPPER, "scale": SCALE, "steps": 30, "tolerance": 1e-9} | changes
    return levenberg_marquardt(_equations(clutter), start, **settings)


def test_every_start_near_enough_finds_the_optimum():
    start = TRUE + torch.tensor([[1.5, 0.3], [-2.0, -0.2], [0.0, 0.0]], dtype=torch.float64)
    found = _climb(start)
    torch.testing.assert_close(found.x, TRUE.expand(3, 2), atol=1e-7, rtol=0)
    torch.testing.assert_close(found.similarity, torch.ones(3, dtype=torch.float64))


def test_no_step_is_tried_that_can_gain_nothing():
    assert _climb(TRUE[None]).evaluations == 1
    near = (TRUE + torch.tensor([0.3, 0.05], dtype=torch.float64))[None]
    assert _climb(near).evaluations > 2
    clutter = _climb(near, clutter=0.3)
    again = _climb(clutter.x, clutter=0.3)
    assert again.evaluations == 1
    assert _climb(clutter.x, clutter=0.3, least_gain=0.0).evaluations > 1


def test_limits_hold_and_the_rest_is_still_sought():
    upper = torch.tensor([2.0, 1.0], dtype=torch.float64)
    found = _climb(torch.tensor([[1.0, 0.2]], dtype=torch.float64), upper=upper)
    assert float(found.x[0, 0]) == 2.0
    best = max(float(_equations(0.0)(torch.tensor([[2.0, w]]).double())[0]) for w in torch.linspace(0, 1, 201))
    assert float(found.similarity) > best - 1e-6


def test_a_step_that_a_limit_cuts_off_is_no_sign_of_an_end():
    """The first step aims far beyond the limit and gains almost nothing up to it."""
    upper = torch.tensor([1.0 + 1e-9, 1.0], dtype=torch.float64)

    def equations(points):
        far, near = points[:, 0] - 3, points[:, 1] - 0.4
        similarity = 0.9 - far.square() / 1000 - near.square()
        coupled = torch.tensor([[1e-3, -0.0], [-0.0, 1.0]], dtype=torch.float64).expand(len(points), 2, 2)
        slow = torch.where(points[:, 0] < upper[0], 1e-6, 1.0).double()  # held back until the limit is met
        return similarity, coupled, torch.stack([far / 1000, near * slow], dim=1)

    start = torch.tensor([[1.0, 0.2]], dtype=torch.float64)
    found = levenberg_marquardt(
        equations, start, lower=LOWER, upper=upper, scale=torch.ones(2).double(), steps=40, tolerance=1e-12
    )
    assert abs(float(found.x[0, 1]) - 0.4) < 0.01


def test_similarity_never_falls_and_evaluations_are_counted():
    start = torch.tensor([[-9.0, -0.9], [9.5, 0.9], [3.5, 0.3]], dtype=torch.float64)
    before = _equations(0.3)(start)[0]
    calls = []

    def counted(points):
        calls.append(len(points))
        return _equations(0.3)(points)

    found = levenberg_marquardt(counted, start, lower=LOWER, upper=UPPER, scale=SCALE, steps=12)
    assert bool((found.similarity >= before).all())
    assert found.evaluations == sum(calls)


def test_starts_do_not_change_one_another():
    start = TRUE + torch.tensor([[1.5, 0.3], [-2.0, -0.2]], dtype=torch.float64)
    both, alone = _climb(start, clutter=0.2), _climb(start[1:], clutter=0.2)
    torch.testing.assert_close(both.x[1:], alone.x)


HESSIAN = torch.tensor([[1.0, 0.6], [0.6, 2.0]], dtype=torch.float64)
PEAK = torch.tensor([0.3, -0.2], dtype=torch.float64)


def _parabola(points, top=0.6, overshoot=1.0):
    """rho = top - x H x / 2 about PEAK, with the J^T J for which rho J^T J is H; an undamped step goes to the peak.

    With ``overshoot`` J^T J is too small, and the step that many times too long.
    """
    off = points - PEAK
    similarity = top - ((off @ HESSIAN) * off).sum(1) / 2
    return similarity, HESSIAN / overshoot / similarity[:, None, None], off @ HESSIAN


def _undamped_step(start, equations=_parabola, **changes):
    settings = {"lower": LOWER, "upper": UPPER, "scale": SCALE, "steps": 1, "damping": 0.0} | changes
    return levenberg_marquardt(equations, torch.tensor([start], dtype=torch.float64), **settings)


def test_the_curvature_is_rho_times_j_t_j():
    """Then one step reaches the peak of a parabola; with J^T J alone it goes only as far as the share rho."""
    found = _undamped_step([0.7, 0.1])
    torch.testing.assert_close(found.x[0], PEAK)
    torch.testing.assert_close(found.similarity, torch.full((1,), 0.6, dtype=torch.float64))
    assert found.evaluations == 2


def test_a_small_rho_counts_as_the_least_similarity():
    start, least = torch.tensor([0.4, -0.15], dtype=torch.float64), 0.1
    equations = partial(_parabola, top=0.06)
    rho = float(equations(start[None])[0])
    assert 0 < rho < least
    found = _undamped_step(start.tolist(), equations, least_similarity=least)
    torch.testing.assert_close(found.x[0], start + (PEAK - start) * rho / least)


def _bound(limit, side):
    """Upper or lower limits of which the first is ``limit``."""
    return {"upper" if side > 0 else "lower": torch.tensor([limit, side], dtype=torch.float64)}


@pytest.mark.parametrize("side", [1, -1], ids=["upper", "lower"])
def test_a_parameter_at_a_limit_rests_while_its_slope_points_outwards(side):
    """The other one goes to the best point of the limit, not to where both would go together."""
    limit = float(PEAK[0]) - side * 0.4
    bound = _bound(limit, side)
    best = float(PEAK[1]) - float(HESSIAN[0, 1] / HESSIAN[1, 1]) * (limit - float(PEAK[0]))
    found = _undamped_step([limit, 0.3], **bound)
    torch.testing.assert_close(found.x[0], torch.tensor([limit, best], dtype=torch.float64))


@pytest.mark.parametrize("side", [1, -1], ids=["upper", "lower"])
def test_a_parameter_at_a_limit_leaves_it_where_its_slope_points_inwards(side):
    limit = float(PEAK[0]) + side * 0.4
    bound = _bound(limit, side)
    torch.testing.assert_close(_undamped_step([limit, -0.2], **bound).x[0], PEAK)


@pytest.mark.parametrize(("overshoot", "taken"), [(1.99, True), (2.01, False), (4.0, False)])
def test_a_step_is_taken_where_it_gains_and_refused_where_it_loses(overshoot, taken):
    """A step twice too long ends as high on a parabola's other side as it began."""
    start = torch.tensor([0.7, 0.1], dtype=torch.float64)
    equations = partial(_parabola, overshoot=overshoot)
    rho = equations(start[None])[0]
    found = _undamped_step(start.tolist(), equations)
    torch.testing.assert_close(found.x[0], start + overshoot * (PEAK - start) if taken else start)
    torch.testing.assert_close(found.similarity, equations(found.x)[0])
    torch.testing.assert_close(found.jtj, equations(found.x)[1])
    assert bool((found.similarity > rho).all()) is taken


def test_after_refused_steps_shorter_ones_find_the_peak():
    found = _undamped_step([0.7, 0.1], partial(_parabola, overshoot=4.0), steps=60, damping=1e-2, least_gain=1e-9)
    torch.testing.assert_close(found.x[0], PEAK, atol=1e-3, rtol=0)
