"""How far a result can be trusted, from what the search itself has seen."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.geometry import KEYS, pixel_from_patient, project
from regtorch.registration.problem import Found, Problem
from regtorch.registration.result import Status
from regtorch.registration.uncertainty import root_mean_square_mm
from regtorch.similarity import gradient_correlation

_AGREE_MM = 20.0
"""Starts that project the anatomy this close to each other have found the same place on the second level."""

_LEAST_SIMILARITY = 0.05
"""The best start's, below which nothing matches. Unrelated images and noise have about 0.03."""

_LEAST_GAP = 0.05
"""How much better than the next best place the answer must be on the second level."""

_REACHED = 0.3
"""The answer's similarity, what it does not explain marked down, from which a weak best start does not matter: 0.22
at most for what fits nowhere, 0.4 for a lateral pelvis whose soft tissue scatter has hidden."""

_STRONG, _OVER_MIRRORED = 0.4, 0.06
"""The best start's similarity, below which it must be so much more than what the radiograph reaches mirrored: 0.07 and
more for right radiographs, but 0.02 for those of a thorax that the CT holds half of; 0.02 for another patient's on
which all starts agreed. Nothing else has the same contrast, noise and field, and fits nowhere."""

_EVERYWHERE = 1.2
"""Gained by marking down what bone does not explain, below which that is everywhere: see ``refinement.gain``."""

_MOST_EXPECTED_MM = 3.0
"""Root mean square: 95 % of such errors are below 5 mm, within which a vertebra is the right one."""

_VERTEBRA_MM = (15.0, 55.0)
_LARGEST_SDD_DEVIATION = 0.02


def convincing(problem: Problem, starts: Float[Tensor, "n 9"], similarity: Float[Tensor, " n"]) -> bool:
    """Whether more than one of the starts, sorted, ended where the first did, and no other place is nearly as good.

    And not at a limit of the range, where a climb from a wrong basin ends.
    """
    if at_limit(problem, starts[0]):
        return False
    agree = problem.shift_mm(starts, starts[0]) < _AGREE_MM
    rivals = similarity[~agree]
    return int(agree.sum()) > 1 and (not len(rivals) or float(similarity[0] - rivals[0]) >= _LEAST_GAP)


def at_limit(problem: Problem, parameters: Float[Tensor, "9"]) -> list[int]:
    """Which of the free parameters lie at a limit of their range."""
    values, lower, upper = parameters[problem.free], problem.lower, problem.upper
    margin = 1e-3 * (upper - lower)
    limited = ((values - lower < margin) | (upper - values < margin)).nonzero().flatten()
    return [problem.free[i] for i in limited.tolist()]


def judge(problem: Problem, found: Found) -> tuple[Status, str]:
    """``failed`` where nothing matches; ``doubtful`` where the answer is at a limit, weak, found once or rivalled."""
    best = float(found.start_similarity.max())
    if not (best >= _LEAST_SIMILARITY and math.isfinite(found.similarity)):
        return "failed", f"similarity {best:.3f} at best: the images do not match anywhere in the range"
    known = f"similarity {found.mirrored_similarity:.2f} instead of {best:.2f}"
    if problem.similarity is not gradient_correlation:
        return "doubtful", "how good a match is can be told of gradient correlation alone"
    if found.mirrored_similarity > best:
        return "doubtful", f"mirrored, the radiograph matches better ({known}): it may show the other side"
    if limited := at_limit(problem, found.parameters):
        names = ", ".join(KEYS[parameter].rsplit("_", 1)[0] for parameter in limited)
        return "doubtful", f"{names} at the limit of the range searched: the answer may lie beyond"
    if best < found.weak_similarity and found.similarity < _REACHED:
        return "doubtful", f"similarity {best:.2f} at best: too weak to tell this anatomy from another"
    if best < _STRONG and found.mirrored_similarity > best - _OVER_MIRRORED:
        return "doubtful", f"mirrored, the radiograph matches nearly as well ({known}): it may show another anatomy"
    agree = problem.shift_mm(found.starts, found.parameters) < _AGREE_MM
    count, total = int(agree.sum()), len(agree)
    if total == 1:
        return "doubtful", "found from the only start: nothing else confirms it"
    if count < 2:
        return "doubtful", f"only {count} of {total} starts ended here: another place may match as well"
    gap = (
        math.inf
        if count == total
        else float(found.start_similarity[agree].max() - found.start_similarity[~agree].max())
    )
    if gap < _LEAST_GAP:
        return "doubtful", f"another place matches as well to within {gap:.3f} of similarity"
    if found.covariance is not None:
        expected = root_mean_square_mm(problem, found.parameters, found.covariance)
        if not expected <= _MOST_EXPECTED_MM:
            return "doubtful", _why(problem, found, expected)
    if found.gain < _EVERYWHERE:
        known = f"marked down, that makes bone only {found.gain:.2f} times as similar"
        return "doubtful", f"what bone does not explain is everywhere ({known}): it may lie elsewhere"
    if count == total:
        return "ok", f"all {total} starts agree"
    return "ok", f"{count} of {total} starts agree, the next best place is {gap:.2f} lower in similarity"


def _why(problem: Problem, found: Found, expected_mm: float) -> str:
    """What most of the expected error is."""
    error = f"an error of {expected_mm:.1f} mm in the image is expected"
    if found.released is not None:
        moves = found.released.outer(found.released)
        if root_mean_square_mm(problem, found.parameters, moves) ** 2 > expected_mm**2 / 2:
            frozen = ", ".join(key.rsplit("_", 1)[0] for i, key in enumerate(KEYS) if i not in problem.free)
            return f"{frozen} may be wrong: by how the others move once these are free, {error}"
    return f"parts of the image disagree: {error}"


def warnings(problem: Problem, found: Found) -> tuple[str, ...]:
    """What a reader of a result should know besides: the flat direction, and a runner-up one vertebra off."""
    said = []
    if found.covariance is not None and {2, 5} <= set(problem.free):
        deviation = float(found.covariance[2, 2].sqrt())
        if not deviation <= _LARGEST_SDD_DEVIATION * float(found.parameters[2]):
            said.append(f"SDD and ODD can hardly be told apart: SDD +- {deviation:.0f} mm, and the patient with it")
    agree = problem.shift_mm(found.starts, found.parameters) < _AGREE_MM
    if bool((~agree).any()):
        rival = found.starts[~agree][found.start_similarity[~agree].argmax()]
        along = _along_the_spine_mm(problem, found.parameters, rival)
        if _VERTEBRA_MM[0] <= abs(along) <= _VERTEBRA_MM[1]:
            where = "up" if along > 0 else "down"
            said.append(f"the next best place is the anatomy {abs(along):.0f} mm further {where}: one vertebra?")
    return tuple(said)


def _along_the_spine_mm(problem: Problem, parameters: Float[Tensor, "9"], rival: Float[Tensor, "9"]) -> float:
    """How far along the patient's axis another answer moves the image (up is positive), 0 if it does more than that."""
    place = problem.radiograph.detector, problem.view, problem.attenuating.origin_patient_mm
    here, there = (project(pixel_from_patient(p, *place), problem.points) for p in (parameters, rival))
    above = problem.points + torch.tensor([0.0, 0.0, 10.0], dtype=torch.float64)
    up = (project(pixel_from_patient(parameters, *place), above) - here).nanmean(0) / 10
    shift = there - here
    mean = shift.nanmean(0)
    along = float(mean @ up / (up @ up))
    rest = (shift - along * up).norm(dim=1).nanmean()
    return along if float(rest) < 0.5 * float(mean.norm()) else 0.0
