"""Many starts that cover a box evenly, and the best of them (Otake et al. 2013b; Bentley 1975)."""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.errors import RegtorchError
from regtorch.optimization.optimum import Optimum


def kd_partition(
    lower: Float[Tensor, " d"], upper: Float[Tensor, " d"], n: int, *, scale: Float[Tensor, " d"]
) -> tuple[Float[Tensor, "n d"], Float[Tensor, "n d"]]:
    """Split a box into exactly ``n`` cells of equal volume; returns their lower and upper corners.

    Always across the axis whose extent divided by ``scale`` is largest, the first one of equals, and in proportion to
    the cells on either side. ``scale`` is an equally long way in each parameter, in its unit.
    """
    if n < 1:
        raise RegtorchError(f"{n} cells: expected at least one")
    if not bool((lower < upper).all() & (scale > 0).all()):
        raise RegtorchError("a box that is empty or a scale that is not positive: expected lower < upper, scale > 0")
    if n == 1:
        return lower[None], upper[None]
    axis = int(((upper - lower) / scale).argmax())
    cut = lower[axis] + (upper[axis] - lower[axis]) * (n // 2 / n)
    left_upper, right_lower = upper.clone(), lower.clone()
    left_upper[axis] = right_lower[axis] = cut
    left = kd_partition(lower, left_upper, n // 2, scale=scale)
    right = kd_partition(right_lower, upper, n - n // 2, scale=scale)
    return torch.cat([left[0], right[0]]), torch.cat([left[1], right[1]])


def multi_start(
    search: Callable[..., Optimum],
    lower: Float[Tensor, " d"],
    upper: Float[Tensor, " d"],
    *,
    starts: int = 100,
    scale: Float[Tensor, " d"],
    sigma_fraction: float = 0.3,
) -> Optimum:
    """Minimise from the centre of each cell of ``kd_partition``, all at once; the answer is at ``Optimum.best``.

    The first standard deviations are ``sigma_fraction`` of the cell's sides (0.3: Hansen's tutorial, appendix B.1).
    The whole box bounds the search, not the cell. ``search`` is ``cma_es`` or ``pycma`` with the objective bound to it:
    ``partial(cma_es, objective, seed=...)``.
    """
    low, high = kd_partition(lower, upper, starts, scale=scale)
    return search((low + high) / 2, sigma_fraction * (high - low), lower=lower, upper=upper)
