"""CMA-ES in place of Levenberg-Marquardt, many starts at once: a comparison without derivatives."""

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.optimization.climbing import Ascent, Equations
from regtorch.optimization.evolution_strategy import cma_es


def evolve(
    equations: Equations,
    start: Float[Tensor, "n d"],
    *,
    lower: Float[Tensor, " d"],
    upper: Float[Tensor, " d"],
    scale: Float[Tensor, " d"],
    steps: int,
    damping: float = 1e-2,
    generations_per_step: int = 4,
    first_step: float = 5.0,
) -> Ascent:
    """Climb with the interface of ``levenberg_marquardt``, but by similarities alone.

    ``equations`` computes derivatives all the same: compare evaluations, not seconds.

    Args:
        equations, start, lower, upper, scale: as in ``levenberg_marquardt``.
        steps: each stands for ``generations_per_step`` generations.
        damping: shortens the first step of a start near its end, by the fourth root of damping / 1e-2.
        generations_per_step: generations of CMA-ES per step.
        first_step: first standard deviation, in units of ``scale``.
    """
    sigma = (first_step * (damping / 1e-2) ** 0.25 * scale).clamp(max=(upper - lower) / 4)
    found = cma_es(
        lambda values: -equations(values)[0],
        start.clamp(lower, upper),
        sigma,
        lower=lower,
        upper=upper,
        max_generations=generations_per_step * steps,
        tol_fun=1e-6,
    )
    before, here, _ = equations(start.clamp(lower, upper))
    similarity, jtj, _ = equations(found.x)
    better = similarity > before
    return Ascent(
        torch.where(better[:, None], found.x, start.clamp(lower, upper)),
        torch.where(better, similarity, before),
        torch.where(better[:, None, None], jtj, here),
        int(found.evaluations.sum()) + 2 * len(found.x),
    )
