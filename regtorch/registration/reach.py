"""Ranges that nobody gave give way: a search that ends at such a limit goes on beyond it, as far as physics allows."""

import math
from collections.abc import Callable
from dataclasses import replace

from jaxtyping import Float
from torch import Tensor

from regtorch.geometry import NAMES, Z_OBJ, Z_S, world_from_ct
from regtorch.registration.found import Found
from regtorch.registration.problem import Problem
from regtorch.registration.trust.limits import LIMITS
from regtorch.registration.unknowns import Range

_MOVES = 4
"""Most times that the range moves on: 150 mm about an SDD of 1000 mm then reach 2575 mm."""

_SDD_MM = (500.0, 3000.0)
"""Least and largest source-detector distance."""

_INTO_DETECTOR_MM = 50.0
"""How far the range lets anatomy into the detector: a wrong pixel size puts it there."""

_MOST_ASIDE_MM = 500.0
"""Largest distance of source and patient from the detector's middle, along rows and columns."""

_MOST_TURNED = math.radians(45)
"""Largest angle, rad."""


def searched_on(
    method: Callable[[Problem], Found], problem: Problem, given: Float[Tensor, "9"] | None
) -> tuple[Found, list[str]]:
    """The method's answer, and a line for each parameter whose range moved on to hold it.

    ``given`` holds the half ranges that somebody chose, NaN for others: these alone may move. An answer at a limit
    gives way to one found beyond it, unless its best start is more similar by ``least_gap``. Where nothing matches, no
    range moves.
    """
    found, start = method(problem), problem.searched
    for _ in range(_MOVES):
        wider = problem.searched
        for index in (NAMES.index(name) for name in found.evidence.at_limit):
            if given is None or bool(given[index].isnan()):
                wider = _moved_on(problem, wider, index, float(found.parameters[index]))
        if wider is problem.searched or found.evidence.best_start < LIMITS.least_similarity:
            break
        problem.progress(0.0, "the answer lies at a limit: searching beyond")
        beyond = replace(problem, searched=wider)
        further = method(beyond)
        if found.evidence.best_start - further.evidence.best_start >= LIMITS.least_gap:
            break
        problem, found = beyond, further
    return found, _told(start, problem.searched)


def _moved_on(problem: Problem, searched: Range, index: int, at: float) -> Range:
    """From half a range before the limit to a whole one beyond it, where physics allows."""
    lower, upper = float(searched.lower[index]), float(searched.upper[index])
    half = (upper - lower) / 2
    least, most = _possible(problem, index)
    low, high = (upper - half, upper + 2 * half) if at > (lower + upper) / 2 else (lower - 2 * half, lower + half)
    low, high = max(low, min(least, lower)), min(high, max(most, upper))
    if low >= lower and high <= upper:
        return searched
    initial, half_range = searched.initial.clone(), searched.half_range.clone()
    initial[index], half_range[index] = (low + high) / 2, (high - low) / 2
    return Range(initial, half_range)


def _possible(problem: Problem, index: int) -> tuple[float, float]:
    """Least and largest value (mm, rad) that physics allows."""
    if index == Z_S:
        return _SDD_MM
    if index == Z_OBJ:
        in_ct = problem.points - problem.attenuating.origin_patient_mm
        heights = in_ct @ world_from_ct(problem.searched.initial, problem.view)[2, :3]
        return -float(heights.min()) - _INTO_DETECTOR_MM, float(problem.searched.upper[Z_S] - heights.max())
    return (-_MOST_ASIDE_MM, _MOST_ASIDE_MM) if index < Z_OBJ else (-_MOST_TURNED, _MOST_TURNED)


def _told(start: Range, last: Range) -> list[str]:
    lines = []
    for index, name in enumerate(NAMES):
        low, high = float(last.lower[index]), float(last.upper[index])
        if (low, high) != (float(start.lower[index]), float(start.upper[index])):
            unit, factor = ("mm", 1.0) if index <= Z_OBJ else ("degrees", math.degrees(1))
            reach = f"{factor * low:.0f} to {factor * high:.0f} {unit}"
            lines.append(f"{name} at the limit of its default range: searched on from {reach}")
    return lines
