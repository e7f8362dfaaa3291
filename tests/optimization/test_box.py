"""Bounds by a change of coordinates: what the formula must obey at, within and beyond the margins."""

import torch

from regtorch.optimization.box import MARGIN, Box

LOWER, UPPER = torch.tensor([-2.0, 10.0], dtype=torch.float64), torch.tensor([3.0, 10.5], dtype=torch.float64)
BOX, WIDTH = Box(LOWER, UPPER), UPPER - LOWER
EDGE = MARGIN * WIDTH
SHARES = torch.linspace(0, 1, 401, dtype=torch.float64)[:, None]


def test_unfolding_is_the_inverse_in_all_of_the_box():
    inside = LOWER + SHARES * WIDTH
    unfolded = BOX.unfold(inside)
    torch.testing.assert_close(BOX.fold(unfolded), inside, atol=1e-12, rtol=0)
    assert bool((unfolded >= LOWER - EDGE - 1e-12).all() & (unfolded <= UPPER + EDGE + 1e-12).all())
    assert bool((unfolded.diff(dim=0) > 0).all())


def test_away_from_bounds_nothing_changes():
    inside = LOWER + EDGE + SHARES * (WIDTH - 2 * EDGE)
    torch.testing.assert_close(BOX.unfold(inside), inside, atol=0, rtol=0)
    torch.testing.assert_close(BOX.fold(inside), inside, atol=1e-14, rtol=0)


def test_bounds_are_met_a_margin_beyond_them_and_a_quarter_of_it_is_left_at_them():
    """The parabola has value and slope of the identity at the margin's inner end, and no slope at its outer end."""
    torch.testing.assert_close(BOX.fold(LOWER - EDGE), LOWER)
    torch.testing.assert_close(BOX.fold(UPPER + EDGE), UPPER)
    torch.testing.assert_close(BOX.fold(LOWER), LOWER + EDGE / 4)
    torch.testing.assert_close(BOX.fold(UPPER), UPPER - EDGE / 4)


def test_the_slope_has_no_jump_and_is_that_of_the_parabola():
    y = (LOWER - EDGE + SHARES * (WIDTH + 2 * EDGE)).requires_grad_()
    (slope,) = torch.autograd.grad(BOX.fold(y).sum(), y)
    from_bound = torch.minimum(y.detach() - (LOWER - EDGE), UPPER + EDGE - y.detach())
    torch.testing.assert_close(slope, (from_bound / (2 * EDGE)).clamp(0, 1), atol=1e-9, rtol=0)


def test_beyond_the_bounds_it_mirrors_and_repeats():
    along = LOWER - EDGE + SHARES * (WIDTH + 2 * EDGE)
    for end in (LOWER - EDGE, UPPER + EDGE):
        torch.testing.assert_close(BOX.fold(2 * end - along), BOX.fold(along), atol=1e-9, rtol=0)
    torch.testing.assert_close(BOX.fold(along + 2 * (WIDTH + 2 * EDGE)), BOX.fold(along), atol=1e-9, rtol=0)
