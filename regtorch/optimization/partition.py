"""Multi-start search from the cells of a kD-tree (Otake et al. 2013b; Bentley 1975)."""

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

    Each cut crosses the axis with the largest extent in units of ``scale``, the first one of equals. The volumes on
    both sides are in proportion to their numbers of cells. ``scale`` holds equally long steps of the parameters, each
    in its unit.
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

    The whole box bounds every search, not the cell.

    Args:
        search: ``cma_es`` or ``pycma`` with the objective bound to it, as in ``partial(cma_es, objective, seed=...)``.
        lower, upper: corners of the box.
        starts: number of cells.
        scale: as in ``kd_partition``.
        sigma_fraction: first standard deviations, as a share of a cell's sides (Hansen's tutorial, appendix B.1).
    """
    low, high = kd_partition(lower, upper, starts, scale=scale)
    return search((low + high) / 2, sigma_fraction * (high - low), lower=lower, upper=upper)
