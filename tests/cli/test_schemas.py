"""Files of the command line hold to the schemas that the docs publish; files with faults do not."""

import json
from copy import deepcopy
from functools import partial
from pathlib import Path

import pytest
import tifffile
from jsonschema import Draft202012Validator
from PIL import Image

from regtorch.formats import read_points
from regtorch.registration import Settings, hybrid
from regtorch.registration.search.settings import Stage

from .commands import REGISTER, SIMULATE, run

SCHEMAS = Path(__file__).parents[2] / "docs" / "reference" / "schemas"
SLICER = {
    "@schema": "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/x.json",
    "markups": [
        {
            "type": "Fiducial",
            "coordinateSystem": "RAS",
            "coordinateUnits": "mm",
            "controlPoints": [
                {"id": "1", "label": "T8", "position": [0.0, 0.0, 250.0], "positionStatus": "defined"},
                {"id": "2", "label": "L1", "position": [0, 5, 100]},
            ],
        }
    ],
}


def validator(name: str) -> Draft202012Validator:
    return Draft202012Validator(json.loads((SCHEMAS / f"{name}.schema.json").read_text(encoding="utf-8")))


def unknown(name: str, content: dict) -> set[str]:
    """Keys of a file, at its top and one level below, that its schema does not name."""
    schema = validator(name).schema
    found = set(content) - set(schema["properties"])
    for key, entry in schema["properties"].items():
        told = schema["$defs"].get(entry.get("$ref", "").rpartition("/")[2], {})
        if "properties" in told and key in content:
            found |= set(content[key]) - set(told["properties"])
    return found


@pytest.fixture(scope="module")
def files(inputs, tmp_path_factory) -> dict[str, dict]:
    """The JSON that the commands write, by the name of its schema; the result is of a short default search."""
    folder = tmp_path_factory.mktemp("files")
    short = Settings(levels=(Stage(16, 4, 2), Stage(24, 2, 2)), finest_pixels=32, finest_steps=2, poses=8, more=1)
    (folder / "points.mrk.json").write_text(json.dumps(SLICER))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("regtorch.registration.hybrid", partial(hybrid, settings=short))
        run(REGISTER.format(i=inputs, o=folder) + f" --targets {folder}/points.mrk.json")
    result, truth = folder / "new" / "deep" / "result.json", inputs / "good" / "truth.json"
    assert run(f"evaluate {result} {truth} --json {folder}/evaluation.json") == 0
    with tifffile.TiffFile(inputs / "good" / "radiograph.tiff") as file:
        header = json.loads(file.pages[0].description)
    paths = {"result": result, "truth": truth, "evaluation": folder / "evaluation.json"}
    return {name: json.loads(path.read_text()) for name, path in paths.items()} | {"radiograph": header}


@pytest.mark.parametrize("name", ["result", "truth", "evaluation", "radiograph"])
def test_a_file_holds_to_its_schema_and_has_no_key_that_it_lacks(files, name):
    validator(name).validate(files[name])
    assert unknown(name, files[name]) == set()


def test_the_result_has_every_key_of_its_schema(files):
    assert set(files["result"]) == set(validator("result").schema["properties"])
    assert files["result"]["trace"]


def test_a_result_without_covariance_holds_to_its_schema(inputs, tmp_path, method):
    method.similarity = float("nan")
    assert run(REGISTER.format(i=inputs, o=tmp_path)) == 3
    result = json.loads((tmp_path / "new" / "deep" / "result.json").read_text())
    validator("result").validate(result)
    assert result["similarity"] is None
    assert result["reasons"][0]["status"] == "failed"
    assert set(validator("result").schema["properties"]) - set(result) == {
        "standard_deviations",
        "expected_pde_mm",
        "pde_95_mm",
        "expected_target_errors_mm",
    }


def test_the_header_of_a_png_holds_to_its_schema(inputs, tmp_path):
    assert run(SIMULATE.format(i=inputs, o=tmp_path) + " --format png") == 0
    with Image.open(tmp_path / "new" / "radiograph.png") as image:
        validator("radiograph").validate(json.loads(image.info["regtorch"]))


def test_points_of_slicer_hold_to_their_schema_and_are_read(tmp_path):
    path = tmp_path / "points.mrk.json"
    path.write_text(json.dumps(SLICER))
    validator("points").validate(SLICER)
    assert read_points(path) == {"T8": (0, 0, 250), "L1": (0, -5, 100)}


@pytest.mark.parametrize("name", ["result", "truth", "evaluation", "radiograph"])
def test_a_key_that_is_missing_or_of_another_type_is_refused(files, name):
    check = validator(name)
    for key in files[name]:
        missing, wrong = (deepcopy(files[name]) for _ in range(2))
        del missing[key]
        wrong[key] = [[None]]
        assert check.is_valid(missing) is (key not in check.schema["required"]), key
        assert not check.is_valid(wrong), key


@pytest.mark.parametrize(
    ("part", "key", "value"),
    [
        ("parameters", "eta_deg", "0.1"),
        ("detector", "rows", 100.5),
        ("evidence", "starts", None),
        ("evidence", "frozen", ["roll"]),
        ("parameters", "roll_deg", 1.0),
    ],
)
def test_a_wrong_value_inside_is_refused(files, part, key, value):
    content = deepcopy(files["result"])
    content[part][key] = value
    assert not validator("result").is_valid(content)
    content[part].pop(key)
    assert validator("result").is_valid(content) is (key == "roll_deg")


def test_open_objects_may_have_further_keys(files):
    content = deepcopy(files["result"])
    for each in (content, content["evidence"], content["trace"][0]):
        each["later"] = 1
    validator("result").validate(content)


@pytest.mark.parametrize("fault", [{"coordinateSystem": "world"}, {"coordinateUnits": "m"}, {"controlPoints": []}])
def test_points_that_cannot_be_read_are_refused(fault):
    assert not validator("points").is_valid({"markups": [SLICER["markups"][0] | fault]})
    assert not validator("points").is_valid({"markups": []})
