"""The calibration finds the limits that tell right from wrong, and its committed tables are of today's rules."""

from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from experiments.calibration.cases import Case, read_cases
from experiments.calibration.figure import write
from experiments.calibration.limits import limits_table, rules_table, verdicts
from regtorch.errors import RegtorchError
from regtorch.registration import Evidence
from regtorch.registration.trust import LIMITS, RULES

RESULTS = Path(__file__).parents[3] / "results" / "calibration"
GOOD = Evidence(
    comparable=True, similarity=0.6, best_start=0.5, starts=6, agreeing=4, gap=0.2, runner_up_mm=80.0, mirrored=0.2,
    gain=1.5, expected_mm=0.3, released_mm=None, sdd_deviation=0.001, frozen=(), at_limit=(), looks=1,
)  # fmt: skip


def _case(right: bool, **changes) -> Case:
    return Case("invented", replace(GOOD, **changes), right)


def test_the_committed_tables_are_of_todays_limits_and_rules():
    limits = pd.read_csv(RESULTS / "limits.csv")
    assert {row.limit: row.value for row in limits.itertuples()} == {
        name: getattr(LIMITS, name) for name in limits.limit
    }
    assert list(pd.read_csv(RESULTS / "rules.csv").rule) == [rule.code for rule in RULES]
    assert (limits.wrong_ok == 0).all()


def test_no_committed_wrong_case_is_ok():
    cases = read_cases(sorted(path for path in (RESULTS / "cases").iterdir()))
    assert sum(case.right is False for case in cases) > 150
    assert verdicts(cases)[0] == 0


def test_a_limit_may_lie_between_wrong_and_right_cases():
    cases = [_case(True, gap=gap) for gap in (0.08, 0.2)] + [_case(False, gap=gap) for gap in (0.01, 0.03)]
    row = limits_table(cases).set_index("limit").loc["least_gap"]
    assert (row.low, row.high) == pytest.approx((0.02, 0.14))
    assert (row.right, row.wrong) == (2, 2)


def test_a_limit_that_doubts_right_cases_for_nothing_is_shown():
    row = limits_table([_case(True, gap=0.02), _case(True, gap=0.3), _case(False, gap=0.0)]).set_index("limit")
    assert row.loc["least_gap"].high < LIMITS.least_gap
    assert row.loc["least_gap"].right_doubted == 0


def test_a_rule_is_worth_the_cases_that_it_alone_tells():
    cases = [_case(False, gap=0.0), _case(False, gap=0.0, gain=1.0), _case(True, gain=1.1)]
    table = rules_table(cases).set_index("rule")
    assert table.loc["rivalled"].tolist() == [2, 0, 1, 0]
    assert table.loc["unexplained"].tolist() == [1, 1, 0, 1]
    assert verdicts(cases, without="rivalled") == (1, 1)


def test_rows_without_evidence_are_refused(tmp_path):
    rows = pd.read_csv(next((RESULTS / "cases").glob("search/*.csv")))
    rows.drop(columns="evidence_gap").to_csv(tmp_path / "registrations.csv", index=False)
    with pytest.raises(RegtorchError, match="no column 'evidence_gap'"):
        read_cases([tmp_path])


def test_tables_and_figure_are_written(tmp_path):
    written = write([RESULTS / "cases" / "narrow", RESULTS / "cases" / "narrow_decoys"], tmp_path)
    assert [path.name for path in written] == ["limits.csv", "rules.csv", "table.md", "limits.png"]
    assert "36 registrations of narrow, narrow_decoys" in (tmp_path / "table.md").read_text()
