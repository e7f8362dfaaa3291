"""A study small enough for tests: coarse phantom, few pixels, few poses; run as users run it."""

import csv
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import DictConfig

ROOT = Path(__file__).parents[3]
TINY = [
    "data.spacing_mm=6.0",
    "detector={rows: 60, columns: 60, pixel_mm: 5.8}",
    "registration.settings.poses=30",
    "registration.settings.levels=[{_target_: regtorch.registration.Stage, pixels: 30, candidates: 4, steps: 3},"
    "{_target_: regtorch.registration.Stage, pixels: 40, candidates: 2, steps: 3}]",
    "registration.settings.finest_pixels=60",
    "registration.settings.finest_steps=3",
    "seeds=8",
]

Command = Callable[..., list[str]]
Rows = Callable[[Path], list[tuple[str, ...]]]


@pytest.fixture(scope="session")
def command() -> Command:
    """The command line of a tiny study with added or changed options; ``-m`` comes first."""

    def words(*changes: str) -> list[str]:
        flags = [change for change in changes if change.startswith("-")]
        return [sys.executable, "-m", "experiments.simulation_study", *flags, *_changed(changes[len(flags) :])]

    return words


@pytest.fixture(scope="session")
def run(command: Command) -> Callable[..., subprocess.CompletedProcess[str]]:
    return lambda *changes: subprocess.run(command(*changes), cwd=ROOT, capture_output=True, text=True, check=False)


@pytest.fixture(scope="session")
def settings() -> Callable[..., DictConfig]:
    """The settings of a tiny study with added or changed options."""

    def composed(*changes: str) -> DictConfig:
        with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
            return compose("simulation_study", _changed(changes))

    return composed


@pytest.fixture(scope="session")
def rows() -> Rows:
    """All rows of a study's tables as written, sorted, without the seconds."""

    def read(out: Path) -> list[tuple[str, ...]]:
        found = []
        for table in out.glob("*/registrations*.csv"):
            with table.open(newline="") as file:
                found += [tuple(v for k, v in row.items() if k != "seconds") for row in csv.DictReader(file)]
        return sorted(found)

    return read


@pytest.fixture(scope="session")
def undisturbed(run, rows: Rows, tmp_path_factory) -> list[tuple[str, ...]]:
    """The rows of the tiny study, made by one process in one go."""
    out = tmp_path_factory.mktemp("undisturbed")
    done = run(f"out={out}")
    assert done.returncode == 0, done.stderr
    found = rows(out)
    assert len(found) == 16
    return found


def _changed(changes: tuple[str, ...]) -> list[str]:
    """Another component has other options than the one of the tiny study."""
    changed = {change.partition("=")[0] for change in changes}
    return [*(setting for setting in TINY if setting.partition(".")[0] not in changed), *changes]
