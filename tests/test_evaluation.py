"""Distances computed by hand, and invalid JSON files."""

import json
import math
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest
import torch

from regtorch.errors import RegtorchError
from regtorch.evaluation import evaluate, projection_distances, read_json
from regtorch.geometry import KEYS, Detector, parameters_to_dict, pixel_from_patient, world_from_ct

ROWS, COLUMNS, PIXEL_MM = 400, 500, 0.5
ORIGIN_MM = torch.tensor([10.0, -20.0, 30.0], dtype=torch.float64)
TARGETS = {"T1": [10.0, -20.0, 30.0], "T2": [20.0, -20.0, 30.0], "T3": [10.0, 80.0, 30.0]}


def _pose(**changes: float) -> torch.Tensor:
    values = {**dict.fromkeys(KEYS, 0.0), "z_s_mm": 1000.0, "z_obj_mm": 200.0, **changes}
    return torch.tensor([v if k.endswith("_mm") else math.radians(v) for k, v in values.items()], dtype=torch.float64)


def _content(
    pose: torch.Tensor, view: str = "PA", mirrored: bool = False, origin_mm: torch.Tensor = ORIGIN_MM
) -> dict[str, Any]:
    """The common content of ``result.json`` and ``truth.json``, and the content of each alone."""
    detector = Detector(ROWS, COLUMNS, PIXEL_MM)
    matrix = pixel_from_patient(pose, detector, view, origin_mm)
    if mirrored:
        matrix = matrix.new_tensor([[-1, 0, COLUMNS - 1], [0, 1, 0], [0, 0, 1]]) @ matrix
    return {
        "parameters": parameters_to_dict(pose),
        "view": view,
        "mirrored": mirrored,
        "detector": {"rows": ROWS, "columns": COLUMNS, "pixel_mm": PIXEL_MM},
        "pixel_from_patient": matrix.tolist(),
        "targets_patient_mm": deepcopy(TARGETS),
        "status": "ok",
        "similarity": 0.9,
    }


@pytest.fixture
def write(tmp_path) -> Callable[[Any], Path]:
    def write(content: Any) -> Path:
        path = tmp_path / "truth.json"
        path.write_text(content if isinstance(content, str) else json.dumps(content))
        return path

    return write


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("view", ["PA", "RLAT"])
def test_another_part_of_the_ct_is_no_error(view: str, mirrored: bool):
    """Its centre lies elsewhere, and the position of the patient refers to that centre."""
    pose = _pose(x_s_mm=20, eta_deg=4, theta_deg=-3, phi_deg=8, x_obj_mm=5)
    shift = torch.tensor([10.0, -20, 35], dtype=torch.float64)
    moved = pose.clone()
    moved[3:6] += world_from_ct(pose, view)[:3, :3] @ shift
    moved[3] += 1.5
    truth = _content(pose, view, mirrored)
    result = _content(moved, view, mirrored, ORIGIN_MM + shift)
    assert evaluate(result, truth)["target_error_mm"] == pytest.approx(1.5)
    errors = evaluate(result, truth)["parameter_errors"]
    assert errors == pytest.approx(dict.fromkeys(KEYS, 0) | {"x_obj_mm": 1.5}, abs=1e-6)


def test_the_truth_has_no_error():
    found = evaluate(_content(_pose(eta_deg=3)), _content(_pose(eta_deg=3)))
    assert found["pde_mm"] == pytest.approx(0, abs=1e-9)
    assert found["target_error_mm"] == pytest.approx(0, abs=1e-6)
    assert set(found["parameter_errors"]) == set(KEYS)
    assert set(found["parameter_errors"].values()) == {0}


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_patient_moved_along_the_detector_by_hand(mirrored):
    # T1 and T2 lie 200 mm from the detector, magnified by 1000 / 800; T3, 100 mm nearer to the source, by 1000 / 700.
    found = evaluate(_content(_pose(x_obj_mm=3, y_obj_mm=4), "PA", mirrored), _content(_pose(), "PA", mirrored))
    expected = {"T1": 5 / 0.8, "T2": 5 / 0.8, "T3": 5 / 0.7}
    for name, pde_mm in expected.items():
        assert found["targets"][name]["pde_mm"] == pytest.approx(pde_mm)
        assert found["targets"][name]["target_error_mm"] == pytest.approx(5)
    assert found["pde_mm"] == pytest.approx(sum(expected.values()) / 3)
    assert found["target_error_mm"] == pytest.approx(5)
    assert found["parameter_errors"]["y_obj_mm"] == pytest.approx(4)


