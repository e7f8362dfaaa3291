"""How far a result can be trusted, from what the search saw."""

import math
from dataclasses import replace

import pytest
import torch

from regtorch.registration.problem import Found
from regtorch.registration.verdict import convincing, judge, warnings
from regtorch.similarity import normalized_mutual_information

ALL, PATIENT = list(range(9)), [3, 4, 5, 6, 7, 8]


def _found(pair, starts_at: list[float], start_similarity: list[float], similarity: float = 0.5, **moved) -> Found:
    """Starts that ended ``starts_at`` mm (x_obj) beside the answer."""
    answer = pair.initial.clone()
    for index, value in moved.items():
        answer[int(index[1:])] = value
    starts = answer.repeat(len(starts_at), 1)
    starts[:, 3] += torch.tensor(starts_at, dtype=torch.float64)
    return Found(answer, similarity, starts, torch.tensor(start_similarity, dtype=torch.float64), 1000)


@pytest.mark.parametrize("similarity", [0.049, 0.0, -1.0, -math.inf, math.nan])
def test_failed_where_nothing_matches(pair, similarity):
    status, message = judge(pair.problem(ALL), _found(pair, [0, 0], [similarity, -1]))
    assert status == "failed"
    assert "do not match" in message


def test_failed_where_the_similarity_is_no_number(pair):
    assert judge(pair.problem(ALL), _found(pair, [0, 0], [0.5, 0.5], math.nan))[0] == "failed"


def test_other_similarities_are_not_judged(pair):
    problem = pair.problem(ALL, similarity=normalized_mutual_information)
    status, message = judge(problem, _found(pair, [0, 0], [1.5, 1.5]))
    assert status == "doubtful"
    assert "gradient correlation alone" in message


def test_doubtful_where_even_the_best_start_is_weak(pair):
    found = _found(pair, [0, 0], [0.2, 0.2])
    assert judge(pair.problem(ALL), found)[0] == "ok"
    weak = replace(found, weak_similarity=0.3)
    status, message = judge(pair.problem(ALL), replace(weak, similarity=0.25))
    assert status == "doubtful"
    assert "too weak" in message
    assert judge(pair.problem(ALL), replace(weak, similarity=0.35))[0] == "ok"


@pytest.mark.parametrize(
    ("best", "mirrored", "status", "message"),
    [
        (0.5, 0.51, "doubtful", "mirrored, the radiograph matches better (similarity 0.51 instead of 0.50)"),
        (0.5, 0.49, "ok", "agree"),
        (0.3, 0.25, "doubtful", "mirrored, the radiograph matches nearly as well (similarity 0.25 instead of 0.30)"),
        (0.3, 0.23, "ok", "agree"),
        (0.3, -1.0, "ok", "agree"),
    ],
)
def test_an_image_that_fits_nowhere_is_what_a_weak_match_must_excel(pair, best, mirrored, status, message):
    found = replace(_found(pair, [0, 0], [best, best]), mirrored_similarity=mirrored)
    told = judge(pair.problem(ALL), found)
    assert told[0] == status
    assert message in told[1]


def test_doubtful_where_the_image_disagrees_with_itself(pair):
    found = replace(_found(pair, [0, 0], [0.5, 0.5]), covariance=torch.eye(9, dtype=torch.float64))
    assert judge(pair.problem(ALL), replace(found, covariance=1e-6 * found.covariance))[0] == "ok"
    status, message = judge(pair.problem(ALL), found)
    assert status == "doubtful"
    assert "parts of the image disagree" in message


def test_doubtful_where_what_is_frozen_seems_wrong(pair):
    moves = torch.zeros(9, dtype=torch.float64)
    moves[0], moves[3] = 30, -5  # mm: of source and patient
    found = replace(_found(pair, [0, 0], [0.5, 0.5]), covariance=moves.outer(moves), released=moves)
    status, message = judge(pair.problem(PATIENT), found)
    assert status == "doubtful"
    assert message.startswith("x_s, y_s, z_s may be wrong: by how the others move once these are free, an error of ")
    spread = 100 * torch.eye(9, dtype=torch.float64)
    assert "parts of the image" in judge(pair.problem(PATIENT), replace(found, covariance=spread))[1]
    assert judge(pair.problem(PATIENT), replace(found, covariance=moves.outer(moves) / 1e4))[0] == "ok"


