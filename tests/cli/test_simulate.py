"""A radiograph of a CT and the truth about it, from the command line."""

import io
import json
import sys

import numpy as np

from .commands import PARAMETERS, SHARED, SIMULATE, SIZE, run


def test_simulate_writes_a_radiograph_and_the_truth_of_the_contract(inputs):
    assert sorted(p.name for p in (inputs / "good").iterdir()) == ["radiograph.tiff", "result.json", "truth.json"]
    truth = json.loads((inputs / "good" / "truth.json").read_text())
    assert set(truth) >= SHARED | {"targets_patient_mm"}
    assert list(truth["parameters"]) == PARAMETERS
    assert (truth["view"], truth["mirrored"]) == ("PA", False)
    assert truth["detector"] == {"rows": 100, "columns": 80, "pixel_mm": 3.5}
    assert np.shape(truth["pixel_from_patient"]) == (3, 4)
    assert all(len(point) == 3 for point in truth["targets_patient_mm"].values())


def test_simulate_repeats_itself_by_seed_and_does_what_it_is_told(inputs, tmp_path):
    (tmp_path / "targets.csv").write_text("name,x,y,z\nupper,0,0,200\nlower,10,0,100\n")
    told = f"simulate {inputs}/ct.nii.gz --view LAT {SIZE} --photons 1000 --threshold-hu 100"
    told += f" --targets {tmp_path}/targets.csv --sdd-mm 1200 --rotation-range-deg 0"
    told += " --source-range-mm 0 0 0 --patient-range-mm 0 0 0"
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        assert run(f"{told} --seed {seed} --out {tmp_path / name}") == 0
    a, b, c = ((tmp_path / name / "radiograph.tiff").read_bytes() for name in "abc")
    assert a == b != c
    truth = json.loads((tmp_path / "a" / "truth.json").read_text())
    assert truth["targets_patient_mm"] == {"upper": [0, 0, 200], "lower": [10, 0, 100]}
    values = truth["parameters"]
    assert values["z_s_mm"] == 1200
    assert values["z_obj_mm"] > 0
    assert [values[key] for key in PARAMETERS if key not in ("z_s_mm", "z_obj_mm")] == [0] * 7


def test_progress_is_shown_on_a_terminal_only(inputs, tmp_path, monkeypatch):
    shown = {}
    for terminal in (True, False):
        stream = io.StringIO()
        monkeypatch.setattr(stream, "isatty", lambda terminal=terminal: terminal)
        monkeypatch.setattr(sys, "stderr", stream)
        assert run(SIMULATE.format(i=inputs, o=tmp_path)) == 0
        shown[terminal] = stream.getvalue()
    steps = [shown[True].find(step) for step in ("reading the CT", "rendering the radiograph", "writing it")]
    assert -1 < steps[0] < steps[1] < steps[2]
    assert shown[False] == ""
