"""Evidence for and against a search's answer: named numbers, for rules, files and tables."""

import math
from dataclasses import asdict, dataclass
from typing import Any, Literal

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from regtorch.geometry import NAMES, Z_OBJ, Z_S, project, world_from_ct
from regtorch.registration.problem import Problem
from regtorch.registration.trust.limits import LIMITS, Limits
from regtorch.registration.trust.uncertainty import root_mean_square_mm

_STEP_MM = 10.0
"""Length of the piece of the body axis that is projected, mm."""


@dataclass(frozen=True)
class Evidence:
    """Similarities are gradient correlations, -1 to 1, unless ``comparable`` is false; None: not measured."""

    comparable: bool
    """Whether the similarity is gradient correlation, for which the limits are known."""

    similarity: float
    """The answer's on the finest level, robustly weighted."""

    best_start: float
    """The best start's."""

    starts: int
    """Starts that climbed to the end of the second level."""

    agreeing: int
    """Starts that ended at the answer's place."""

    gap: float | None
    """The best agreeing start's similarity less the runner-up's, the best start elsewhere."""

    runner_up_mm: float | None
    """Shift of the runner-up along the body axis, mm in the detector plane (up is positive); 0 for other shifts."""

    mirrored: float | None
    """The best start's similarity for the radiograph mirrored left to right."""

    gain: float | None
    """Factor by which robust weights raise bone's similarity; None where bone or all tissue explains the image."""

    expected_mm: float | None
    """Expected error of the anatomy in the image: root mean square in the detector plane, mm."""

    released_mm: float | None
    """How far the image moves once frozen parameters may move: root mean square in the detector plane, mm."""

    sdd_deviation: float | None
    """Standard deviation of the SDD, as a share of it."""

    frozen: tuple[str, ...]
    """Names of the parameters that were frozen."""

    at_limit: tuple[str, ...]
    """Names of the free parameters that ended at a limit of the range."""

    looks: int
    """Times that the search looked: 1, or more where the answer did not convince."""

    behind_mm: float | None = None
    """How far the anatomy in the image reaches behind the detector, mm; 0 where all of it is before the detector."""

    tissue: str | None = None
    """``bone`` or ``all tissue``: the tissue whose DRR the answer and its covariance rest on."""

    def to_dict(self) -> dict[str, Any]:
        """Plain values, as written to ``result.json`` and to the tables of studies."""
        return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self).items()}


def measure(
    problem: Problem,
    parameters: Float[Tensor, "9"],
    similarity: float,
    starts: Float[Tensor, "n 9"],
    start_similarity: Float[Tensor, " n"],
    *,
    comparable: bool,
    covariance: Float[Tensor, "9 9"] | None = None,
    released: Float[Tensor, "9"] | None = None,
    mirrored: float | None = None,
    gain: float | None = None,
    looks: int = 1,
    tissue: Literal["bone", "all tissue"] = "bone",
    limits: Limits = LIMITS,
) -> Evidence:
    """The evidence for an answer (mm, rad) that ``starts``, best first, have led to.

    Args:
        comparable: Whether the similarity is gradient correlation.
        covariance: Of the nine parameters (mm, rad), if the method knows it.
        released: How far the nine parameters move once frozen ones are free.
        mirrored: The best start's similarity for the radiograph mirrored.
        gain: Factor by which robust weights raise the similarity.
        looks: Times that the search looked.
        tissue: The tissue that the last climb matched.
        limits: Which distance counts as the same place, and which margin as a limit of the range.
    """
    agree = problem.same_place(starts, parameters, limits.agree_mm)
    searched = problem.searched
    return Evidence(
        comparable=comparable,
        similarity=similarity,
        best_start=float(start_similarity.max()),
        starts=len(starts),
        agreeing=int(agree.sum()),
        gap=_gap(start_similarity, agree),
        runner_up_mm=_runner_up_mm(problem, parameters, starts, start_similarity, agree),
        mirrored=mirrored,
        gain=gain,
        expected_mm=None if covariance is None else root_mean_square_mm(problem, parameters, covariance),
        released_mm=None if released is None else root_mean_square_mm(problem, parameters, released.outer(released)),
        sdd_deviation=_sdd_deviation(searched.free, parameters, covariance),
        frozen=tuple(name for index, name in enumerate(NAMES) if index not in searched.free),
        at_limit=tuple(NAMES[index] for index in searched.at_limit(parameters, limits.margin)),
        looks=looks,
        behind_mm=_behind_mm(problem, parameters),
        tissue=tissue,
    )


def convincing(
    problem: Problem, starts: Float[Tensor, "n 9"], similarity: Float[Tensor, " n"], limits: Limits = LIMITS
) -> bool:
    """Whether starts, best first, agree on the best one's place, without a rival and away from limits of the range."""
    if problem.searched.at_limit(starts[0], limits.margin):
        return False
    agree = problem.same_place(starts, starts[0], limits.agree_mm)
    gap = _gap(similarity, agree)
    return int(agree.sum()) >= limits.least_agreeing and (gap is None or gap >= limits.least_gap)


def _behind_mm(problem: Problem, parameters: Float[Tensor, "9"]) -> float:
    """From the points' heights over the detector, Z of the world."""
    in_ct = problem.points - problem.attenuating.origin_patient_mm
    height = in_ct @ world_from_ct(parameters, problem.view)[2, :3] + parameters[Z_OBJ]
    return max(0.0, -float(height.min()))


def _gap(similarity: Float[Tensor, " n"], agree: Bool[Tensor, " n"]) -> float | None:
    """None where all agree, or none."""
    if bool(agree.all()) or not bool(agree.any()):
        return None
    return float(similarity[agree].max() - similarity[~agree].max())


def _sdd_deviation(
    free: list[int], parameters: Float[Tensor, "9"], covariance: Float[Tensor, "9 9"] | None
) -> float | None:
    if covariance is None or not {Z_S, Z_OBJ} <= set(free):
        return None
    return float(covariance[Z_S, Z_S].sqrt() / parameters[Z_S])


def _runner_up_mm(
    problem: Problem,
    parameters: Float[Tensor, "9"],
    starts: Float[Tensor, "n 9"],
    similarity: Float[Tensor, " n"],
    agree: Bool[Tensor, " n"],
) -> float | None:
    """Shift along the body axis; 0 where the image moves otherwise by more than half the whole shift."""
    if bool(agree.all()):
        return None
    rival = starts[~agree][similarity[~agree].argmax()]
    here, there = (project(problem.pixel_from_patient(p), problem.points) for p in (parameters, rival))
    axis = torch.tensor([0.0, 0.0, _STEP_MM], dtype=torch.float64)
    above = project(problem.pixel_from_patient(parameters), problem.points + axis)
    up = (above - here).nanmean(0) / _STEP_MM
    shift = there - here
    mean = shift.nanmean(0)
    along = float(mean @ up / (up @ up))
    rest = float((shift - along * up).norm(dim=1).nanmean())
    if not (math.isfinite(along) and rest < float(mean.norm()) / 2):
        return 0.0
    return along
