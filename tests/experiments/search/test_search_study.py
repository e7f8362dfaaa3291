"""The search study appends, resumes, splits into shards and refuses mixed settings; figures need only its tables."""

import csv
import inspect
import math
import re
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
import torch
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate
from omegaconf import DictConfig
from PIL import Image

from experiments.common.machine import MACHINE, machine
from experiments.search import figures
from experiments.search import study as search
from regtorch.errors import RegtorchError
from regtorch.formats.volumes import write_volume
from regtorch.geometry import KEYS
from regtorch.phantom import make_phantom
from regtorch.registration import Registration

_ROOT = Path(__file__).parents[3]
_CHEAP = [
    "views=[PA]", "kinds=[matched]", "seeds=1", "detector={rows: 60, columns: 50, pixel_mm: 6.0}",
    "registration.settings.poses=40",
]  # fmt: skip


@pytest.fixture(scope="module")
def ct(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("ct") / "one.nii.gz"
    write_volume(path, make_phantom(6.0)[0])
    path.with_name("two.nii.gz").write_bytes(path.read_bytes())
    return path


pytestmark = pytest.mark.usefixtures("threads_kept")


def _config(ct: Path, out: Path, *overrides: str, pixels: int = 40) -> DictConfig:
    with initialize_config_dir(str(_ROOT / "conf"), version_base="1.3"):
        config = compose("search", [*_CHEAP, f"cts=[{ct}]", f"out={out}", *overrides])
    config.registration.settings.levels = [
        {"_target_": "regtorch.registration.Stage", "pixels": side, "candidates": candidates, "steps": 3}
        for side, candidates in ((30, 4), (pixels, 2))
    ]
    return config


def _rows(table: Path) -> list[dict[str, str]]:
    with table.open(newline="") as file:
        return list(csv.DictReader(file))


def test_rows_are_appended_once_and_a_second_start_does_what_is_missing(ct, tmp_path):
    table = tmp_path / "registrations.csv"
    search.run(_config(ct, tmp_path))
    first = table.read_bytes()
    (row,) = _rows(table)
    assert tuple(row) == search.COLUMNS
    assert {name: row[name] for name in MACHINE} == machine()
    assert [row[key] for key in search.KEY] == ["one.nii.gz", "PA", "matched", "0"]
    assert float(row["initial_pde_mm"]) > 20
    assert row["status"] in ("ok", "doubtful", "failed")
    search.run(_config(ct, tmp_path))
    assert table.read_bytes() == first
    search.run(_config(ct, tmp_path, "seeds=2"))
    assert table.read_bytes().startswith(first)
    assert [row["seed"] for row in _rows(table)] == ["0", "1"]


def test_the_start_is_within_what_is_searched_and_the_truth_within_its_range(ct, tmp_path):
    study = search.Study(_config(ct, tmp_path))
    middle = search.initial_parameters(study.cts["one.nii.gz"], study.detector, "PA")
    middle[5] += 60
    deg = math.radians(1)
    for seed in range(50):
        true, initial = study.drawn("one.nii.gz", "PA", seed)
        within = torch.tensor([25, 25, 50, 25, 25, 30, *[5 * deg] * 3], dtype=torch.float64)
        assert bool(((true - middle).abs() <= within + 1e-6).all())
        searched = 3 * torch.tensor([25, 25, 50, 50, 50, 50, *[4 * deg] * 3], dtype=torch.float64)
        assert bool(((true - initial).abs() <= searched + 1e-6).all())
    again = study.drawn("one.nii.gz", "PA", seed)
    assert torch.equal(again[0], true)
    assert torch.equal(again[1], initial)


def test_targets_are_those_of_a_folder_that_exists_or_of_none(ct, tmp_path):
    (tmp_path / "one.csv").write_text("L3,1,2,3\n")
    assert search.Study(_config(ct, tmp_path, f"targets={tmp_path}")).targets == {"one.nii.gz": {"L3": (1, 2, 3)}}
    assert search.Study(_config(ct, tmp_path, "targets=null")).targets == {}
    with pytest.raises(RegtorchError, match=r"targets=.*none: no such folder"):
        search.Study(_config(ct, tmp_path, f"targets={tmp_path / 'none'}"))


def test_targets_that_lie_outside_the_ct_are_refused(ct, tmp_path):
    (tmp_path / "one.csv").write_text("L3,1,2,30000\n")
    with pytest.raises(RegtorchError, match=r"one\.csv: none of its 1 targets lies in the CT, expected LPS"):
        search.Study(_config(ct, tmp_path, f"targets={tmp_path}"))


def test_registrations_are_by_the_threshold_asked_for(ct, tmp_path, monkeypatch):
    given = {}
    register = search.register
    monkeypatch.setattr(
        search, "register", lambda *args, **settings: given.update(settings) or register(*args, **settings)
    )
    search.run(_config(ct, tmp_path, "threshold_hu=150.0"))
    assert given["threshold_hu"] == 150


def test_a_part_of_a_ct_is_the_same_anatomy_in_the_same_place(ct, tmp_path):
    study = search.Study(_config(ct, tmp_path, "given=0.5"))
    whole, part = study.cts["one.nii.gz"], study.given["one.nii.gz"]
    n = whole.data.shape[0]
    assert part.data.shape[0] == n - 2 * round(n / 4)
    assert torch.equal(part.data, whole.data[round(n / 4) : n - round(n / 4)])
    assert torch.equal(part.origin_patient_mm, whole.origin_patient_mm)
    first = torch.tensor([0, 0, round(n / 4), 1], dtype=torch.float64)
    assert torch.allclose(part.patient_from_voxel[:, 3], whole.patient_from_voxel @ first)
    for share in (0.0, 0.001, 1.5):
        with pytest.raises(RegtorchError, match=rf"given={share}: expected a share"):
            search.Study(_config(ct, tmp_path, f"given={share}"))


def test_shards_share_the_cases_out_and_count_each_others(ct, tmp_path):
    shared = "kinds=[matched,unmoved]", "seeds=3"
    both = [search.cases_of(_config(ct, tmp_path, *shared, f"shard={i}/2")) for i in (0, 1)]
    whole = search.cases_of(_config(ct, tmp_path, *shared))
    assert sorted(both[0] + both[1]) == sorted(whole)
    assert all({kind for _, _, kind, _ in own} == {"matched", "unmoved"} for own in both)
    for shard in ("0/2", "1/2"):
        search.run(_config(ct, tmp_path, "seeds=2", f"shard={shard}"))
    assert [len(_rows(tmp_path / f"registrations-{i}.csv")) for i in (0, 1)] == [1, 1]
    search.run(_config(ct, tmp_path, "seeds=2"))
    assert not (tmp_path / "registrations.csv").exists()


def test_changed_settings_refuse_to_mix_but_kinds_may_be_added(ct, tmp_path):
    search.run(_config(ct, tmp_path))
    for name, changed in {
        "dof": "=6",
        "registration": ".settings.poses=50",
        "radiographs.matched": ".threshold_hu=200.0",
    }.items():
        with pytest.raises(RegtorchError, match=re.escape(f"another {name!r}")):
            search.run(_config(ct, tmp_path, name + changed))
    added = "+radiographs.dense={_target_: regtorch.simulation.simulate, _partial_: true, threshold_hu: 300.0}"
    search.run(_config(ct, tmp_path, added, "kinds=[dense]"))
    search.run(_config(ct, tmp_path))
    assert [row["kind"] for row in _rows(tmp_path / "registrations.csv")] == ["matched", "dense"]
    with pytest.raises(RegtorchError, match=re.escape("radiographs.dense")):
        search.run(_config(ct, tmp_path, added.replace("300.0", "400.0"), "kinds=[dense]"))


@pytest.mark.parametrize("wrong", ["kinds=[none]", "decoys=[none]", "shard=2/2", "shard=1", "views=[PA,PA]"])
def test_what_cannot_be_asked_for_is_refused(ct, tmp_path, wrong):
    with pytest.raises(RegtorchError, match=r"expected"):
        search.cases_of(_config(ct, tmp_path, wrong))


def test_what_a_registration_tells_of_itself_is_kept(ct, tmp_path, monkeypatch):
    told = [3.5, 1e6]
    monkeypatch.setattr(Registration, "expected_pde_mm", lambda self, points=None: tuple(told))
    row = search.Study(_config(ct, tmp_path)).row(("one.nii.gz", "PA", "matched", 0))
    assert (row["expected_pde_mm"], row["within_region"]) == (3.5, True)
    told[1] = row["pde_mm"] / 2
    assert search.Study(_config(ct, tmp_path)).row(("one.nii.gz", "PA", "matched", 0))["within_region"] is False


def test_decoys_have_a_status_but_no_errors(ct, tmp_path):
    two = f"cts=[{ct},{ct.with_name('two.nii.gz')}]"
    decoys = ["patient", "mirrored", "upside_down", "noise"]
    search.run(_config(ct, tmp_path, two, "kinds=[]", f"decoys=[{','.join(decoys)}]", "decoy_of=matched"))
    rows = _rows(tmp_path / "registrations.csv")
    assert [row["kind"] for row in rows] == 2 * [f"decoy_{name}" for name in decoys]
    assert all(row["status"] and row["pde_mm"] == "" and row[f"error_{KEYS[0]}"] == "" for row in rows)


def test_decoys_are_the_images_that_they_say(ct, tmp_path):
    study = search.Study(_config(ct, tmp_path, "decoy_of=matched"))
    case = ("one.nii.gz", "PA", "decoy", 0)
    right = study.radiograph("one.nii.gz", "PA", "matched", 0)
    assert torch.equal(study.decoy("mirrored", right, case)[:, 0], right.image[:, -1])
    assert torch.equal(study.decoy("upside_down", right, case)[0], right.image[-1])
    assert torch.equal(study.decoy("noise", right, case), study.decoy("noise", right, case))
    with pytest.raises(RegtorchError, match="second CT"):
        study.decoy("patient", right, case)


def test_a_failure_leaves_a_small_picture(ct, tmp_path):
    fine = "detector={rows: 300, columns: 260, pixel_mm: 1.2}"
    search.run(_config(ct, tmp_path, fine, "seeds=3", "pictures=1", pixels=8))
    assert max(float(row["pde_mm"]) for row in _rows(tmp_path / "registrations.csv")) > 5
    (picture,) = (tmp_path / "failures").iterdir()
    assert picture.stat().st_size < 60_000
    assert max(Image.open(picture).size) == 250


def _written(folder: Path) -> None:
    """Ten registrations in two tables, including a lost one that is called ok, and a decoy."""
    rows = []
    for seed in range(10):
        kind = "matched" if seed % 2 else "realistic"
        rows.append({"ct": "a.nii.gz", "view": "PA", "kind": kind, "seed": seed, "initial_pde_mm": 50})
        rows[-1] |= {"pde_mm": 0.1 + seed / 10, "expected_pde_mm": 0.1 + seed / 20, "within_region": seed > 0}
        rows[-1] |= {"status": "doubtful" if seed == 3 else "ok", "evaluations": 7000, "seconds": 5}
    rows[9]["pde_mm"] = math.inf
    decoy = {"ct": "a.nii.gz", "view": "PA", "kind": "decoy_noise", "seed": 0, "status": "failed"}
    for number, some in enumerate([rows[:5], [*rows[4:], decoy]]):
        pd.DataFrame(some, columns=search.COLUMNS).to_csv(folder / f"registrations-{number}.csv", index=False)


def test_figures_need_no_torch_and_say_what_the_tables_hold(tmp_path):
    _written(tmp_path)
    code = "import sys, pathlib; from experiments.search.figures import write; write(pathlib.Path(sys.argv[1])); "
    code += "assert 'torch' not in sys.modules"
    subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=True, cwd=_ROOT)
    text = (tmp_path / "table.md").read_text()
    assert "| a | PA | matched | 5 | 50 | 0.6 |" in text
    assert "| all | 1 of 1 | 11.1 % of 9 | 1.00 | 90.0 % of 10 |" in text
    assert "| a | PA | noise | 1 | 1 failed |" in text
    assert (tmp_path / "pde.png").stat().st_size > 10_000
    assert (tmp_path / "calibration.png").stat().st_size > 10_000


def test_figures_do_without_expectations(ct, tmp_path):
    search.run(_config(ct, tmp_path))
    table = tmp_path / "registrations.csv"
    rows = pd.read_csv(table).assign(expected_pde_mm=None, within_region=None)
    rows.to_csv(table, index=False)
    figures.write(tmp_path)
    assert "not told" in (tmp_path / "table.md").read_text()
    assert not (tmp_path / "calibration.png").exists()


@pytest.mark.parametrize("kind", ["no_grid", "processed"])
def test_kinds_of_mobile_radiographs_are_those_of_the_other_studies(ct, tmp_path, kind):
    ours = instantiate(_config(ct, tmp_path).radiographs[kind])
    with initialize_config_dir(str(_ROOT / "conf"), version_base="1.3"):
        theirs = instantiate(compose("simulation_study", [f"radiograph={kind}"]).radiograph)
    assert ours.func is theirs.func
    assert ours.keywords.items() <= theirs.keywords.items()
    changed = {key for key, value in theirs.keywords.items() if value != _default(theirs.func, key)}
    assert changed == set(ours.keywords)


def _default(function, key: str):
    return inspect.signature(function).parameters[key].default
