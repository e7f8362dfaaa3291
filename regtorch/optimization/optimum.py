"""The result of every optimiser in this folder."""

from dataclasses import dataclass

from jaxtyping import Float, Int
from torch import Tensor


@dataclass(frozen=True)
class Optimum:
    """The end of n starts in d parameters; float64, on the CPU.

    ``x`` and ``cost`` are the best point that each start evaluated. ``mean`` and ``covariance`` are the last search
    distribution in the parameters' units; the covariance includes the step size (sigma^2 C). Within a twentieth of
    the box's width from a bound, ``covariance`` is that of the unfolded coordinates (see ``Box``). ``reason`` names
    the rule that stopped each start.
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
        """Index of the start with the lowest cost; the first one of equals."""
        return int(self.cost.argmin())