def test_a_patient_moved_along_the_beam_shows_in_space_more_than_in_the_plane():
    found = evaluate(_content(_pose(z_obj_mm=208)), _content(_pose()))
    # T1 is in the middle of the beam; T2, 10 mm beside it, moves from 10 / 0.8 to 10 / 0.792.
    assert found["targets"]["T1"] == pytest.approx({"pde_mm": 0, "target_error_mm": 8}, abs=1e-6)
    assert found["targets"]["T2"] == pytest.approx({"pde_mm": 10 / 0.792 - 10 / 0.8, "target_error_mm": 8})


def test_a_source_moved_leaves_the_patient_where_it_is():
    # T1's shadow goes the other way by 200 / 800 of the source's 40 mm.
    found = evaluate(_content(_pose(x_s_mm=40)), _content(_pose()))
    assert found["targets"]["T1"]["pde_mm"] == pytest.approx(10)
    assert found["target_error_mm"] == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("view", ["PA", "AP", "LLAT", "RLAT"])
def test_mirrored_storage_changes_neither_error(view):
    poses = _pose(x_s_mm=5, phi_deg=2, x_obj_mm=-7, theta_deg=3), _pose(z_s_mm=980, eta_deg=-2)
    plain, mirrored = (evaluate(*(_content(p, view, m) for p in poses)) for m in (False, True))
    assert mirrored["pde_mm"] == pytest.approx(plain["pde_mm"])
    assert mirrored["target_error_mm"] == pytest.approx(plain["target_error_mm"])
    assert plain["target_error_mm"] > 1


def test_a_matrix_counts_whatever_its_scale():
    result, truth = _content(_pose(x_obj_mm=3)), _content(_pose())
    expected = evaluate(result, truth)
    result["pixel_from_patient"] = [[2.5 * number for number in row] for row in result["pixel_from_patient"]]
    assert evaluate(result, truth)["pde_mm"] == pytest.approx(expected["pde_mm"])
    assert evaluate(result, truth)["target_error_mm"] == pytest.approx(expected["target_error_mm"])


def test_angles_differ_the_short_way_round():
    errors = evaluate(_content(_pose(phi_deg=179)), _content(_pose(phi_deg=-178)))["parameter_errors"]
    assert errors["phi_deg"] == pytest.approx(-3)


def test_a_target_behind_the_source_is_infinitely_wrong():
    matrices = [pixel_from_patient(p, Detector(5, 5, 1.0), "PA", ORIGIN_MM) for p in (_pose(z_obj_mm=1100), _pose())]
    points = torch.tensor(list(TARGETS.values()), dtype=torch.float64)
    assert projection_distances(*matrices, points, 1.0).tolist() == 3 * [math.inf]
    assert projection_distances(*matrices[::-1], points, 1.0).tolist() == 3 * [math.inf]


def test_distances_of_many_matrices_to_one_by_hand():
    detector = Detector(ROWS, COLUMNS, PIXEL_MM)
    poses = torch.stack([_pose(x_obj_mm=shift) for shift in (0, 8, -16)])
    true = pixel_from_patient(_pose(), detector, "PA", ORIGIN_MM)
    points = torch.tensor([TARGETS["T1"], TARGETS["T2"]], dtype=torch.float64)
    distances = projection_distances(pixel_from_patient(poses, detector, "PA", ORIGIN_MM), true, points, PIXEL_MM)
    expected = torch.tensor([[0, 0], [10, 10], [20, 20]], dtype=torch.float64)
    torch.testing.assert_close(distances, expected, atol=1e-9, rtol=0)


def test_lat_is_llat():
    assert evaluate(_content(_pose(), "LAT"), _content(_pose(), "LLAT"))["pde_mm"] == pytest.approx(0, abs=1e-9)


def test_another_view_is_refused():
    with pytest.raises(RegtorchError, match="view AP of the result, expected PA as in the truth"):
        evaluate(_content(_pose(), "AP"), _content(_pose(), "PA"))


