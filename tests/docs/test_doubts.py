"""Each reason of doubt has its picture, of a registration that ends with it."""

import re

import pytest
from PIL import Image

from regtorch.registration.trust.rules import RULES, WARNINGS
from tests.docs.test_tutorials import ROOT, load

doubts = load("build_doubts.py")

CODES = [rule.code for rule in (*RULES, *WARNINGS)]
QUICK = ("other_similarity", "found_once", "frozen_wrong", "uncertain", "runner_up_vertebra")
"""Cases that take about a second each."""


def test_every_rule_has_a_case_and_a_picture():
    assert list(doubts.CASES) == CODES, "an entry of CASES in docs/build_doubts.py is missing"
    assert {path.stem for path in doubts.FOLDER.iterdir()} == set(CODES), "run python docs/build_doubts.py"
    assert all(path.stat().st_size < 100_000 for path in doubts.FOLDER.iterdir())


def test_the_page_shows_each_picture_under_its_rule():
    text = (ROOT / "docs" / "explained" / "doubt.md").read_text(encoding="utf-8")
    for entry in re.split(r"^## ", text, flags=re.MULTILINE)[1:]:
        code = entry.partition("\n")[0]
        assert re.findall(r"!\[.*?\]\((.*?)\)\n\n\*\*Picture\*\* ", entry) == [f"doubt/{code}.png"]


@pytest.mark.parametrize("code", QUICK)
def test_a_case_ends_with_its_reason(code):
    _, _, result = doubts.registered(code)
    assert doubts.sentence(code, result)


def test_a_case_that_ends_otherwise_is_not_drawn(monkeypatch):
    monkeypatch.setitem(doubts.CASES, "no_match", doubts.CASES["other_similarity"])
    with pytest.raises(RuntimeError, match="no_match: ended as"):
        doubts.registered("no_match")


def test_a_picture_is_drawn(tmp_path):
    doubts.draw("other_similarity", tmp_path)
    with (
        Image.open(tmp_path / "other_similarity.png") as picture,
        Image.open(doubts.FOLDER / "other_similarity.png") as kept,
    ):
        assert picture.size == kept.size
