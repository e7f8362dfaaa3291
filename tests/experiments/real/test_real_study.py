"""The study of real pairs reads its YAML, appends, resumes and compares; a phantom stands for the patient."""

import csv
import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from hydra import compose, initialize_config_dir
from omegaconf import DictConfig

from experiments.real import figures, pictures, spread
from experiments.real import study as real
from experiments.real.pairs import read_matrix, read_pairs
from regtorch.errors import RegtorchError
from regtorch.formats import write_radiograph, write_volume
from regtorch.geometry import KEYS, Detector
from regtorch.phantom import make_phantom
from regtorch.registration import initial_parameters
from regtorch.simulation import simulate

_ROOT = Path(__file__).parents[3]
_SHORT = "{one}: {{ct: ct.nii.gz, radiograph: image.tiff, view: PA, {facts}}}\n"

pytestmark = pytest.mark.usefixtures("threads_kept")


@pytest.fixture(scope="module")
def pairs(tmp_path_factory) -> Path:
    """A phantom of 6 mm voxels and its radiograph, stored mirrored, with the truth and another answer."""
    folder = tmp_path_factory.mktemp("pairs")
    ct, points = make_phantom(6.0)
    detector = Detector(rows=60, columns=50, pixel_mm=6.0)
    parameters = initial_parameters(ct, detector, "PA", sdd_mm=1200.0)
    parameters[5] += 60
    truth = simulate(ct, parameters, "PA", detector=detector, targets=points, threshold_hu=100.0)
    write_volume(folder / "ct.nii.gz", ct)
    write_radiograph(folder / "image.tiff", truth.image.flip(1), detector, view="PA")
    stored = torch.tensor([[-1.0, 0, 49], [0, 1, 0], [0, 0, 1]], dtype=torch.float64) @ truth.pixel_from_patient
    (folder / "truth.json").write_text(json.dumps({"pixel_from_patient": stored.tolist()}))
    stored[0] += stored[2]  # every point a pixel further
    (folder / "answer.json").write_text(json.dumps({"pixel_from_patient": stored.tolist()}))
    (folder / "points.csv").write_text("".join(f"{name},{x},{y},{z}\n" for name, (x, y, z) in points.items()))
    facts = "sdd_mm: 1200, pixel_mm: 6.0, intensity: line, mirrored: true, targets: points.csv, truth: truth.json, "
    (folder / "pairs.yaml").write_text(_SHORT.format(one="phantom", facts=f"{facts}answer: answer.json"))
    return folder / "pairs.yaml"


def _config(pairs: Path, out: Path, *overrides: str) -> DictConfig:
    cheap = ["starts=1", "only=[9-DOF]", "registration.settings.poses=40"]
    with initialize_config_dir(str(_ROOT / "conf"), version_base="1.3"):
        config = compose("real", [*cheap, f"pairs={pairs}", f"out={out}", *overrides])
    config.registration.settings.levels = [
        {"_target_": "regtorch.registration.Stage", "pixels": side, "candidates": candidates, "steps": 3}
        for side, candidates in ((30, 4), (40, 2))
    ]
    return config


def _rows(table: Path) -> list[dict[str, str]]:
    with table.open(newline="") as file:
        return list(csv.DictReader(file))


def test_rows_are_appended_once_and_have_the_distances(pairs, tmp_path):
    table = tmp_path / "registrations.csv"
    real.run(_config(pairs, tmp_path))
    first = table.read_bytes()
    (row,) = _rows(table)
    assert tuple(row) == real.COLUMNS
    assert [row[key] for key in real.KEY] == ["phantom", "9-DOF", "0"]
    assert (row["mirrored"], row["told"], row["told_sdd_mm"]) == ("True", "sdd side", "1200.0")
    assert float(row["pde_mm"]) < 2 < float(row["initial_pde_mm"])
    assert abs(float(row["answer_mm"]) - 6) < 2
    assert float(row["expected_z_s_mm"]) > 0
    assert len(row["targets_mm"].split(";")) == len(make_phantom(6.0)[1])
    real.run(_config(pairs, tmp_path, "starts=2"))
    assert table.read_bytes().startswith(first)
    assert [row["seed"] for row in _rows(table)] == ["0", "1"]
    assert len({row["initial_x_obj_mm"] for row in _rows(table)}) == 2


def test_shards_share_the_starts(pairs, tmp_path):
    both = [real.cases_of(_config(pairs, tmp_path, "starts=3", f"shard={i}/2")) for i in (0, 1)]
    assert [seed for _, _, seed in both[0] + both[1]] == [0, 2, 1]


def test_starts_lie_within_the_papers_range_and_frozen_parameters_stay(pairs, tmp_path):
    study = real.Study(_config(pairs, tmp_path, "only=null"))
    limit = torch.tensor([50, 50, 100, 50, 50, 100, *[math.radians(5)] * 3], dtype=torch.float64)
    radiograph = study.radiograph(("phantom", "9-DOF", 0))
    for arm, sdd_mm in {"9-DOF": 1200.0, "9-DOF, SDD untold": 1000.0, "6-DOF": 1200.0}.items():
        middle = initial_parameters(study.cts["phantom"], radiograph.detector, "PA", sdd_mm=sdd_mm)
        errors = torch.stack([study.start(("phantom", arm, seed), radiograph) - middle for seed in range(100)])
        assert bool((errors.abs() <= limit + 1e-6).all())
        assert bool((errors[:, 3:].std(0) > limit[3:] / 5).all())
        assert bool(errors[:, :3].any()) == arm.startswith("9")


