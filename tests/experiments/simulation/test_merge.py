"""Arms and shards merge into one small sorted table, without torch; a repeated registration is refused."""

import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from experiments.common.registrations import read_rows
from experiments.common.table import append, done
from experiments.simulation.merge import KEY, merge
from experiments.simulation.study import COLUMNS
from regtorch.errors import RegtorchError

ROOT = Path(__file__).parents[3]


def _write(table: Path, arm: str, seeds: range) -> None:
    table.parent.mkdir(parents=True, exist_ok=True)
    for seed in seeds:
        row = dict.fromkeys(COLUMNS, 1 / (seed + 3)) | {
            "arm": arm,
            "view": "PA",
            "dof": 9,
            "seed": seed,
            "status": "ok",
        }
        row |= {"within_region": seed % 2 == 0, "marker_x_mm": None, "message": "a, b", "version": "0.1.0+abc"}
        append(table, row)


def test_arms_and_shards_are_one_sorted_table(tmp_path):
    _write(tmp_path / "9-DOF" / "registrations-1.csv", "9-DOF", range(2, 4))
    _write(tmp_path / "9-DOF" / "registrations-0.csv", "9-DOF", range(2))
    _write(tmp_path / "6-DOF" / "registrations.csv", "6-DOF", range(2))
    with (tmp_path / "6-DOF" / "registrations.csv").open("a") as file:
        file.write("6-DOF,PA,9,cut sh")
    merged = merge(tmp_path)
    wanted = [("6-DOF", 0), ("6-DOF", 1), *(("9-DOF", seed) for seed in range(4))]
    assert list(zip(merged.arm, merged.seed, strict=True)) == wanted
    kept = pd.read_parquet(tmp_path / "registrations.parquet")
    pd.testing.assert_frame_equal(kept, merged)
    assert tuple(kept) == COLUMNS
    assert kept.pde_mm.dtype == "float32"
    assert kept.pde_mm[0] == pytest.approx(1 / 3)
    assert kept.within_region.tolist()[:2] == [True, False]
    assert kept.marker_x_mm.isna().all()


def test_an_arm_may_have_any_name_and_a_table_no_row_yet(tmp_path):
    for arm in ("010", "NA"):
        _write(tmp_path / arm / "registrations-0.csv", arm, range(2))
        (tmp_path / arm / "registrations-1.csv").touch()
    assert merge(tmp_path).arm.tolist() == ["010", "010", "NA", "NA"]
    assert pd.read_parquet(tmp_path / "registrations.parquet").arm.tolist() == ["010", "010", "NA", "NA"]


def test_the_same_rows_make_the_same_file(tmp_path):
    _write(tmp_path / "one" / "a" / "registrations.csv", "a", range(4))
    for shard in (1, 0):
        _write(tmp_path / "two" / "a" / f"registrations-{shard}.csv", "a", range(shard, 4, 2))
    files = []
    for name in ("one", "two"):
        merge(tmp_path / name)
        files.append((tmp_path / name / "registrations.parquet").read_bytes())
    assert files[0] == files[1]


def test_rows_that_only_the_merged_table_has_stay(tmp_path):
    """After the arms' tables are deleted, new rows are added to the merged table and read with it."""
    table, other = (tmp_path / "a" / f"registrations{part}.csv" for part in ("", "-0"))
    _write(table, "a", range(4))
    merge(tmp_path)
    whole = (tmp_path / "registrations.parquet").read_bytes()
    table.unlink()
    assert done(table.parent, KEY) == {("a", "PA", str(seed)) for seed in range(4)}
    merge(tmp_path)
    assert (tmp_path / "registrations.parquet").read_bytes() == whole
    _write(other, "a", range(3, 6))
    assert len(read_rows(tmp_path)) == 6
    assert merge(tmp_path).seed.tolist() == [0, 1, 2, 3, 4, 5]
    other.unlink()
    _write(table, "a", range(6))
    (tmp_path / "one").mkdir()
    table.parent.rename(tmp_path / "one" / "a")
    merge(tmp_path / "one")
    again = (tmp_path / "one" / "registrations.parquet").read_bytes()
    assert (tmp_path / "registrations.parquet").read_bytes() == again


@pytest.mark.parametrize("other", [{"view": "PA"}, {"arm": "b", "view": "PA", "seed": 1, "more": 2}])
def test_tables_of_another_study_are_refused(tmp_path, other):
    _write(tmp_path / "a" / "registrations.csv", "a", range(2))
    (tmp_path / "b").mkdir()
    append(tmp_path / "b" / "registrations.csv", other)
    with pytest.raises(RegtorchError, match=r"b/registrations\.csv: (no column 'arm'|other columns)"):
        merge(tmp_path)


def test_a_registration_that_is_there_twice_is_refused(tmp_path):
    _write(tmp_path / "a" / "registrations.csv", "a", range(2))
    _write(tmp_path / "a" / "registrations-0.csv", "a", range(1, 2))
    with pytest.raises(RegtorchError, match="a, PA, 1 is there twice"):
        merge(tmp_path)


def test_merging_needs_no_torch_and_says_what_it_found(tmp_path):
    _write(tmp_path / "a" / "registrations.csv", "a", range(2))
    code = "import runpy, sys; sys.argv[1:] = [{!r}]; runpy.run_module('experiments.merge', run_name='__main__'); "
    code += "assert not {{'torch', 'numba', 'kornia'}} & {{*sys.modules}}"
    done = subprocess.run([sys.executable, "-c", code.format(str(tmp_path))], cwd=ROOT, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, f"a: 2 registrations\nwrote {tmp_path}/registrations.parquet\n"), (
        done.stderr
    )
    (tmp_path / "empty").mkdir()
    command = [sys.executable, "-m", "experiments.merge", str(tmp_path / "empty")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr.endswith("expected those of a study\n")
