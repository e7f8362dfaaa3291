"""Evidence is measured from starts; the rules judge it and report every broken rule."""

import csv
import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest
import torch

from regtorch.geometry import world_from_ct
from regtorch.phantom import make_phantom
from regtorch.registration.trust import LIMITS, RULES, Evidence, judge
from regtorch.registration.trust.evidence import convincing, measure
from regtorch.registration.trust.rules import WARNINGS, warnings

ALL, PATIENT = list(range(9)), [3, 4, 5, 6, 7, 8]

GOOD = Evidence(
    comparable=True, similarity=0.6, best_start=0.5, starts=6, agreeing=4, gap=0.2, runner_up_mm=80.0,
    mirrored=0.2, gain=1.5, expected_mm=0.3, released_mm=None, sdd_deviation=0.001, frozen=(), at_limit=(), looks=1,
)  # fmt: skip

CLOSE = 1e-6
"""So near to a limit, on either side."""

BROKEN = {
    "no_match": {"best_start": LIMITS.least_similarity - CLOSE, "mirrored": -0.1},
    "other_similarity": {"comparable": False},
    "mirrored_better": {"mirrored": GOOD.best_start + CLOSE},
    "at_limit": {"at_limit": ("z_s", "theta")},
    "behind_detector": {"behind_mm": LIMITS.most_behind_mm + CLOSE},
    "mirrored_close": {
        "best_start": LIMITS.strong_similarity - CLOSE,
        "mirrored": LIMITS.strong_similarity - LIMITS.least_over_mirrored,
    },
    "found_once": {"agreeing": LIMITS.least_agreeing - 1},
    "rivalled": {"gap": LIMITS.least_gap - CLOSE},
    "frozen_wrong": {
        "expected_mm": LIMITS.most_expected_mm + CLOSE,
        "released_mm": (LIMITS.most_expected_mm + 2 * CLOSE) / 2**0.5,
        "frozen": ("x_s", "y_s"),
    },
    "uncertain": {
        "expected_mm": LIMITS.most_expected_mm + CLOSE,
        "released_mm": LIMITS.most_expected_mm / 2**0.5,
    },
    "unexplained": {"gain": LIMITS.least_gain - CLOSE},
}
"""The least that breaks each rule."""

HELD = {
    "no_match": {"best_start": LIMITS.least_similarity, "mirrored": -0.1},
    "mirrored_better": {"mirrored": GOOD.best_start},
    "strong": {"best_start": LIMITS.strong_similarity, "mirrored": LIMITS.strong_similarity - CLOSE},
    "mirrored_close": {
        "best_start": LIMITS.strong_similarity - CLOSE,
        "mirrored": LIMITS.strong_similarity - LIMITS.least_over_mirrored - 2 * CLOSE,
    },
    "found_once": {"agreeing": LIMITS.least_agreeing},
    "rivalled": {"gap": LIMITS.least_gap},
    "frozen_wrong": {"expected_mm": LIMITS.most_expected_mm, "released_mm": LIMITS.most_expected_mm},
    "uncertain": {"expected_mm": LIMITS.most_expected_mm},
    "unexplained": {"gain": LIMITS.least_gain},
}
"""The most that each rule lets pass."""


def _codes(evidence: Evidence) -> list[str]:
    return [reason.code for reason in judge(evidence)[2]]


def _found(pair, free, starts_at, start_similarity, **options):
    """Evidence from starts that ended ``starts_at`` mm (along x_obj) away from the answer."""
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


@pytest.mark.parametrize(
    "name", ["mirrored", "gap", "gain", "expected_mm", "runner_up_mm", "sdd_deviation", "behind_mm"]
)
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
    message = judge(replace(GOOD, **BROKEN["frozen_wrong"] | {"expected_mm": 987.6, "released_mm": 987.0}))[1]
    assert message.startswith("x_s, y_s may be wrong: by how the others move once these are free, an error of 987.6 mm")


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


def test_anatomy_behind_the_detector_is_measured_by_its_deepest_point(pair):
    problem = pair.problem(ALL)
    answer, similarity = pair.initial.clone(), torch.tensor([0.5], dtype=torch.float64)

    def behind_mm():
        return measure(problem, answer, 0.5, answer[None], similarity, comparable=True).behind_mm

    assert behind_mm() == 0
    answer[5] -= 1000
    far = behind_mm()
    answer[5] -= 25
    assert behind_mm() == pytest.approx(far + 25)
    answer[5:] = 0
    assert problem.view == "PA"
    to_the_back = problem.points[:, 1] - problem.attenuating.origin_patient_mm[1]
    assert behind_mm() == pytest.approx(-float(to_the_back.min()))


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


