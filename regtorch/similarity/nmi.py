"""Normalised mutual information (Studholme et al. 1999) of joint histograms, many images at once."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from regtorch.errors import RegtorchError
from regtorch.similarity.batches import over_images


def normalized_mutual_information(
    moving: Float[Tensor, "*b h w"],
    fixed: Float[Tensor, "h w"],
    *,
    weight: Float[Tensor, "h w"] | None = None,
    bins: int = 32,
) -> Float[Tensor, "*b"]:
    """(H(moving) + H(fixed)) / H(moving, fixed): 1 for independent images, 2 for images that determine each other.

    Each image's range is divided evenly into ``bins``; a value counts in the two bins nearest to it, linearly (a
    Parzen window of order one). ``weight`` (not negative) is a pixel's weight; where it is zero the pixel does not
    set the range either. Unchanged by positive gain and offset; 1 where an image does not vary. All tensors share
    dtype and device. Differentiable almost everywhere. Raises ``RegtorchError`` for different shapes.
    """
    if bins < 2:
        raise RegtorchError(f"{bins} bins: expected at least 2")
    w = torch.ones_like(fixed) if weight is None else weight

    def values(images: Float[Tensor, "n h w"]) -> Float[Tensor, " n"]:
        f_bin, f_part = _soft_bins(fixed[None], w, bins)
        m_bin, m_part = _soft_bins(images, w, bins)
        joint = images.new_zeros(len(images), bins * bins)
        for i in (0, 1):
            for j in (0, 1):
                share = (m_part if i else 1 - m_part) * ((f_part if j else 1 - f_part) * w.flatten())
                joint = joint.scatter_add(1, (m_bin + i) * bins + (f_bin + j), share)
        joint = (joint / w.sum()).unflatten(1, (bins, bins))
        both = _entropy(joint.flatten(1))
        apart = _entropy(joint.sum(1)) + _entropy(joint.sum(2))
        return torch.where(both > 0, apart / torch.where(both > 0, both, 1), 1)

    return over_images(values, moving, fixed, weight)


def _soft_bins(
    images: Float[Tensor, "n h w"], weight: Float[Tensor, "h w"], bins: int
) -> tuple[Int[Tensor, "n p"], Float[Tensor, "n p"]]:
    """The lower of the two bins of each pixel, and the share of the pixel that belongs to the upper one."""
    counts, values = weight.flatten() > 0, images.flatten(1)
    low = torch.where(counts, values, torch.inf).amin(1, keepdim=True)
    high = torch.where(counts, values, -torch.inf).amax(1, keepdim=True)
    place = ((values - low) / torch.where(high > low, high - low, 1)).clamp(0, 1) * (bins - 1)
    lower = place.detach().floor().clamp_max(bins - 2)
    return lower.long(), place - lower


def _entropy(p: Float[Tensor, "n k"]) -> Float[Tensor, " n"]:
    return -torch.xlogy(p, p).sum(1)
