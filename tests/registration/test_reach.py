"""Default ranges move on from limits that a search ended at; given ones, and the impossible, stay."""

import math
from dataclasses import replace
from itertools import pairwise

import pytest
import torch

from regtorch.registration.found import Found
from regtorch.registration.reach import searched_on
from regtorch.registration.trust.evidence import measure
from regtorch.registration.trust.limits import LIMITS

Z_S, Z_OBJ, PHI = 2, 5, 8


class Sought:
    """A method that ends as near to a place as the range lets it, the more similar the nearer."""

    def __init__(self, place):
        self.place, self.ranges = place, []

    def __call__(self, problem):
        self.ranges.append(problem.searched)
        found = problem.searched.clamped(self.place)
        similarity = 1 / (2 + float((found - self.place).abs().max()) / 1000)
        each = torch.full((2,), similarity, dtype=torch.float64)
        starts = found.repeat(2, 1)
        evidence = measure(problem, found, similarity, starts, each, comparable=True)
        return Found(found, similarity, starts, each, 2, evidence)


def _problem(pair):
    half_range = torch.tensor([75, 75, 150, 150, 150, 150, 0.2, 0.2, 0.2], dtype=torch.float64)
    problem = pair.problem(list(range(9)))
    return replace(problem, searched=replace(problem.searched, half_range=half_range))


def _sought(pair, index, off, given=None):
    problem = _problem(pair)
    place = problem.searched.initial.clone()
    place[index] += off
    method = Sought(place)
    found, told = searched_on(method, problem, given)
    return float(found.parameters[index] - place[index]), told, method.ranges


def test_an_answer_inside_its_range_is_searched_once(pair):
    off, told, ranges = _sought(pair, Z_S, 100)
    assert (off, told, len(ranges)) == (0, [], 1)


@pytest.mark.parametrize(("index", "off"), [(Z_S, 800.0), (Z_S, -300.0), (PHI, 0.5), (PHI, -0.5), (0, -200.0)])
def test_a_default_range_moves_on_until_it_holds_the_answer(pair, index, off):
    missed, told, ranges = _sought(pair, index, off)
    assert missed == 0
    assert 2 <= len(ranges) <= 5
    assert len(told) == 1
    for before, after in pairwise(ranges):
        assert after.lower[index] < before.upper[index]
        assert after.upper[index] > before.lower[index]


def test_a_given_range_is_hard(pair):
    given = torch.full((9,), math.nan, dtype=torch.float64)
    given[Z_S] = 150
    missed, told, ranges = _sought(pair, Z_S, 800.0, given)
    assert (missed, told, len(ranges)) == (-650, [], 1)


@pytest.mark.parametrize(
    ("index", "off", "limit"), [(Z_S, 9000.0, 3000.0), (Z_S, -9000.0, 500.0), (PHI, 2.0, math.pi / 4)]
)
def test_no_range_goes_where_nothing_can_be(pair, index, off, limit):
    missed, _, _ = _sought(pair, index, off)
    assert float(_problem(pair).searched.initial[index]) + off + missed == pytest.approx(limit)


def test_no_range_goes_on_behind_the_detector(pair):
    missed, told, ranges = _sought(pair, Z_OBJ, -2000.0)
    assert (told, len(ranges)) == ([], 1)
    assert missed == 1850


@pytest.mark.parametrize(("worse", "searches"), [(LIMITS.least_gap + 1e-6, 2), (LIMITS.least_gap / 5, 5)])
def test_beyond_a_limit_a_clearly_less_similar_place_does_not_count(pair, worse, searches):
    problem = _problem(pair)
    method = Sought(problem.searched.initial + 1)

    def fading(searched):
        found, best = method(searched), 0.5 - worse * len(method.ranges)
        evidence = replace(found.evidence, at_limit=("z_s",), best_start=best)
        return replace(found, parameters=searched.searched.upper, evidence=evidence)

    found, told = searched_on(fading, problem, None)
    assert len(method.ranges) == searches
    assert bool(told) is (searches == 5)
    last = method.ranges[-1] if told else method.ranges[0]
    assert float(found.parameters[Z_S]) == float(last.upper[Z_S])


def test_no_range_moves_where_nothing_matches(pair):
    problem = _problem(pair)
    method = Sought(problem.searched.initial + 800)

    def unlike(searched):
        found = method(searched)
        return replace(found, evidence=replace(found.evidence, best_start=LIMITS.least_similarity - 1e-6))

    assert searched_on(unlike, problem, None)[1] == []
    assert len(method.ranges) == 1
