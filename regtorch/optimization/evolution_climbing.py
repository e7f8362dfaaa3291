"""Climbs without derivatives, many starts at once: CMA-ES in place of Levenberg-Marquardt, for comparison."""

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
    """``levenberg_marquardt``'s interface; of ``equations`` the similarity alone is used until the end is reached.

    Derivatives are computed all the same: compare evaluations, not seconds.

    ``first_step`` is in units of ``scale``, less where ``damping`` says that the start is near its end (its fourth
    root, 1 for 1e-2).
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
