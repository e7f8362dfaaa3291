"""Evidence is measured from starts; rules judge it, and tell every rule that is broken."""

import math
from dataclasses import replace

import pytest
import torch

from regtorch.registration.trust import LIMITS, RULES, Evidence, judge
from regtorch.registration.trust.evidence import convincing, measure
from regtorch.registration.trust.rules import WARNINGS, warnings

ALL, PATIENT = list(range(9)), [3, 4, 5, 6, 7, 8]

GOOD = Evidence(
    comparable=True, similarity=0.6, best_start=0.5, starts=6, agreeing=4, gap=0.2, runner_up_mm=80.0,
    mirrored=0.2, gain=1.5, expected_mm=0.3, released_mm=None, sdd_deviation=0.001, frozen=(), at_limit=(), looks=1,
)  # fmt: skip

BROKEN = {
    "no_match": {"best_start": 0.049, "mirrored": -0.1},
    "other_similarity": {"comparable": False},
    "mirrored_better": {"mirrored": 0.51},
    "at_limit": {"at_limit": ("z_s", "theta")},
    "mirrored_close": {"best_start": 0.39, "mirrored": 0.35},
    "found_once": {"agreeing": 1},
    "rivalled": {"gap": 0.049},
    "frozen_wrong": {"expected_mm": 3.1, "released_mm": 3.0, "frozen": ("x_s", "y_s")},
    "uncertain": {"expected_mm": 3.1},
    "unexplained": {"gain": 1.19},
}
"""The least that breaks each rule."""

HELD = {
    "no_match": {"best_start": 0.05, "mirrored": -0.1},
    "mirrored_better": {"mirrored": 0.5},
    "mirrored_close": {"best_start": 0.4, "mirrored": 0.39},
    "found_once": {"agreeing": 2},
    "rivalled": {"gap": 0.05},
    "frozen_wrong": {"expected_mm": 3.0, "released_mm": 3.0},
    "uncertain": {"expected_mm": 3.0},
    "unexplained": {"gain": 1.2},
}
"""The most that each rule lets pass."""


def _codes(evidence: Evidence) -> list[str]:
    return [reason.code for reason in judge(evidence)[2]]


def _found(pair, free, starts_at, start_similarity, **options):
    """Evidence for starts that ended ``starts_at`` mm (x_obj) beside the answer."""
    problem = pair.problem(free)
    starts = pair.initial.repeat(len(starts_at), 1)
    starts[:, 3] += torch.tensor(starts_at, dtype=torch.float64)
    similarity = torch.tensor(start_similarity, dtype=torch.float64)
    return measure(problem, pair.initial, 0.6, starts, similarity, comparable=True, **options)


def test_there_is_a_case_for_every_rule():
    assert list(BROKEN) == [rule.code for rule in RULES]


@pytest.mark.parametrize("code", BROKEN)
def test_each_rule_is_broken_alone(code):
    status, message, reasons = judge(replace(GOOD, **BROKEN[code]))
    assert [reason.code for reason in reasons] == [code]
    assert status == ("failed" if code == "no_match" else "doubtful")
    assert message == reasons[0].sentence
    assert "{" not in message


@pytest.mark.parametrize("code", HELD)
def test_each_limit_lets_its_own_value_pass(code):
    assert judge(replace(GOOD, **HELD[code]))[0] == "ok"


@pytest.mark.parametrize("name", ["mirrored", "gap", "gain", "expected_mm", "runner_up_mm", "sdd_deviation"])
def test_a_number_that_was_not_measured_breaks_nothing(name):
    evidence = replace(GOOD, **{name: None}, **({"agreeing": 6} if name == "gap" else {}))
    assert judge(evidence)[0] == "ok"
    assert warnings(evidence) == ()


def test_every_broken_rule_is_told():
    evidence = replace(GOOD, at_limit=("z_s", "theta"), agreeing=1, gap=0.01, gain=1.1)
    status, message, reasons = judge(evidence)
    assert status == "doubtful"
    assert [reason.code for reason in reasons] == ["at_limit", "found_once", "rivalled", "unexplained"]
    assert message.startswith("z_s, theta at the limit")
    assert "1.10 times" in reasons[-1].sentence


@pytest.mark.parametrize("similarity", [0.0, -1.0, -math.inf, math.nan])
def test_failed_where_nothing_matches(similarity):
    assert judge(replace(GOOD, best_start=similarity))[0] == "failed"
    assert judge(replace(GOOD, similarity=math.nan))[0] == "failed"


@pytest.mark.parametrize("expected_mm", [math.nan, math.inf])
def test_an_error_that_is_no_number_is_uncertain(expected_mm):
    assert "uncertain" in _codes(replace(GOOD, expected_mm=expected_mm))


def test_what_is_frozen_is_blamed_where_its_release_moves_most():
    message = judge(replace(GOOD, **BROKEN["frozen_wrong"]))[1]
    assert message.startswith("x_s, y_s may be wrong: by how the others move once these are free, an error of 3.1 mm")
    assert _codes(replace(GOOD, expected_mm=3.1, released_mm=2.0)) == ["uncertain"]