def _at(pair, share: float, limits=LIMITS):
    """Evidence of two starts, one of them ``share`` of the limit away. Shifts along x_obj move the image in proportion.

    The shift in the image is worked out from the heights of the points: z_s / (z_s - z).
    """
    problem = pair.problem(ALL)
    world = world_from_ct(pair.initial, "PA")
    height = ((problem.points - pair.ct.origin_patient_mm) @ world[:3, :3].mT + world[:3, 3])[:, 2]
    magnification = float((pair.initial[2] / (pair.initial[2] - height)).mean())
    return _found(pair, ALL, [0, share * limits.agree_mm / magnification], [0.5, 0.4], limits=limits)


@pytest.mark.parametrize("limits", [LIMITS, replace(LIMITS, agree_mm=5.0)], ids=["as set", "5 mm"])
def test_starts_agree_up_to_the_limit_in_the_detector_plane(pair, limits):
    assert _at(pair, 0.999, limits).agreeing == 2
    assert _at(pair, 1.001, limits).agreeing == 1


def test_a_thoracic_vertebra_away_is_another_place(pair):
    """Starts that far apart name other vertebrae, so they must not confirm each other; wrong by 5 mm they still do."""
    _, targets = make_phantom(6.0)
    vertebra_mm = math.dist(targets["T1"], targets["T12"]) / 11
    problem = pair.problem(ALL)
    one_up, near = pair.initial.clone(), pair.initial.clone()
    one_up[4] += vertebra_mm
    near[4] += 5
    assert float(problem.shift_mm(pair.initial, one_up)) > LIMITS.agree_mm > float(problem.shift_mm(pair.initial, near))


def test_convincing_takes_the_limits_own_values(pair):
    starts = pair.initial.repeat(3, 1)
    starts[2, 3] += 200
    clear = torch.tensor([0.6, 0.6, 0.6 - LIMITS.least_gap - CLOSE], dtype=torch.float64)
    assert convincing(pair.problem(ALL), starts, clear)
    clear[2] += 2 * CLOSE
    assert not convincing(pair.problem(ALL), starts, clear)
    assert not convincing(pair.problem(ALL), starts, clear - CLOSE, replace(LIMITS, least_agreeing=3))
    exact = torch.tensor([0.75, 0.75, 0.5], dtype=torch.float64)
    assert convincing(pair.problem(ALL), starts, exact, replace(LIMITS, least_gap=0.25))


def test_the_spread_of_the_sdd_is_told_where_it_and_the_patients_distance_are_free(pair):
    spread = torch.diag(torch.tensor([0, 0, 16.0, 0, 0, 1, 0, 0, 0], dtype=torch.float64))
    for free, told in (([2, 5], True), (ALL, True), ([2, 3], False), ([3, 5], False)):
        deviation = _found(pair, free, [0, 0], [0.5, 0.5], covariance=spread).sdd_deviation
        assert deviation == (pytest.approx(4 / float(pair.initial[2])) if told else None)


def test_a_vertebras_shift_warns_between_its_limits_and_an_sdd_beyond_its_own():
    low, high = LIMITS.vertebra_mm
    for shift, told in ((low, 1), (high, 1), (-low, 1), (low - CLOSE, 0), (high + CLOSE, 0)):
        assert len(warnings(replace(GOOD, runner_up_mm=shift))) == told
    for deviation, told in ((LIMITS.most_sdd_deviation, 0), (LIMITS.most_sdd_deviation + CLOSE, 1)):
        assert len(warnings(replace(GOOD, sdd_deviation=deviation))) == told


def test_limits_are_those_of_the_committed_calibration():
    """Its table says which limits the studies' cases were judged by; ``experiments.calibration`` writes it."""
    with (Path(__file__).parents[2] / "results" / "calibration" / "limits.csv").open(encoding="utf-8") as file:
        table = {row["limit"]: float(row["value"]) for row in csv.DictReader(file)}
    assert {"most_expected_mm", "least_gain", "least_gap"} <= set(table)
    assert table == {name: getattr(LIMITS, name) for name in table}


def test_limits_are_sane():
    assert LIMITS.least_gain < LIMITS.unsure_gain
    assert 0 < LIMITS.least_similarity < LIMITS.strong_similarity < LIMITS.clear_similarity < 1


def test_a_shift_of_one_vertebra_is_one_of_the_phantoms_smallest_to_its_largest(pair):
    """In the detector plane: from the smallest as it is to the largest magnified. Half and twice are no vertebra."""
    _, targets = make_phantom(6.0)
    spacings = [math.dist(one, other) for one, other in pairwise(targets.values())]
    magnification = float(pair.initial[2] / (pair.initial[2] - pair.initial[5]))
    assert min(spacings) / 2 < LIMITS.vertebra_mm[0] < min(spacings)
    assert max(spacings) * magnification < LIMITS.vertebra_mm[1] < 2 * max(spacings) * magnification
