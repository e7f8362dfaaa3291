"""Comparison of a result with the truth, on the command line."""

import json
import os
import subprocess
import sys

import pytest

from regtorch.formats import read_volume
from regtorch.geometry import Detector, parameters_from_dict, pixel_from_patient

from .commands import PARAMETERS, result_of, run


def test_evaluate_prints_and_writes(inputs, tmp_path, capfd):
    truth, result = inputs / "good" / "truth.json", tmp_path / "result.json"
    content = result_of(truth)
    content["parameters"]["phi_deg"] += 359.5
    content["pixel_from_patient"][0] = [  # one pixel to the right
        first + last
        for first, last in zip(content["pixel_from_patient"][0], content["pixel_from_patient"][2], strict=True)
    ]
    result.write_text(json.dumps(content))
    assert run(f"evaluate {result} {truth}") == 0
    printed = capfd.readouterr().out
    assert printed.startswith("pde_mm           3.5000")
    assert run(f"evaluate {result} {truth} --json {tmp_path}/found.json") == 0
    assert capfd.readouterr().out == printed
    assert run(f"evaluate {result} {truth} --json") == 0
    out, err = capfd.readouterr()
    found = json.loads(out)
    assert err == ""
    assert found == json.loads((tmp_path / "found.json").read_text())
    assert set(found) >= {"pde_mm", "target_error_mm", "parameter_errors"}
    assert found["pde_mm"] == pytest.approx(3.5)
    assert found["parameter_errors"]["phi_deg"] == pytest.approx(-0.5)
    assert list(found["parameter_errors"]) == PARAMETERS


@pytest.mark.parametrize(("unbuffered", "code"), [("", 0), ("1", 141)], ids=["when done", "before"])
def test_a_reader_that_has_read_enough_gets_no_message(inputs, unbuffered, code):
    good = inputs / "good"
    reading, writing = os.pipe()
    os.close(reading)
    told = [sys.executable, "-m", "regtorch.cli", "evaluate", str(good / "result.json"), str(good / "truth.json")]
    environment = os.environ | {"PYTHONUNBUFFERED": unbuffered}
    done = subprocess.run(told, stdout=writing, stderr=subprocess.PIPE, text=True, check=False, env=environment)
    os.close(writing)
    assert (done.returncode, done.stderr) == (code, "")


def test_evaluate_of_the_truth_itself_is_zero(inputs, capfd):
    assert run(f"evaluate {inputs}/good/result.json {inputs}/good/truth.json --json") == 0
    found = json.loads(capfd.readouterr().out)
    assert found["pde_mm"] == 0
    assert found["target_error_mm"] == pytest.approx(0, abs=1e-9)
    assert set(found["parameter_errors"].values()) == {0}


def test_a_target_behind_the_source_is_null_in_json_and_told_in_the_text(inputs, tmp_path, capfd):
    truth, result = inputs / "good" / "truth.json", tmp_path / "result.json"
    content = result_of(truth)
    content["parameters"]["z_obj_mm"] = content["parameters"]["z_s_mm"]
    parameters = parameters_from_dict(content["parameters"])
    place = Detector(**content["detector"]), content["view"], read_volume(inputs / "ct.nii.gz").origin_patient_mm
    content["pixel_from_patient"] = pixel_from_patient(parameters, *place).tolist()
    result.write_text(json.dumps(content))
    assert run(f"evaluate {result} {truth} --json {tmp_path}/found.json") == 0
    found = json.loads((tmp_path / "found.json").read_text(), parse_constant=pytest.fail)
    errors = [target["pde_mm"] for target in found["targets"].values()]
    assert found["pde_mm"] is None
    assert 0 < errors.count(None) < len(errors)
    assert found["target_error_mm"] > 500
    told = f"infinite ({errors.count(None)} of {len(errors)} targets behind the source; null in JSON)"
    assert capfd.readouterr().out.splitlines()[0] == f"pde_mm           {told}"
    assert run(f"evaluate {result} {truth} --json") == 0
    assert json.loads(capfd.readouterr().out, parse_constant=pytest.fail) == found
