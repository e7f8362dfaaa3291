"""The pages build without warnings and without network; pages made of the code are as the code is."""

import importlib.util
import os
import re
import subprocess
import sys
from dataclasses import fields
from functools import partial

import pytest

from regtorch.geometry import Detector
from regtorch.imaging import Radiograph
from regtorch.phantom import make_phantom
from regtorch.registration import Evidence, Settings, Stage, hybrid, initial_parameters, register
from regtorch.registration.trace import Step
from regtorch.registration.trust.rules import RULES, WARNINGS
from regtorch.simulation import simulate
from tests.docs.quoted import ROOT

sys.path.insert(0, str(ROOT / "docs"))
import build_reference

sys.path.pop(0)

NEEDED = ("mkdocs", "material", "mkdocstrings_handlers.python")


def _missing() -> list[str]:
    try:
        return [name for name in NEEDED if importlib.util.find_spec(name) is None]
    except ModuleNotFoundError as error:
        return [str(error.name)]


@pytest.mark.skipif(bool(_missing()), reason="mkdocs is not installed: pip install '.[docs]'")
def test_pages_build_without_a_warning(tmp_path):
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, env=os.environ | {"NO_MKDOCS_2_WARNING": "1"})
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stderr
    pages = list((tmp_path / "site").rglob("*.html"))
    assert len(pages) > 20
    for page in pages:
        loaded = re.findall(r"<(?:script|img|link)[^>]+(?:src|href)=\"(https?:[^\"]+)\"", page.read_text("utf-8"))
        assert loaded == [], f"{page.name} loads something from the network"


def test_the_command_line_is_as_help_says():
    page = (ROOT / "docs" / "reference" / "command_line.md").read_text(encoding="utf-8")
    made = build_reference.command_line()
    assert page.split() == made.split(), "python docs/build_reference.py"


def test_the_settings_are_those_of_the_search():
    page = (ROOT / "docs" / "reference" / "settings.md").read_text(encoding="utf-8")
    assert page == build_reference.settings(), "python docs/build_reference.py"


def test_every_reason_of_doubt_is_explained():
    page = (ROOT / "docs" / "explained" / "doubt.md").read_text(encoding="utf-8")
    codes = re.findall(r"^##+ `?([a-z_]+)`?$", page, re.MULTILINE)
    assert sorted(codes) == sorted(rule.code for rule in (*RULES, *WARNINGS))


@pytest.fixture(scope="module")
def tables() -> dict[str, list[str]]:
    """First column of each table of the page on files, by the heading above it."""
    page = (ROOT / "docs" / "reference" / "files.md").read_text(encoding="utf-8")
    found = {}
    for heading, text in re.findall(r"^##+ ([^\n]*)\n(.*?)(?=^##|\Z)", page, re.MULTILINE | re.DOTALL):
        found[heading.strip("` ")] = re.findall(r"^\| `(\w+)` \|", text, re.MULTILINE)
    return found


def test_evidence_and_trace_are_those_of_the_code(tables):
    assert tables["evidence"] == [field.name for field in fields(Evidence)]
    assert tables["trace"] == [field.name for field in fields(Step)]


def test_keys_of_the_files_are_those_of_the_code(tables, phantom_files):
    result, truth = phantom_files
    assert sorted(tables["result.json"]) == sorted({*result, "expected_target_errors_mm"})
    assert sorted(tables["truth.json"]) == sorted(truth)


@pytest.fixture(scope="module")
def phantom_files() -> tuple[dict, dict]:
    """Contents of a result.json and a truth.json of a very coarse registration."""
    ct, targets = make_phantom(6.0)
    detector = Detector(64, 64, 6.0)
    simulation = simulate(ct, initial_parameters(ct, detector, "PA"), "PA", detector=detector, targets=targets)
    coarse = Settings(poses=16, levels=(Stage(24, 4, 3), Stage(32, 2, 3)), finest_pixels=48, finest_steps=2)
    radiograph = Radiograph.from_image(simulation.image, detector)
    result = register(ct, radiograph, "PA", method=partial(hybrid, settings=coarse))
    return result.to_dict(), simulation.to_dict()
