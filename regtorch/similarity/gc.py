"""Gradient correlation, eqs. (2)-(3) of the paper (Penney et al. 1998): the method's similarity."""

from types import ModuleType

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.similarity import cpu, triton
from regtorch.similarity.batches import over_images
from regtorch.similarity.gradients import gradient_weight, image_gradients
from regtorch.similarity.gram import equations_from_gram, fixed_gradients
from regtorch.similarity.ncc import centred_, peak


def gradient_correlation(
    moving: Float[Tensor, "*b h w"], fixed: Float[Tensor, "h w"], *, weight: Float[Tensor, "h w"] | None = None
) -> Float[Tensor, "*b"]:
    """Eq. (2): the mean of the normalised cross-correlations of the x- and of the y-gradients (Sobel); -1 to 1.

    Unchanged by gain and offset of either image; a direction in which one of them has no gradient counts as 0.
    ``weight`` (not negative) makes all sums over the image weighted ones, by ``gradient_weight``: a pixel of weight
    zero has no influence. All tensors share dtype and device. All moving images are one matrix, the fixed image a
    vector, and each direction one matrix product; where no derivative is wanted, one pass of a fused kernel over each
    image gives the same sums. Differentiable. Raises ``RegtorchError`` for different shapes.
    """

    def values(images: Float[Tensor, "n h w"]) -> Float[Tensor, " n"]:
        for fused in (cpu, triton):
            if fused.can_sum(images):
                return _from_sums(fused, images, fixed, weight)
        pairs = _centred_gradients(images, fixed, weight)
        return sum((m @ f) * scale for m, f, scale in pairs) / 2

    return over_images(values, moving, fixed, weight)


def gradient_correlation_image(
    moving: Float[Tensor, "*b h w"], fixed: Float[Tensor, "h w"], *, weight: Float[Tensor, "h w"] | None = None
) -> Float[Tensor, "*b h w"]:
    """Each pixel's share of ``gradient_correlation``, as in figure 7: an image's pixels sum to its value."""

    def values(images: Float[Tensor, "n h w"]) -> Float[Tensor, "n h w"]:
        pairs = _centred_gradients(images, fixed, weight)
        return (sum(m * f * scale[:, None] for m, f, scale in pairs) / 2).view_as(images)

    return over_images(values, moving, fixed, weight)


def _centred_gradients(
    images: Float[Tensor, "n h w"], fixed: Float[Tensor, "h w"], weight: Float[Tensor, "h w"] | None
) -> list[tuple[Float[Tensor, "n p"], Float[Tensor, " p"], Float[Tensor, " n"]]]:
    """For x and y: gradients of the moving and of the fixed images less their means, one over both their lengths."""
    w = None if weight is None else gradient_weight(weight).flatten()
    moving_peak, fixed_peak = peak(images), peak(fixed[None])
    pairs = []
    for moving_gradient, fixed_gradient in zip(image_gradients(images), image_gradients(fixed[None]), strict=True):
        f, one_over_f = centred_(fixed_gradient.flatten(1), w, fixed_peak)
        m, one_over_m = centred_(moving_gradient.flatten(1), w, moving_peak)
        pairs.append((m, f[0], one_over_m * one_over_f))
    return pairs


def _from_sums(
    fused: ModuleType,
    images: Float[Tensor, "n h w"],
    fixed: Float[Tensor, "h w"],
    weight: Float[Tensor, "h w"] | None,
) -> Float[Tensor, " n"]:
    prepared = fixed_gradients(fixed, weight)
    gram, magnitude = fused.gradient_gram(images, *prepared)
    return equations_from_gram(gram, magnitude, prepared, torch.finfo(images.dtype).eps).similarity.to(images)
