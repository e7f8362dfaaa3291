"""The starts of a search, checked once and brought to coordinates in which all are alike."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.errors import RegtorchError
from regtorch.optimization.box import Box


@dataclass(frozen=True)
class Start:
    """n starts in coordinates u in which each parameter's first standard deviation is at most 1.

    A parameter is ``box.fold(u * scale)``, or ``u * scale`` without a box. ``shape`` has a largest diagonal of 1.
    """

    u: Float[Tensor, "n d"]
    scale: Float[Tensor, "n d"]
    shape: Float[Tensor, "n d d"]
    box: Box | None

    def real(self, u: Float[Tensor, "n *b d"], starts: Tensor | slice = slice(None)) -> Float[Tensor, "n *b d"]:
        """The parameters of points ``u`` of the chosen ``starts`` (all of them unless told)."""
        scale = self.scale[starts]
        y = u * scale.view(len(scale), *(1,) * (u.dim() - 2), -1)
        return y if self.box is None else self.box.fold(y)


def prepare(
    start: Float[Tensor, "n d"],
    sigma: Float[Tensor, " d"] | Float[Tensor, "n d"],
    lower: Float[Tensor, " d"] | None,
    upper: Float[Tensor, " d"] | None,
    covariance: Float[Tensor, "n d d"] | None,
) -> Start:
    """``Start`` of the arguments that all optimisers share; ``RegtorchError`` says which of them is wrong."""
    start = start.detach().cpu().double()
    n, d = start.shape
    if n < 1 or d < 1 or not bool(start.isfinite().all()):
        raise RegtorchError(f"start of shape {n} x {d}: expected at least one start and parameter, all finite")
    scale = sigma.detach().cpu().double().expand(n, d)
    if not bool((scale > 0).all() & scale.isfinite().all()):
        raise RegtorchError(f"sigma {sigma.tolist()}: expected positive finite standard deviations")
    if (lower is None) != (upper is None):
        raise RegtorchError("one of lower and upper is missing: expected both or neither")
    box = None if lower is None or upper is None else Box(lower, upper)
    shape = torch.eye(d, dtype=torch.float64).expand(n, d, d)
    if covariance is not None:
        shape = covariance.detach().cpu().double() / (scale[:, :, None] * scale[:, None, :])
        shape = (shape + shape.mT) / 2
        shape = shape / shape.diagonal(dim1=1, dim2=2).amax(1)[:, None, None]
        if not bool(shape.isfinite().all()) or bool((torch.linalg.eigvalsh(shape)[:, 0] <= 0).any()):
            raise RegtorchError("covariance is not positive definite: expected one that is, for every start")
    unfolded = start if box is None else box.unfold(start)
    return Start(unfolded / scale, scale, shape, box)
