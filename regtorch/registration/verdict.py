"""How far a result can be trusted, from what the search itself has seen."""

from regtorch.geometry import KEYS
from regtorch.registration.problem import Found, Problem
from regtorch.registration.result import Status

_AGREE_MM = 10.0
"""Starts that project the anatomy this close to each other have found the same place on the first level."""

_LEAST_SIMILARITY = 0.05
"""Gradient correlation of unrelated images is about 0.01, that of bone alone with a whole radiograph 0.2 to 0.5."""

_LEAST_GAP = 0.02
"""How much better than the next best place the answer must be on the first level."""


def judge(problem: Problem, found: Found) -> tuple[Status, str]:
    """``failed`` where nothing matches; ``doubtful`` where the answer is at a limit, found once, or has a rival."""
    if not found.similarity >= _LEAST_SIMILARITY:
        return "failed", f"similarity {found.similarity:.3f} at best: the images do not match anywhere in the range"
    values, lower, upper = found.parameters[problem.free], problem.lower, problem.upper
    margin = 1e-3 * (upper - lower)
    at_limit = ((values - lower < margin) | (upper - values < margin)).nonzero().flatten().tolist()
    if at_limit:
        names = ", ".join(KEYS[problem.free[i]].rsplit("_", 1)[0] for i in at_limit)
        return "doubtful", f"{names} at the limit of the range searched: the answer may lie beyond"
    agree = problem.shift_mm(found.starts, found.parameters) < _AGREE_MM
    count, total = int(agree.sum()), len(agree)
    if total == 1:
        return "doubtful", "found from the only start: nothing else confirms it"
    if count < 2:
        return "doubtful", f"only {count} of {total} starts ended here: another place may match as well"
    if count == total:
        return "ok", f"all {total} starts agree"
    gap = float(found.start_similarity[agree].max() - found.start_similarity[~agree].max())
    if gap < _LEAST_GAP:
        return "doubtful", f"another place matches as well to within {gap:.3f} of similarity"
    return "ok", f"{count} of {total} starts agree, the next best place is {gap:.2f} lower in similarity"
