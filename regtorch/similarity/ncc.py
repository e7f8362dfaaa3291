"""Normalised cross-correlation, eq. (3) of the paper, weighted, and the centring that gradient correlation shares."""

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.similarity.batches import over_images


def normalized_cross_correlation(
    moving: Float[Tensor, "*b h w"], fixed: Float[Tensor, "h w"], *, weight: Float[Tensor, "h w"] | None = None
) -> Float[Tensor, "*b"]:
    """Eq. (3): -1 to 1, whatever the gain and offset of either image; 0 where one of them does not vary.

    ``weight`` (not negative) turns sums into weighted sums, means included. All tensors share dtype and device.
    Differentiable. Raises ``RegtorchError`` for images of different shapes.
    """
    w = None if weight is None else weight.flatten()

    def values(images: Float[Tensor, "n h w"]) -> Float[Tensor, " n"]:
        f, one_over_f = centred_(fixed.flatten()[None].clone(), w, peak(fixed[None]))
        m, one_over_m = centred_(images.flatten(1).clone(), w, peak(images))
        return (m @ f[0]) * one_over_m * one_over_f

    return over_images(values, moving, fixed, weight)


def centred_(
    values: Float[Tensor, "n p"], weight: Float[Tensor, " p"] | None, magnitude: Float[Tensor, " n"]
) -> tuple[Float[Tensor, "n p"], Float[Tensor, " n"]]:
    """In place: ``values`` less their mean, times the root of the weight; and one over the length of that.

    The second is 0 where ``values`` do not vary beyond the rounding of numbers of ``magnitude``.
    """
    if weight is None:
        total = values.new_tensor(values.shape[1])
        values.sub_(values.mean(1, keepdim=True))
    else:
        total = weight.sum()
        values.sub_((values @ weight / total.clamp_min(torch.finfo(values.dtype).tiny))[:, None]).mul_(weight.sqrt())
    length = torch.linalg.vector_norm(values, dim=1)
    varies = ~(length <= 8 * torch.finfo(values.dtype).eps * magnitude * total.sqrt())  # not a number stays one
    # The inner choice keeps the derivative of the other branch finite.
    return values, torch.where(varies, 1 / torch.where(varies, length, 1), 0)


def peak(images: Float[Tensor, "n h w"]) -> Float[Tensor, " n"]:
    """Largest magnitude in each image: its rounding is relative to this."""
    return torch.linalg.vector_norm(images.detach(), torch.inf, dim=(1, 2))
