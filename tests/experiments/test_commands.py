"""Every command describes itself on --help; user errors end in one line."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
COMMANDS = sorted(
    {path.stem for path in (ROOT / "experiments").glob("*.py")} - {"__init__"}
    | {path.parent.name for path in (ROOT / "experiments").glob("*/__main__.py")}
)


def _run(*words: str) -> subprocess.CompletedProcess[str]:
    environment = {name: value for name, value in os.environ.items() if name != "REGTORCH_DATA"}
    command = [sys.executable, "-m", *words]
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_says_what_the_command_does(command):
    done = _run(f"experiments.{command}", "--help")
    assert (done.returncode, done.stderr) == (0, "")
    assert f"python -m experiments.{command} " in done.stdout
    assert "checkout" in done.stdout


def test_help_of_a_study_has_its_settings_with_comments_and_its_groups():
    done = _run("experiments.simulation_study", "--help")
    assert "threshold_hu: 100.0            # threshold T of DRRs" in done.stdout
    assert "least_targets: 2  " in done.stdout
    assert "registration: cmaes, cmaes_full, hybrid (default)" in done.stdout
    assert "radiograph: matched (default), no_grid, processed, realistic" in done.stdout
    assert "output_subdir" not in done.stdout


def test_a_missing_environment_is_told_in_one_line(tmp_path):
    done = _run("experiments.accuracy", f"out={tmp_path}")
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.startswith("accuracy: error: ct: ")
    assert "Environment variable 'REGTORCH_DATA' not found" in line


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["search_figures", "none"], "search_figures: error: none: no such folder"),
        (["search_figures", "results/simulation"], "no column 'ct', expected rows of the search study"),
        (["accuracy_figures", "results/search"], "no column 'dof', expected rows of the accuracy study"),
        (["benchmark_figures", "results/search"], "benchmark.csv: no such file, expected the table of the benchmark"),
        (["memory", "pses=3"], "memory: error: pses: no such option, expected of ct"),
        (["merge", "--all"], "unrecognized arguments: --all"),
    ],
)
def test_user_errors_are_one_line(words, message):
    command, *rest = words
    done = _run(f"experiments.{command}", *rest)
    assert done.returncode == 2
    assert message in done.stderr
    assert done.stderr.count("\n") == 1