def test_doubtful_where_what_bone_does_not_explain_is_everywhere(pair):
    found = _found(pair, [0, 0], [0.5, 0.5])
    assert judge(pair.problem(ALL), replace(found, gain=1.3))[0] == "ok"
    status, message = judge(pair.problem(ALL), replace(found, gain=1.1))
    assert status == "doubtful"
    assert "everywhere" in message
    assert "1.10 times" in message


def test_warns_of_the_flat_direction_and_of_a_runner_up_one_vertebra_off(pair):
    problem = pair.problem(ALL)
    spread = torch.zeros(9, 9, dtype=torch.float64)
    found = replace(_found(pair, [0, 0], [0.5, 0.4]), covariance=spread)
    assert warnings(problem, found) == ()
    spread[2, 2] = 60**2
    assert "SDD +- 60 mm" in warnings(problem, replace(found, covariance=spread))[0]
    starts = found.starts.clone()
    starts[1, 4] += 30  # mm up
    (warning,) = warnings(problem, replace(found, covariance=None, starts=starts))
    assert "30 mm further up: one vertebra?" in warning
    starts[1, 3] += 60
    assert warnings(problem, replace(found, covariance=None, starts=starts)) == ()


def test_doubtful_at_the_limit_of_the_range(pair):
    problem = pair.problem(ALL)
    found = _found(pair, [0, 0], [0.5, 0.5], p2=float(problem.upper[2]), p7=float(problem.lower[7]) + 1e-5)
    status, message = judge(problem, found)
    assert status == "doubtful"
    assert message.startswith("z_s, theta at the limit")


def test_a_frozen_parameter_is_at_no_limit(pair):
    problem = pair.problem(PATIENT)
    assert judge(problem, _found(pair, [0, 0], [0.5, 0.5]))[0] == "ok"
    assert judge(problem, _found(pair, [0, 0], [0.5, 0.5], p4=float(problem.lower[1])))[1].startswith("y_obj at the")


def test_doubtful_where_only_one_start_found_it(pair):
    status, message = judge(pair.problem(ALL), _found(pair, [0, 40, 80], [0.5, 0.2, 0.1]))
    assert (status, message[:21]) == ("doubtful", "only 1 of 3 starts en")
    assert judge(pair.problem(ALL), _found(pair, [30, 40, 80], [0.5, 0.2, 0.1]))[1].startswith("only 0 of 3")


def test_doubtful_where_another_place_matches_as_well(pair):
    status, message = judge(pair.problem(ALL), _found(pair, [0, 1, 40], [0.5, 0.49, 0.485]))
    assert status == "doubtful"
    assert message == "another place matches as well to within 0.015 of similarity"
    assert judge(pair.problem(ALL), _found(pair, [40, 0, 1], [0.6, 0.5, 0.5]))[0] == "doubtful"


def test_ok_says_how_many_agree_and_by_how_much(pair):
    status, message = judge(pair.problem(ALL), _found(pair, [0, 1, 40], [0.5, 0.49, 0.3]))
    assert (status, message) == ("ok", "2 of 3 starts agree, the next best place is 0.20 lower in similarity")
    assert judge(pair.problem(ALL), _found(pair, [0, 1, 2], [0.5, 0.5, 0.5])) == ("ok", "all 3 starts agree")


def test_a_single_start_is_doubtful_as_nothing_confirms_it(pair):
    status, message = judge(pair.problem(ALL), _found(pair, [40], [0.5]))
    assert status == "doubtful"
    assert "the only start" in message


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
    found = _found(pair, starts_at, similarity)
    order = found.start_similarity.argsort(descending=True)
    assert convincing(pair.problem(ALL), found.starts[order], found.start_similarity[order]) is enough


def test_starts_that_agree_on_a_limit_of_the_range_do_not_convince(pair):
    problem = pair.problem(ALL)
    found = _found(pair, [0, 5], [0.6, 0.5])
    assert convincing(problem, found.starts, found.start_similarity)
    found.starts[:, 0] = problem.upper[0]
    assert not convincing(problem, found.starts, found.start_similarity)
