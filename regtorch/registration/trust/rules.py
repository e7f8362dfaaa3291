"""The rules that judge evidence: each has a code, a status, a condition and a sentence; all broken ones are told."""

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Literal

from regtorch.registration.trust.evidence import Evidence
from regtorch.registration.trust.limits import LIMITS, Limits

Status = Literal["ok", "doubtful", "failed"]


@dataclass(frozen=True)
class Rule:
    """``broken`` tells it from evidence and limits; ``sentence`` is filled in with the evidence's fields."""

    code: str
    status: Status
    broken: Callable[[Evidence, Limits], bool]
    sentence: str


@dataclass(frozen=True)
class Reason:
    """A rule that a result has broken."""

    code: str
    status: Status
    sentence: str


def _uncertain(e: Evidence, limits: Limits) -> bool:
    return e.expected_mm is not None and not e.expected_mm <= limits.most_expected_mm


def _frozen_wrong(e: Evidence) -> bool:
    """Whether the move once frozen parameters are free makes more than half of the expected variance."""
    if e.released_mm is None or e.expected_mm is None:
        return False
    return e.released_mm**2 > e.expected_mm**2 / 2


RULES = (
    Rule(
        "no_match",
        "failed",
        lambda e, limits: not (e.best_start >= limits.least_similarity and math.isfinite(e.similarity)),
        "similarity {best_start:.3f} at best: the images do not match anywhere in the range",
    ),
    Rule(
        "other_similarity",
        "doubtful",
        lambda e, limits: not e.comparable,
        "how good a match is can be told of gradient correlation alone",
    ),
    Rule(
        "mirrored_better",
        "doubtful",
        lambda e, limits: e.mirrored is not None and e.mirrored > e.best_start,
        "mirrored, the radiograph matches better (similarity {mirrored:.2f} instead of {best_start:.2f}): "
        "it may show the other side",
    ),
    Rule(
        "at_limit",
        "doubtful",
        lambda e, limits: bool(e.at_limit),
        "{at_limit} at the limit of the range searched: the answer may lie beyond",
    ),
    Rule(
        "behind_detector",
        "doubtful",
        lambda e, limits: e.behind_mm is not None and e.behind_mm > limits.most_behind_mm,
        "anatomy {behind_mm:.0f} mm behind the detector: pixel size, SDD or place must be wrong",
    ),
    Rule(
        "mirrored_close",
        "doubtful",
        lambda e, limits: (
            e.mirrored is not None
            and e.best_start < limits.strong_similarity
            and e.best_start - limits.least_over_mirrored < e.mirrored <= e.best_start
        ),
        "mirrored, the radiograph matches nearly as well (similarity {mirrored:.2f} instead of {best_start:.2f}): "
        "it may show another anatomy",
    ),
    Rule(
        "found_once",
        "doubtful",
        lambda e, limits: e.agreeing < limits.least_agreeing,
        "{agreeing} of {starts} starts ended here: nothing else confirms it, another place may match as well",
    ),
    Rule(
        "rivalled",
        "doubtful",
        lambda e, limits: e.gap is not None and e.gap < limits.least_gap,
        "another place matches as well to within {gap:.3f} of similarity",
    ),
    Rule(
        "frozen_wrong",
        "doubtful",
        lambda e, limits: _uncertain(e, limits) and _frozen_wrong(e),
        "{frozen} may be wrong: by how the others move once these are free, an error of {expected_mm:.1f} mm in the "
        "image is expected",
    ),
    Rule(
        "uncertain",
        "doubtful",
        lambda e, limits: _uncertain(e, limits) and not _frozen_wrong(e),
        "parts of the image disagree: an error of {expected_mm:.1f} mm in the image is expected",
    ),
    Rule(
        "unexplained",
        "doubtful",
        lambda e, limits: e.gain is not None and e.gain < limits.least_gain,
        "the residual is everywhere (robust weights make bone only {gain:.2f} times as similar): "
        "bone may lie elsewhere",
    ),
)
"""In the order in which they are told."""

WARNINGS = (
    Rule(
        "flat_sdd",
        "ok",
        lambda e, limits: e.sdd_deviation is not None and not e.sdd_deviation <= limits.most_sdd_deviation,
        "SDD and ODD can hardly be told apart: SDD +- {sdd_deviation:.1%}, and the patient with it",
    ),
    Rule(
        "runner_up_vertebra",
        "ok",
        lambda e, limits: (
            e.runner_up_mm is not None and limits.vertebra_mm[0] <= abs(e.runner_up_mm) <= limits.vertebra_mm[1]
        ),
        "the runner-up is the anatomy {runner_up_mm:+.0f} mm along the body axis (up is positive): one vertebra?",
    ),
)
"""Rules that leave the status as it is."""


def judge(evidence: Evidence, limits: Limits = LIMITS) -> tuple[Status, str, tuple[Reason, ...]]:
    """Status, the first sentence to tell, and every broken rule in the order of ``RULES``."""
    reasons = _broken(RULES, evidence, limits)
    if reasons:
        status = "failed" if any(reason.status == "failed" for reason in reasons) else "doubtful"
        return status, reasons[0].sentence, reasons
    if evidence.agreeing == evidence.starts:
        return "ok", f"all {evidence.starts} starts agree", ()
    return (
        "ok",
        f"{evidence.agreeing} of {evidence.starts} starts agree, the runner-up is {evidence.gap:.2f} less similar",
        (),
    )


def warnings(evidence: Evidence, limits: Limits = LIMITS) -> tuple[str, ...]:
    """One line each, besides the verdict: the flat direction of SDD and ODD, and a runner-up one vertebra off."""
    return tuple(reason.sentence for reason in _broken(WARNINGS, evidence, limits))


def _broken(rules: tuple[Rule, ...], evidence: Evidence, limits: Limits) -> tuple[Reason, ...]:
    facts = asdict(evidence) | {name: ", ".join(getattr(evidence, name)) for name in ("frozen", "at_limit")}
    return tuple(
        Reason(rule.code, rule.status, rule.sentence.format(**facts)) for rule in rules if rule.broken(evidence, limits)
    )
