"""Named points from CSV and from 3D Slicer's files: the same points from each, and one line about every defect."""

import json
from pathlib import Path
from typing import Any

import pytest

from regtorch.errors import RegtorchError
from regtorch.formats import read_points

POINTS = {"T1": (1.0, 2.5, -3.0), "left hip": (-10.0, 20.0, 4.0), "L5, below": (0.0, -0.125, 1e3)}
COLUMNS = "id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID"
FCSV = f"# Markups fiducial file version = 4.11\n# CoordinateSystem = LPS\n# columns = {COLUMNS}\n"


def _fcsv_line(label: str, x: object, y: object, z: object, more: str = "") -> str:
    label = f'"{label}"' if "," in label else label
    return f"vtkMRMLMarkupsFiducialNode_0,{x},{y},{z},0,0,0,1,1,1,0,{label},,{more}\n"


def _control_point(label: str = "T1", position: Any = (1, 2, 3), **more: Any) -> dict[str, Any]:
    return {"id": "1", "label": label, "position": position, "positionStatus": "defined", "visibility": True} | more


def _markup(*points: Any, **more: Any) -> dict[str, Any]:
    markup = {"type": "Fiducial", "coordinateSystem": "LPS", "coordinateUnits": "mm", "controlPoints": list(points)}
    return {"@schema": "markups-schema-v1.0.3.json#", "markups": [markup | more]}


def _write(path: Path, content: Any) -> Path:
    path.write_text(content if isinstance(content, str) else json.dumps(content), encoding="utf-8")
    return path


def test_points_are_read_by_name(tmp_path):
    path = tmp_path / "targets.csv"
    path.write_text("\ufeffname,x,y,z\nT1,1,2.5,-3\n\nleft hip,-10,2e1,4\n", encoding="utf-8")
    assert read_points(path) == {"T1": (1, 2.5, -3), "left hip": (-10, 20, 4)}
    path.write_text("T1,1,2,3\n")
    assert read_points(path) == {"T1": (1, 2, 3)}


def test_every_kind_of_file_gives_the_same_points(tmp_path):
    csv = "name,x,y,z\n" + "".join(f'"{name}",{x},{y},{z}\n' for name, (x, y, z) in POINTS.items())
    assert read_points(_write(tmp_path / "points.csv", csv)) == POINTS
    for sign, systems in ((1, ("LPS", "1")), (-1, ("RAS", "0"))):
        stored = {name: (sign * x, sign * y, z) for name, (x, y, z) in POINTS.items()}
        for system in systems:
            fcsv = FCSV.replace("LPS", system) + "".join(_fcsv_line(name, *point) for name, point in stored.items())
            assert read_points(_write(tmp_path / "points.fcsv", fcsv)) == POINTS
            markup = _markup(*(_control_point(*point) for point in stored.items()), coordinateSystem=system)
            read = read_points(_write(tmp_path / "points.mrk.json", markup))
            assert read == POINTS
            assert "-0.0" not in map(str, read["L5, below"])


def test_columns_of_an_fcsv_are_those_that_it_names(tmp_path):
    text = "# CoordinateSystem = LPS\n# columns = label,z,y,x\nT1,3,2,1\n"
    assert read_points(_write(tmp_path / "points.fcsv", text)) == {"T1": (1, 2, 3)}
    text = "# CoordinateSystem = LPS\n" + _fcsv_line("T1", 1, 2, 3)
    assert read_points(_write(tmp_path / "points.fcsv", text)) == {"T1": (1, 2, 3)}


def test_slicer_5_tells_the_status_behind_the_columns(tmp_path):
    path = tmp_path / "points.fcsv"
    assert read_points(_write(path, FCSV + _fcsv_line("T1", 1, 2, 3, ",2,0"))) == {"T1": (1, 2, 3)}
    with pytest.raises(RegtorchError, match=r"line 4 is '.*': position status 0, expected 2 \(defined\)"):
        read_points(_write(path, FCSV + _fcsv_line("T1", 0, 0, 0, ",0,0")))


def test_what_slicer_may_leave_out_has_its_defaults(tmp_path):
    bare = {"markups": [{"type": "Fiducial", "controlPoints": [{"label": "T1", "position": [1, 2, 3]}]}]}
    assert read_points(_write(tmp_path / "points.mrk.json", bare)) == {"T1": (1, 2, 3)}
    coded = _markup(_control_point(), coordinateUnits=["mm", "UCUM", "millimeter"])
    assert read_points(_write(tmp_path / "POINTS.JSON", coded)) == {"T1": (1, 2, 3)}


