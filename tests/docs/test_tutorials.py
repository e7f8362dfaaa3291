"""Every tutorial runs, and leaves its picture."""

import importlib.util
from pathlib import Path

import pytest
from PIL import Image

ROOT = Path(__file__).parents[2]


def load(name: str):
    """A script of ``docs/``, as a module."""
    spec = importlib.util.spec_from_file_location(Path(name).stem, ROOT / "docs" / name)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


tutorials = load("build_tutorials.py")


@pytest.mark.parametrize("script", tutorials.SCRIPTS, ids=lambda path: path.stem)
def test_a_tutorial_runs_and_ends_in_a_picture(script, tmp_path):
    output = tutorials.run(script, tmp_path)
    with Image.open(tmp_path / f"{script.stem}.png") as picture:
        assert min(picture.size) >= 250
    page = script.with_suffix(".md").read_text(encoding="utf-8")
    made = tutorials.page(script, output)
    printed = "The script prints:"
    assert page.partition(printed)[0] == made.partition(printed)[0], "run python docs/build_tutorials.py"


def test_every_script_of_a_tutorial_is_in_the_list():
    assert set((ROOT / "docs" / "tutorials").glob("*.py")) == set(tutorials.SCRIPTS)


def test_the_figures_of_the_search_are_drawn(tmp_path):
    figures = load("figures/search_steps.py")
    figures.main(tmp_path)
    kept = {path.name for path in (ROOT / "docs" / "figures").glob("*.png")}
    assert {path.name for path in tmp_path.glob("*.png")} == kept


def test_pictures_are_small():
    for path in (ROOT / "docs").rglob("*.png"):
        assert path.stat().st_size < 150_000, path