def test_an_arm_sees_what_it_is_told(pairs, tmp_path):
    study = real.Study(_config(pairs, tmp_path, "blocks=5"))
    told, untold = (study.radiograph(("phantom", arm, 0)) for arm in ("9-DOF", "9-DOF, side untold"))
    assert torch.equal(told.image, untold.image.flip(1))
    assert (told.mirrored, untold.mirrored) == (True, False)
    first, other = (study.radiograph(("phantom", f"9-DOF, {half} half", 3)) for half in ("first", "other"))
    assert torch.equal(first.weight + other.weight, told.weight)
    assert 0.3 < float(first.weight.sum() / told.weight.sum()) < 0.7
    assert not torch.equal(first.weight, study.radiograph(("phantom", "9-DOF, first half", 4)).weight)


@pytest.mark.parametrize("wrong", ["only=[none]", "shard=2/2", "+arms.mine={dof: 9, told: [age], half: null}"])
def test_what_cannot_be_asked_for_is_refused(pairs, tmp_path, wrong):
    with pytest.raises(RegtorchError, match="expected"):
        real.cases_of(_config(pairs, tmp_path, wrong))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no pairs"),
        ("a: [", "cannot be read"),
        ("a: 3", "pair a is 3"),
        (_SHORT.format(one="a", facts="age: 3"), "unknown entry 'age'"),
        (_SHORT.format(one="a", facts="sdd_mm: far"), "sdd_mm 'far'"),
        ("a: {ct: b, view: PA}", "no 'radiograph'"),
    ],
)
def test_a_wrong_file_of_pairs_is_refused(tmp_path, text, message):
    (tmp_path / "pairs.yaml").write_text(text)
    with pytest.raises(RegtorchError, match=message):
        read_pairs(tmp_path / "pairs.yaml")


def test_a_wrong_matrix_is_refused(tmp_path):
    for text in ("{}", '{"pixel_from_patient": [[1, 2]]}', "["):
        (tmp_path / "truth.json").write_text(text)
        with pytest.raises(RegtorchError, match=r"truth\.json"):
            read_matrix(tmp_path / "truth.json")


def _written(folder: Path) -> None:
    """Eight runs of 9-DOF at one place, two of 6-DOF 3 mm away, and ten pairs of halves twice as far as expected."""
    rows, random = [], np.random.default_rng(0)
    for number in range(30):
        arm = "6-DOF" if number in (8, 9) else "9-DOF"
        half = None if number < 10 else ("first", "other")[number % 2]
        shift = (3 if arm == "6-DOF" else 0) + (random.normal(0, 0.02) if half else 0.001 * number)
        row = {
            "pair": "p",
            "arm": arm if half is None else f"9-DOF, {half} half",
            "seed": number if half is None else number // 2,
        }
        row |= {"view": "PA", "dof": int(arm[0]), "half": half, "told_sdd_mm": 1800.0, "status": "ok", "seconds": 2}
        row |= {"similarity": 0.5 if arm == "6-DOF" else 0.8, "expected_targets_mm": 0.01, "reasons": None}
        row |= {f"found_{key}": random.normal(0, 2) for key in KEYS} | {f"expected_{key}": 1.0 for key in KEYS}
        row |= {"found_z_s_mm": 1801.0, "targets_mm": ";".join(f"{x + shift:.4f} 7.0000" for x in (0, 50, 90))}
        rows.append(row)
    rows[9]["status"] = "doubtful"
    pd.DataFrame(rows, columns=real.COLUMNS).to_csv(folder / "registrations.csv", index=False)


def test_the_modal_answer_is_where_most_are_and_in_their_middle():
    """The lonely one has no distance from itself, so the mean distance alone would choose it."""
    places = [0.0, 1.0, 1.4, 90.0]
    rows = pd.DataFrame({"arm": "9-DOF", "half": None, "similarity": 0.8, "targets_mm": [f"{x} 0" for x in places]})
    assert spread.from_modal(rows) == pytest.approx([1, 0, 0.4, 89])


def test_figures_need_no_torch_and_say_what_the_table_holds(tmp_path):
    _written(tmp_path)
    code = "import sys, pathlib; from experiments.real.figures import write; write(pathlib.Path(sys.argv[1])); "
    code += "assert 'torch' not in sys.modules"
    subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=True, cwd=_ROOT)
    text = (tmp_path / "table.md").read_text()
    assert "| p | 9-DOF | 8 | 100.0 % of 8 | 0.003 |" in text
    assert "| p | 6-DOF | 2 | 0.0 % of 2 | 0.001 | 0.001 | 0.001 | 3.0" in text
    assert "| p | 9-DOF | 1800 | 1801.0 | 1801.0 to 1801.0 | 1.0 | 100.0 % of 8 |" in text
    assert "| p | 6-DOF | none | 1 ok, 1 doubtful | none |" in text
    assert (tmp_path / "spread.png").stat().st_size > 10_000
    ratios, count = spread.over_halves(spread.read(tmp_path)[lambda rows: rows.half.notna()])
    assert count == 10
    assert 1 < ratios["x_s_mm"] < 3
    assert 1 < ratios["targets"] < 3


def test_pictures_show_the_modal_answer_and_rows_of_others_are_refused(pairs, tmp_path):
    real.run(_config(pairs, tmp_path))
    figures.write(tmp_path)
    written = pictures.draw(tmp_path, pairs)
    assert [path.name for path in written] == ["phantom_overlay.png", "phantom_correlation.png"]
    assert all(path.stat().st_size > 10_000 for path in written)
    with pytest.raises(RegtorchError, match="study of real pairs"):
        figures.write(_ROOT / "results" / "search")
