"""Bounds by a smooth change of coordinates: the optimiser itself sees none."""

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.errors import RegtorchError

MARGIN = 0.05
"""Share of the box's width at either bound."""


class Box:
    """pycma's BoxConstraintsLinQuadTransformation with a margin that does not depend on the origin's place.

    ``fold`` is the identity, except within the margin of a bound, where it is quadratic. It is flat at the bound
    itself, which lies ``margin`` beyond the bound in the unfolded coordinate. From there on it mirrors. So it is
    periodic and continuously differentiable, and an optimum on a bound becomes an ordinary interior one.
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
        """The point of the box for any unfolded point."""
        first, length = self.lower - self.margin, self.upper - self.lower + 2 * self.margin
        t = torch.remainder(y - first, 2 * length)
        t = length - (t - length).abs()
        from_below = self.lower + t**2 / (4 * self.margin)
        from_above = self.upper - (length - t) ** 2 / (4 * self.margin)
        x = torch.where(
            t < 2 * self.margin, from_below, torch.where(t > length - 2 * self.margin, from_above, first + t)
        )
        x = torch.minimum(torch.maximum(x, self.lower), self.upper)
        # Exactly the identity away from bounds: no rounding between optimiser and objective.
        return torch.where((y >= self.lower + self.margin) & (y <= self.upper - self.margin), y, x)

    def unfold(self, x: Float[Tensor, "*b d"]) -> Float[Tensor, "*b d"]:
        """The unfolded point nearest to the box. Raises ``RegtorchError`` for a point outside the box."""
        if bool(((x < self.lower) | (x > self.upper)).any()):
            raise RegtorchError(
                f"a start lies outside the bounds {self.lower.tolist()} to {self.upper.tolist()}: expected it inside"
            )
        low = self.lower - self.margin + (4 * self.margin * (x - self.lower)).sqrt()
        high = self.upper + self.margin - (4 * self.margin * (self.upper - x)).sqrt()
        return torch.where(x < self.lower + self.margin, low, torch.where(x > self.upper - self.margin, high, x))
