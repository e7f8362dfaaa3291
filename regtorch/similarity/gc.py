"""Gradient correlation, eqs. (2)-(3) of the paper (Penney et al. 1998): the default similarity."""

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
    """Eq. (2): mean of the normalised cross-correlations of the x- and the y-gradients (Sobel), -1 to 1.

    Gain and offset of either image do not matter. A direction in which one image has no gradient counts as 0. The
    result is differentiable. Without a derivative, a fused kernel makes the same sums in one pass over each image.
    Raises ``RegtorchError`` for images of different shapes.

    Args:
        moving: moving images.
        fixed: fixed image, of the same dtype and device.
        weight: weights of the pixels, not negative, by ``gradient_weight``. A pixel of weight 0 has no influence.
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
    """Contribution of each pixel to ``gradient_correlation`` (figure 7); the pixels of an image sum to its value."""

    def values(images: Float[Tensor, "n h w"]) -> Float[Tensor, "n h w"]:
        pairs = _centred_gradients(images, fixed, weight)
        return (sum(m * f * scale[:, None] for m, f, scale in pairs) / 2).view_as(images)

    return over_images(values, moving, fixed, weight)


def _centred_gradients(
    images: Float[Tensor, "n h w"], fixed: Float[Tensor, "h w"], weight: Float[Tensor, "h w"] | None
) -> list[tuple[Float[Tensor, "n p"], Float[Tensor, " p"], Float[Tensor, " n"]]]:
    """For x and y: centred gradients of the moving and of the fixed images, and one over the product of lengths."""
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