def test_a_point_without_a_name_has_its_number(tmp_path):
    expected = {"T1": (1, 2, 3), "point 2": (4, 5, 6), "point 3": (7, 8, 9)}
    assert read_points(_write(tmp_path / "points.csv", "T1,1,2,3\n,4,5,6\n  ,7,8,9\n")) == expected
    lines = _fcsv_line("T1", 1, 2, 3) + _fcsv_line("", 4, 5, 6) + _fcsv_line(" ", 7, 8, 9)
    assert read_points(_write(tmp_path / "points.fcsv", FCSV + lines)) == expected
    points = [_control_point(), _control_point("", [4, 5, 6]), {"position": [7, 8, 9]}]
    assert read_points(_write(tmp_path / "points.mrk.json", _markup(*points))) == expected


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no points"),
        ("name,x,y,z\n", "no points"),
        ("T1,1,2\n", r"line 1 is \['T1', '1', '2'\]"),
        ("T1,1,2,3\nT2,1,2,3,4\n", "line 2 is"),
        ("T1,1,2,3\nT2,1,two,3\n", "line 2 is"),
        ("T1,1,2,3\nT2,1,nan,3\n", "line 2 is"),
        ("T1,1,2,3\nT1 ,4,5,6\n", "line 2 names T1 again, expected each name once"),
        (",1,2,3\npoint 1,4,5,6\n", "line 2 names point 1 again"),
    ],
)
def test_a_file_of_something_else_is_refused(tmp_path, text, message):
    _refused(_write(tmp_path / "targets.csv", text), message)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (FCSV, "no points, expected"),
        ("T1,1,2,3,1,1\n", "CoordinateSystem missing, expected LPS or RAS"),
        (FCSV.replace("LPS", "2"), "CoordinateSystem 2, expected LPS or RAS"),
        (FCSV.replace("LPS", "IJK"), "CoordinateSystem IJK, expected LPS or RAS"),
        (FCSV.replace("label", "name"), "columns '.*name.*', expected 'label' among them"),
        (FCSV + _fcsv_line("T1", 1, "two", 3), "line 4 is '.*,two,3,.*', expected a name and x, y, z in mm"),
        (FCSV + _fcsv_line("T1", 1, 2, "inf"), "line 4 is"),
        (FCSV + "0,1,2\n", "line 4 is '0,1,2', expected"),
        (FCSV + 2 * _fcsv_line("T1", 1, 2, 3), "line 5 names T1 again, expected each name once"),
    ],
)
def test_an_fcsv_that_cannot_be_used_is_refused(tmp_path, text, message):
    _refused(_write(tmp_path / "targets.fcsv", text), message)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", r"cannot be read \(Expecting value.*\), expected .*\.mrk\.json"),
        ('{"markups": [', "cannot be read"),
        (50000 * "[", "cannot be read"),
        ([1, 2], "no list of 'markups', expected"),
        ({"targets_patient_mm": {}}, "no list of 'markups', expected"),
        ({"markups": []}, "0 markups, expected one list of points"),
        ({"markups": 2 * _markup(_control_point())["markups"]}, "2 markups, expected one list of points"),
        ({"markups": ["T1"]}, "no list of 'controlPoints'"),
        ({"markups": [{"type": "Fiducial"}]}, "no list of 'controlPoints'"),
        (_markup(), "no points, expected"),
        (_markup(_control_point(), coordinateSystem="IJK"), "CoordinateSystem IJK, expected LPS or RAS"),
        (_markup(_control_point(), coordinateSystem=["LPS"]), "expected LPS or RAS"),
        (_markup(_control_point(), coordinateUnits="um"), "coordinateUnits 'um', expected mm"),
        (_markup(_control_point(), coordinateUnits=["cm", "UCUM", "cm"]), "coordinateUnits .*'cm'.*, expected mm"),
        (_markup(_control_point(), coordinateUnits=None), "coordinateUnits None, expected mm"),
        (_markup(_control_point(), 5), "control point 2 is '5', expected an object with label and position"),
        (_markup(_control_point(positionStatus="undefined")), r"control point 1 \('T1'\) .*'undefined', expected 'def"),
        (_markup(_control_point(positionStatus="preview")), "'preview', expected 'defined'"),
        (_markup({"label": "T1"}), r"control point 1 \('T1'\) lies at None, expected a name and x, y, z in mm"),
        (_markup(_control_point(position=[1, 2])), r"lies at \[1, 2\], expected"),
        (_markup(_control_point(position=[1, 2, None])), "lies at"),
        (_markup(_control_point(position=[1, 2, 10**400])), "lies at"),
        (_markup(_control_point(position=[1, 2, float("nan")])), "lies at"),
        (_markup(_control_point(position="123")), "lies at 123, expected"),
        (_markup(_control_point(), _control_point()), "control point 2 names T1 again, expected each name once"),
    ],
)
def test_markups_that_cannot_be_used_are_refused(tmp_path, content, message):
    _refused(_write(tmp_path / "targets.mrk.json", content), message)


def _refused(path: Path, message: str) -> None:
    with pytest.raises(RegtorchError, match=message) as caught:
        read_points(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "expected" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("suffix", ["csv", "fcsv", "mrk.json"])
def test_a_missing_file_is_refused(tmp_path, suffix):
    with pytest.raises(RegtorchError, match=rf"nothing.{suffix}: No such file or directory, expected a CSV file"):
        read_points(tmp_path / f"nothing.{suffix}")


@pytest.mark.parametrize("name", ["image.png", "image.fcsv", "image.json"])
def test_bytes_that_are_no_text_are_refused(tmp_path, name):
    (tmp_path / name).write_bytes(b"\x89PNG\xff\xfe\x00")
    with pytest.raises(RegtorchError, match=rf"{name}: .*expected .*name,x,y,z"):
        read_points(tmp_path / name)
