"""Rows of the simulation study: complete, resumed after kills as if nothing had happened, never of mixed settings."""

import csv
import os
import random
import signal
import statistics
import subprocess
import time
from pathlib import Path

import pandas as pd
import pytest

from experiments.common.report import report
from experiments.common.settings import keep, refuse_to_mix
from experiments.common.table import locked
from experiments.simulation import study
from experiments.simulation.checks import UNSHARED
from experiments.simulation.merge import KEY, merge
from experiments.simulation.worst import write_pictures
from regtorch.errors import RegtorchError
from regtorch.formats.volumes import write_volume
from regtorch.geometry import KEYS, parameters_from_dict
from regtorch.phantom import make_phantom

ROOT = Path(__file__).parents[3]


pytestmark = pytest.mark.usefixtures("threads_kept")


def _read(table: Path) -> list[dict[str, str]]:
    with table.open(newline="") as file:
        return list(csv.DictReader(file))


def test_a_row_tells_all(settings, tmp_path):
    study.run(settings(f"out={tmp_path}", "views=[PA]", "seeds=1", "dof=6"))
    (row,) = _read(tmp_path / "6-DOF" / "registrations.csv")
    assert tuple(row) == study.COLUMNS
    assert [row[key] for key in (*KEY, "dof", "threads", "device")] == ["6-DOF", "PA", "0", "6", "1", "cpu"]
    assert row["status"] in ("ok", "doubtful", "failed")
    for key in KEYS:
        error = float(row[f"found_{key}"]) - float(row[f"true_{key}"])
        assert float(row[f"error_{key}"]) == pytest.approx(error, abs=1e-9)
    source = [float(row[f"found_{key}"]) for key in KEYS[:3]]
    assert source == [float(row[f"initial_{key}"]) for key in KEYS[:3]] == [0, 0, 1000]
    assert 2 <= int(row["targets"]) <= 19
    assert float(row["pde_mm"]) < float(row["initial_pde_mm"])
    assert [path.name for path in tmp_path.glob("*.png")] == ["background_PA.png"]


def test_nine_degrees_of_freedom_find_the_place(undisturbed):
    """On few pixels of several millimetres, with few poses."""
    pde = [float(row[study.COLUMNS.index("pde_mm")]) for row in undisturbed]
    assert statistics.median(pde) < 0.1
    assert max(pde) < 5


def test_kills_at_any_moment_leave_the_table_of_an_undisturbed_run(command, undisturbed, rows, tmp_path):
    moments = random.Random(5)
    table = tmp_path / "9-DOF" / "registrations.csv"
    for _ in range(5):
        before = table.read_bytes().count(b"\n") if table.exists() else 0
        wanted = before + moments.randint(0, 2)
        process = subprocess.Popen(command(f"out={tmp_path}"), cwd=ROOT, stderr=subprocess.DEVNULL)
        while process.poll() is None and (not table.exists() or table.read_bytes().count(b"\n") < wanted):
            time.sleep(0.05)
        time.sleep(moments.random() / 2)
        process.kill()
        assert process.wait() in (0, -signal.SIGKILL)
    assert set(rows(tmp_path)) <= set(undisturbed)
    last = subprocess.run(command(f"out={tmp_path}"), cwd=ROOT, capture_output=True, check=True)
    assert b"16/16" in last.stderr
    assert rows(tmp_path) == undisturbed


def test_changed_settings_refuse_to_mix(settings, tmp_path):
    first = f"out={tmp_path}", "views=[PA]", "seeds=1"
    study.run(settings(*first))
    for changed in (
        "threshold_hu=50",
        "least_targets=3",
        "radiograph.photons=1e5",
        "registration.settings.voxel_per_pixel=2.0",
    ):
        with pytest.raises(RegtorchError, match=f"another '{changed.partition('=')[0].partition('.')[0]}'"):
            study.run(settings(*first, changed))
    study.run(settings(*first[:2], "seeds=2"))
    assert len(_read(tmp_path / "9-DOF" / "registrations.csv")) == 2


def test_settings_are_the_same_however_they_were_given(settings, tmp_path):
    """The file has them as they were given: what the environment says is not in it."""
    keep(settings("dof=6"), tmp_path, UNSHARED)
    before = (tmp_path / "settings.yaml").read_text()
    assert "arm: ${dof}-DOF" in before
    refuse_to_mix(settings("dof=6", "arm=6-DOF"), tmp_path, UNSHARED)
    with pytest.raises(RegtorchError, match="another 'arm'"):
        refuse_to_mix(settings("dof=6", "arm=other"), tmp_path, UNSHARED)


def test_settings_that_another_process_wrote_first_are_not_mixed_with(settings, tmp_path, monkeypatch):
    link = os.link

    def late(source: Path, target: Path) -> None:
        target.write_text("dof: 6\n")
        link(source, target)

    monkeypatch.setattr(os, "link", late)
    with pytest.raises(RegtorchError, match="made with another"):
        keep(settings(), tmp_path, UNSHARED)
    (kept,) = tmp_path.iterdir()
    assert kept.read_text() == "dof: 6\n"


def test_a_second_process_leaves_a_table_alone(run, tmp_path):
    table = tmp_path / "9-DOF" / "registrations.csv"
    table.parent.mkdir()
    with locked(table):
        second = run(f"out={tmp_path}")
    assert (second.returncode, table.exists()) == (2, False)
    assert second.stderr == f"simulation_study: error: {table}: another process is writing it, expected one at a time\n"
    with locked(table), locked(table.with_name("registrations-0.csv")):
        pass


def test_the_worst_have_pictures(settings, tmp_path):
    """Of the merged table alone, with the arm's settings."""
    study.run(settings(f"out={tmp_path}", "seeds=2"))
    merge(tmp_path)
    (tmp_path / "9-DOF" / "registrations.csv").unlink()
    write_pictures(tmp_path, 2)
    rows = pd.read_parquet(tmp_path / "registrations.parquet").nlargest(2, "pde_mm")
    wanted = {f"{view}_{seed}.png" for view, seed in zip(rows["view"], rows["seed"], strict=True)}
    assert {path.name for path in (tmp_path / "9-DOF" / "failures").iterdir()} == wanted
    assert report(tmp_path).count("data:image/png") == 2 + 2  # and two figures
    (tmp_path / "9-DOF" / "settings.yaml").unlink()
    with pytest.raises(RegtorchError, match=r"9-DOF/settings\.yaml: no such file, expected the settings"):
        write_pictures(tmp_path, 2)


@pytest.mark.parametrize("named", [False, True])
def test_any_ct_will_do(settings, tmp_path, named):
    volume, targets = make_phantom(6.0)
    write_volume(tmp_path / "ct.nii.gz", volume)
    lines = [f"{name},{x},{y},{z}" for name, (x, y, z) in targets.items()]
    (tmp_path / "targets.csv").write_text("\n".join(lines))
    chosen = ["data=ct", f"data.path={tmp_path / 'ct.nii.gz'}", f"out={tmp_path}", "views=[PA]", "seeds=1"]
    if named:
        chosen.append(f"data.targets={tmp_path / 'targets.csv'}")
    study.run(settings(*chosen))
    (row,) = _read(tmp_path / "9-DOF" / "registrations.csv")
    initial = parameters_from_dict({key: float(row[f"initial_{key}"]) for key in KEYS})
    if named:
        assert row["marker_x_mm"] != ""
        assert float(initial[4]) == pytest.approx(138 - targets["L3"][2])
    else:
        assert row["marker_x_mm"] == row["corner4_y_mm"] == ""
        assert float(initial[4]) == 0