def test_ok_says_how_many_agree_and_by_how_much():
    assert judge(GOOD)[1] == "4 of 6 starts agree, the runner-up is 0.20 less similar"
    assert judge(replace(GOOD, agreeing=6, gap=None))[1] == "all 6 starts agree"


def test_warnings_of_the_flat_direction_and_of_a_runner_up_one_vertebra_off():
    assert warnings(GOOD) == ()
    assert "SDD +- 6.0%" in warnings(replace(GOOD, sdd_deviation=0.06))[0]
    assert "-30 mm along the body axis" in warnings(replace(GOOD, runner_up_mm=-30.0))[0]
    assert {rule.status for rule in WARNINGS} == {"ok"}


def test_evidence_counts_starts_and_their_runner_up(pair):
    evidence = _found(pair, ALL, [0, 1, 40], [0.5, 0.49, 0.3])
    assert (evidence.starts, evidence.agreeing, evidence.best_start) == (3, 2, 0.5)
    assert evidence.gap == pytest.approx(0.2)
    assert evidence.runner_up_mm == 0
    assert _found(pair, ALL, [0, 1, 2], [0.5, 0.5, 0.5]).gap is None
    nowhere = _found(pair, ALL, [30, 40], [0.5, 0.2])
    assert (nowhere.agreeing, nowhere.gap) == (0, None)


def test_a_runner_up_along_the_body_is_measured(pair):
    problem = pair.problem(ALL)
    starts = pair.initial.repeat(2, 1)
    starts[1, 4] += 30
    similarity = torch.tensor([0.5, 0.4], dtype=torch.float64)
    arguments = problem, pair.initial, 0.5, starts, similarity
    assert measure(*arguments, comparable=True).runner_up_mm == pytest.approx(30, rel=0.01)
    starts[1, 3] += 60
    assert measure(*arguments, comparable=True).runner_up_mm == 0


def test_limits_of_the_range_are_named(pair):
    problem = pair.problem(ALL)
    answer = pair.initial.clone()
    answer[2], answer[7] = problem.searched.upper[2], problem.searched.lower[7] + 1e-5
    similarity = torch.tensor([0.5], dtype=torch.float64)
    evidence = measure(problem, answer, 0.5, answer[None], similarity, comparable=True)
    assert evidence.at_limit == ("z_s", "theta")
    frozen = _found(pair, PATIENT, [0, 0], [0.5, 0.5])
    assert frozen.at_limit == ()
    assert frozen.frozen == ("x_s", "y_s", "z_s")


def test_expected_and_released_errors_are_those_of_the_points(pair):
    spread = torch.zeros(9, 9, dtype=torch.float64)
    spread[3, 3] = 0.25
    moves = torch.zeros(9, dtype=torch.float64)
    moves[3] = 0.5
    evidence = _found(pair, ALL, [0, 0], [0.5, 0.5], covariance=spread, released=moves)
    assert evidence.expected_mm == pytest.approx(evidence.released_mm)
    assert 0.5 < evidence.expected_mm < 0.7
    assert evidence.sdd_deviation == 0
    assert _found(pair, PATIENT, [0, 0], [0.5, 0.5], covariance=spread).sdd_deviation is None


def test_evidence_is_written_as_plain_values():
    told = GOOD.to_dict()
    assert told["frozen"] == []
    assert told["looks"] == 1
    assert set(told) == set(Evidence.__dataclass_fields__)


@pytest.mark.parametrize(
    ("starts_at", "similarity", "enough"),
    [
        ([0, 5, 100], [0.6, 0.5, 0.4], True),
        ([0, 100, 200], [0.6, 0.4, 0.3], False),
        ([0, 5, 100], [0.6, 0.5, 0.58], False),
        ([0, 5], [0.6, 0.5], True),
    ],
    ids=["two agree", "found once", "rival", "all agree"],
)
def test_starts_convince_where_two_agree_and_no_other_place_is_as_good(pair, starts_at, similarity, enough):
    starts = pair.initial.repeat(len(starts_at), 1)
    starts[:, 3] += torch.tensor(starts_at, dtype=torch.float64)
    similarity, order = torch.tensor(similarity, dtype=torch.float64).sort(descending=True)
    assert convincing(pair.problem(ALL), starts[order], similarity) is enough


def test_starts_that_agree_on_a_limit_of_the_range_do_not_convince(pair):
    problem = pair.problem(ALL)
    starts = pair.initial.repeat(2, 1)
    similarity = torch.tensor([0.6, 0.5], dtype=torch.float64)
    assert convincing(problem, starts, similarity)
    starts[:, 0] = problem.searched.upper[0]
    assert not convincing(problem, starts, similarity)


def test_limits_are_sane():
    assert LIMITS.least_gain < LIMITS.unsure_gain
    assert LIMITS.least_similarity < LIMITS.strong_similarity
