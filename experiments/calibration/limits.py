"""How far each limit may move, and what each rule is worth, by the cases of studies."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import pandas as pd

from experiments.calibration.cases import Case
from regtorch.registration import Evidence
from regtorch.registration.trust import LIMITS, RULES, Limits, judge


@dataclass(frozen=True)
class Judged:
    """A limit of the verdict, and the number of the evidence that it bounds."""

    limit: str
    number: Callable[[Evidence], float | None]
    text: str


def _over_mirrored(evidence: Evidence) -> float | None:
    return None if evidence.mirrored is None else evidence.best_start - evidence.mirrored


JUDGED = (
    Judged("least_similarity", lambda e: e.best_start, "best start's similarity"),
    Judged("strong_similarity", lambda e: e.best_start, "best start's similarity"),
    Judged("least_over_mirrored", _over_mirrored, "best start over the mirrored one"),
    Judged("least_gap", lambda e: e.gap, "gap to the runner-up"),
    Judged("least_gain", lambda e: e.gain, "gain by robust weights"),
    Judged("most_expected_mm", lambda e: e.expected_mm, "expected error (mm)"),
)
"""The limits that one number decides."""


def verdicts(cases: Sequence[Case], limits: Limits = LIMITS, without: str | None = None) -> tuple[int, int]:
    """How many wrong cases are ``ok``, and how many right ones are not; ``without`` leaves a rule out."""
    wrong_ok = right_doubted = 0
    for case in cases:
        trusted = not any(reason.code != without for reason in judge(case.evidence, limits)[2])
        wrong_ok += case.right is False and trusted
        right_doubted += case.right is True and not trusted
    return wrong_ok, right_doubted


def limits_table(cases: Sequence[Case]) -> pd.DataFrame:
    """One row per limit: its value, and the interval of values that are as good by these cases.

    ``low`` and ``high`` are the ends of the best values around the limit: no more wrong cases are ``ok``, and then no
    more right ones are doubted. They are missing where no case bounds the limit. ``right`` and ``wrong`` count the
    cases with the number.
    """
    rows = []
    for judged in JUDGED:
        measured = [(judged.number(case.evidence), case.right) for case in cases if case.right is not None]
        known = [(value, right) for value, right in measured if value is not None]
        low, high, best = _interval(cases, judged.limit, [value for value, _ in known])
        rows.append(
            {
                "limit": judged.limit,
                "value": getattr(LIMITS, judged.limit),
                "low": low,
                "high": high,
                "right": sum(right for _, right in known),
                "wrong": sum(not right for _, right in known),
                "wrong_ok": best[0],
                "right_doubted": best[1],
            }
        )
    return pd.DataFrame(rows)


def rules_table(cases: Sequence[Case]) -> pd.DataFrame:
    """One row per rule: the cases that break it, those that break no other, and the verdicts without it."""
    broken = [(case, {reason.code for reason in judge(case.evidence)[2]}) for case in cases if case.right is not None]
    rows = []
    for rule in RULES:
        alone = [case.right for case, codes in broken if codes == {rule.code}]
        breaks = [case.right for case, codes in broken if rule.code in codes]
        rows.append(
            {
                "rule": rule.code,
                "wrong": sum(not right for right in breaks),
                "right": sum(breaks),
                "wrong_alone": sum(not right for right in alone),
                "right_alone": sum(alone),
            }
        )
    return pd.DataFrame(rows)


def _interval(
    cases: Sequence[Case], name: str, measured: list[float]
) -> tuple[float | None, float | None, tuple[int, int]]:
    """The best values of a limit about its own, among those between and beyond the measured numbers."""
    here = getattr(LIMITS, name)
    values = sorted(set(measured))
    between = [(low + high) / 2 for low, high in pairwise(values)]
    tried = sorted({here, *between})
    scores = {value: verdicts(cases, replace(LIMITS, **{name: value})) for value in tried}
    best = min(scores.values())
    if scores[here] != best:
        good = [value for value in tried if scores[value] == best]
        return good[0], good[-1], best
    at = tried.index(here)
    low = next((value for value in reversed(tried[:at]) if scores[value] != best), None)
    high = next((value for value in tried[at:] if scores[value] != best), None)
    return low, high, best
