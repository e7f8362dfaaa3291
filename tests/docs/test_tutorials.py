"""Every tutorial runs, and ends in its picture."""

import sys

import pytest

from tests.docs.quoted import ROOT

sys.path.insert(0, str(ROOT / "docs"))
import build_tutorials

sys.path.pop(0)

MOST_BYTES = 150_000


@pytest.mark.parametrize("script", build_tutorials.SCRIPTS, ids=lambda script: script.stem)
def test_tutorial_runs(script, tmp_path):
    page = build_tutorials.page(script, build_tutorials.run(script, tmp_path))
    assert (tmp_path / f"{script.stem}.png").stat().st_size > 0
    kept = script.with_suffix(".md").read_text(encoding="utf-8")
    told = "the page is of another script: python docs/build_tutorials.py"
    assert _without_output(page) == _without_output(kept), told


def _without_output(page: str) -> str:
    """Digits of results differ between processors."""
    return page.partition("The script prints:")[0]


@pytest.mark.parametrize("script", build_tutorials.SCRIPTS, ids=lambda script: script.stem)
def test_committed_picture_is_small(script):
    assert script.with_suffix(".png").stat().st_size < MOST_BYTES


def test_no_script_without_a_page():
    found = {path.stem for path in (ROOT / "docs" / "tutorials").glob("*.py")}
    assert found == {script.stem for script in build_tutorials.SCRIPTS}
