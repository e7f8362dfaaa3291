"""The answer of every optimiser of this folder."""

from dataclasses import dataclass

from jaxtyping import Float, Int
from torch import Tensor


@dataclass(frozen=True)
class Optimum:
    """The end of n starts in d parameters; float64, on the CPU.

    ``x`` and ``cost`` are the best point that each start ever evaluated. ``mean`` and ``covariance`` are the search
    distribution at the end, in the units of the parameters and with the step size in it (sigma^2 C); within a
    twentieth of the box's width from a bound, ``covariance`` is that of the unfolded coordinates (see ``Box``).
    ``reason`` names the rule that stopped each start.
    """

    x: Float[Tensor, "n d"]
    cost: Float[Tensor, " n"]
    evaluations: Int[Tensor, " n"]
    generations: Int[Tensor, " n"]
    reason: tuple[str, ...]
    mean: Float[Tensor, "n d"]
    covariance: Float[Tensor, "n d d"]

    @property
    def best(self) -> int:
        """Which start ended lowest; the first one of equals."""
        return int(self.cost.argmin())
