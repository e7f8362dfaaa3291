"""Gradient correlation and its normal equations from products of gradient images alone.

Take one direction, and multiply all gradients by r, the root of the weight: m is the moving image's gradient, f the
fixed image's, and g_1 to g_p those of the moving image's derivatives. A prime takes off the weighted mean. Let
M = m'/|m'|, F = f'/|f'| and rho = M F. The residual M - F has the derivative J_i = (g_i' - M (M g_i')) / |m'|, so

    J_i J_j = (g_i' g_j' - (M g_i') (M g_j')) / |m'|^2        J_i (M - F) = (rho (M g_i') - F g_i') / |m'|.

All are sums and products of entries of the Gram matrix of (m, g_1 ... g_p) with (F, r, m, g_1 ... g_p).
"""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.similarity.gradients import gradient_weight, image_gradients
from regtorch.similarity.ncc import centred_, peak


class FixedGradients(NamedTuple):
    """The fixed image's side: F (0 where it does not vary) and r, see above."""

    unit: Float[Tensor, "2 h w"]
    root: Float[Tensor, "h w"]


class NormalEquations(NamedTuple):
    """Per pose: gradient correlation, J^T J and J^T r of both directions' residuals; |r|^2 = 4 (1 - similarity)."""

    similarity: Float[Tensor, " n"]
    jtj: Float[Tensor, "n p p"]
    jtr: Float[Tensor, "n p"]


def fixed_gradients(fixed: Float[Tensor, "h w"], weight: Float[Tensor, "h w"] | None) -> FixedGradients:
    """Normalised gradients of the fixed image under a weight, by ``gradient_weight``."""
    w = torch.ones_like(fixed) if weight is None else gradient_weight(weight)
    unit = []
    for gradient in image_gradients(fixed[None]):
        centred, one_over = centred_(gradient.flatten(1), w.flatten(), peak(fixed[None]))
        unit.append((centred * one_over[:, None]).view_as(fixed))
    return FixedGradients(torch.stack(unit), w.sqrt())


def gradient_gram(
    images: Float[Tensor, "n m h w"], fixed: FixedGradients
) -> tuple[Float[Tensor, "n 2 m m+2"], Float[Tensor, " n"]]:
    """For the x- and the y-direction, products of (m, g_1 ... g_p) = ``images`` with (F, r, m, g_1 ... g_p), float64.

    The second result is the root mean square of each first image. The plain form of the fused kernels.
    """
    n, m = images.shape[:2]
    grams = []
    for gradient, unit in zip(image_gradients(images.flatten(0, 1)), fixed.unit, strict=True):
        rows = (gradient * fixed.root).view(n, m, -1).double()
        constant = torch.stack([unit, fixed.root]).flatten(1).double().expand(n, 2, -1)
        grams.append(rows @ torch.cat([constant, rows], dim=1).mT)
    return torch.stack(grams, dim=1), images[:, 0].double().square().mean((1, 2)).sqrt()


def equations_from_gram(
    gram: Float[Tensor, "n 2 m m+2"], magnitude: Float[Tensor, " n"], fixed: FixedGradients, precision: float
) -> NormalEquations:
    """From the upper triangle of the Gram matrix; a direction in which the moving image does not vary counts as 0.

    It does not vary if its gradients are within the rounding of images of ``magnitude`` with relative ``precision``.
    """
    with_fixed, sums, products = gram[..., 0], gram[..., 1], gram[..., 2:]
    total = fixed.root.double().square().sum().clamp_min(torch.finfo(torch.float64).tiny)
    products = products.triu() + products.triu(1).mT - sums[..., :, None] * sums[..., None, :] / total
    length = products[..., 0, 0].clamp_min(0).sqrt()
    varies = ~(length <= 8 * precision * magnitude[:, None] * total.sqrt())
    scale = torch.where(varies, 1 / torch.where(varies, length, 1), 0)[..., None]
    rho = with_fixed[..., 0] * scale[..., 0]
    along = products[..., 0, 1:] * scale
    jtj = (products[..., 1:, 1:] - along[..., :, None] * along[..., None, :]) * scale[..., None].square()
    jtr = (rho[..., None] * along - with_fixed[..., 1:]) * scale
    return NormalEquations(rho.mean(-1), jtj.sum(1), jtr.sum(1))
