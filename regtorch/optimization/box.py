"""Bounds by a smooth change of coordinates, so that the optimiser itself never meets one."""

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.errors import RegtorchError

MARGIN = 0.05  # of the box's width


class Box:
    """pycma's BoxConstraintsLinQuadTransformation with a margin that does not depend on where the origin lies.

    ``fold`` is the identity but within the margin of a bound, where it is quadratic, flat at the bound itself
    (``margin`` beyond it in the unfolded coordinate); from there on it mirrors, so it is periodic and continuously
    differentiable. An optimum on a bound becomes an ordinary interior one.
    """

    def __init__(self, lower: Float[Tensor, " d"], upper: Float[Tensor, " d"]) -> None:
        lower, upper = lower.detach().cpu().double(), upper.detach().cpu().double()
        if not bool((lower < upper).all() & (upper - lower).isfinite().all()):
            raise RegtorchError(
                f"bounds {lower.tolist()} to {upper.tolist()}: expected finite ones with lower below upper"
            )
        self.lower, self.upper = lower, upper
        self.margin = MARGIN * (upper - lower)

    def fold(self, y: Float[Tensor, "*b d"]) -> Float[Tensor, "*b d"]:
        """From anywhere into the box."""
        first, length = self.lower - self.margin, self.upper - self.lower + 2 * self.margin
        t = torch.remainder(y - first, 2 * length)
        t = length - (t - length).abs()
        from_below = self.lower + t**2 / (4 * self.margin)
        from_above = self.upper - (length - t) ** 2 / (4 * self.margin)
        x = torch.where(
            t < 2 * self.margin, from_below, torch.where(t > length - 2 * self.margin, from_above, first + t)
        )
        x = torch.minimum(torch.maximum(x, self.lower), self.upper)
        # Exactly the identity where it is one: no rounding between the optimiser and the objective.
        return torch.where((y >= self.lower + self.margin) & (y <= self.upper - self.margin), y, x)

    def unfold(self, x: Float[Tensor, "*b d"]) -> Float[Tensor, "*b d"]:
        """The inverse of ``fold``, nearest to the box. ``RegtorchError`` for a point outside the box."""
        if bool(((x < self.lower) | (x > self.upper)).any()):
            raise RegtorchError(
                f"a start lies outside the bounds {self.lower.tolist()} to {self.upper.tolist()}: expected it inside"
            )
        low = self.lower - self.margin + (4 * self.margin * (x - self.lower)).sqrt()
        high = self.upper + self.margin - (4 * self.margin * (self.upper - x)).sqrt()
        return torch.where(x < self.lower + self.margin, low, torch.where(x > self.upper - self.margin, high, x))
