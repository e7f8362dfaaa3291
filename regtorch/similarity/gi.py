"""Gradient information (Pluim et al. 2000), the similarity of the paper's predecessor (Otake et al. 2013b)."""

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.similarity.batches import over_images
from regtorch.similarity.gradients import gradient_weight, image_gradients


def gradient_information(
    moving: Float[Tensor, "*b h w"], fixed: Float[Tensor, "h w"], *, weight: Float[Tensor, "h w"] | None = None
) -> Float[Tensor, "*b"]:
    """Sum over the pixels of (cos(2 alpha) + 1) / 2 * min(|g|, |g'|), with the angle alpha between gradients (Sobel).

    The result is not negative, in the images' unit per pixel. Both images must have the same gain. All tensors share
    dtype and device. ``weight`` (not negative) multiplies each pixel's term, by ``gradient_weight``. A pixel of weight
    0 has no influence. Raises ``RegtorchError`` for images of different shapes.
    """

    def values(images: Float[Tensor, "n h w"]) -> Float[Tensor, " n"]:
        (mx, my), (fx, fy) = image_gradients(images), image_gradients(fixed[None])
        m, f = torch.hypot(mx, my), torch.hypot(fx, fy)
        # (cos(2 alpha) + 1) / 2 = cos(alpha)^2, and min(m, f) / (m f)^2 = 1 / (m f max(m, f)).
        cosine = (mx * fx + my * fy) / (m * f).clamp_min(torch.finfo(m.dtype).tiny)
        terms = cosine**2 * torch.minimum(m, f)
        return terms.sum((1, 2)) if weight is None else terms.flatten(1) @ gradient_weight(weight).flatten()

    return over_images(values, moving, fixed, weight)