@pytest.mark.parametrize(("key", "value"), [("rows", 401), ("columns", 499), ("pixel_mm", 0.51)])
def test_another_detector_is_refused(key, value):
    result = _content(_pose())
    result["detector"][key] = value
    with pytest.raises(RegtorchError, match=r"detector .* of the result, expected .* of the truth"):
        evaluate(result, _content(_pose()))


@pytest.mark.parametrize("kind", ["result", "truth"])
def test_what_was_written_is_read(kind, write):
    content = _content(_pose(phi_deg=1))
    content["more"] = content["detector"]["more"] = "is allowed"
    read = read_json(write(content), kind)
    assert read == content
    assert evaluate(read, read)["pde_mm"] == 0


def test_a_result_needs_no_targets_and_a_truth_no_status(write):
    content = _content(_pose())
    for kind, others in (("result", ["targets_patient_mm"]), ("truth", ["status", "similarity"])):
        read_json(write({k: v for k, v in content.items() if k not in others}), kind)


def _refused(path: Path, kind: str = "truth") -> str:
    with pytest.raises(RegtorchError) as caught:
        read_json(path, kind)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    assert f"{kind}.json" in message.removeprefix(f"{path}: "), "says what was expected"
    return message.removeprefix(f"{path}: ")


def test_a_missing_file_or_a_folder_is_refused(tmp_path):
    assert "no such file" in _refused(tmp_path / "nothing.json")
    assert "cannot be read" in _refused(tmp_path)


@pytest.mark.parametrize("text", ["", "{", "pde 3 mm", "\x00"])
def test_what_is_not_json_is_refused(text, write):
    assert "cannot be read as JSON" in _refused(write(text))


def test_bytes_that_are_no_text_are_refused(tmp_path):
    path = tmp_path / "truth.json"
    path.write_bytes(b"\xff\xfe\x80 image")
    assert "cannot be read as JSON" in _refused(path)


@pytest.mark.parametrize(
    ("content", "name"), [([], "list"), ("[1, 2]", "list"), ("3.5", "float"), ("null", "NoneType")]
)
def test_json_that_is_no_object_is_refused(content, name, write):
    assert f"a {name} at the top" in _refused(write(content))


@pytest.mark.parametrize("kind", ["result", "truth"])
def test_a_missing_key_is_named(kind, write):
    own = {"result": ["status", "similarity"], "truth": ["targets_patient_mm"]}[kind]
    for key in ["parameters", "view", "mirrored", "detector", "pixel_from_patient", *own]:
        content = _content(_pose())
        del content[key]
        assert f"no '{key}'" in _refused(write(content), kind)


_MATRIX = _content(_pose())["pixel_from_patient"]


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("parameters", [0, 0, 1000]),
        ("parameters", {}),
        ("parameters", {"x_s_mm": 1.0}),
        ("parameters", dict.fromkeys(KEYS, "one")),
        ("parameters", dict.fromkeys(KEYS, "1")),
        ("parameters", dict.fromkeys(KEYS)),
        ("parameters", dict.fromkeys(KEYS, math.nan)),
        ("pixel_from_patient", _MATRIX[:2]),
        ("pixel_from_patient", [row[:3] for row in _MATRIX]),
        ("pixel_from_patient", [_MATRIX[0], _MATRIX[1], [1]]),
        ("pixel_from_patient", [[math.nan] * 4] * 3),
        ("pixel_from_patient", "identity"),
        ("pixel_from_patient", None),
        ("detector", [400, 500, 0.5]),
        ("detector", {"rows": 400, "columns": 500}),
        ("detector", {"rows": 0, "columns": 500, "pixel_mm": 0.5}),
        ("detector", {"rows": 400, "columns": 500, "pixel_mm": -0.5}),
        ("detector", {"rows": "many", "columns": 500, "pixel_mm": 0.5}),
        ("view", "BACK"),
        ("view", ["PA"]),
        ("mirrored", "no"),
        ("targets_patient_mm", {}),
        ("targets_patient_mm", [[1, 2, 3]]),
        ("targets_patient_mm", {"T1": [1, 2]}),
        ("targets_patient_mm", {"T1": 5}),
        ("targets_patient_mm", {"T1": ["1", "2", "3"]}),
        ("targets_patient_mm", {"T1": [1, 2, math.inf]}),
    ],
)
def test_values_of_the_wrong_shape_or_kind_are_refused(key, value, write):
    content = _content(_pose())
    content[key] = value
    assert key.split("_")[0].removesuffix("s") in _refused(write(content))
