"""Named points in the patient, read from CSV or from files of 3D Slicer: ``.mrk.json`` and the older ``.fcsv``."""

import csv
import io
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from regtorch.errors import RegtorchError
from regtorch.files import one_line

Point = tuple[float, float, float]

_EXPECTED = "a CSV file of name,x,y,z in LPS mm, or points that 3D Slicer saved as .mrk.json or .fcsv"
_LPS_SIGN = {"LPS": 1, "1": 1, "RAS": -1, "0": -1}
"""Of x and y, by the name of the coordinates, which is a number in files of Slicer before 4.11."""

_FCSV_COLUMNS = "id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID"
_FCSV_DEFINED = "2"


def read_points(path: str | Path) -> dict[str, Point]:
    """Named points (LPS mm) of a file of 3D Slicer (``.json``, ``.fcsv``), or else of a CSV file of name,x,y,z.

    RAS is turned to LPS. A point without a name gets its number in the file: ``point 3``. Raises ``RegtorchError``
    for other coordinates or units, a name that comes again, and a point without three numbers or never placed.
    """
    path = Path(path)
    read = {".json": _json_points, ".fcsv": _fcsv_points}.get(path.suffix.lower(), _csv_points)
    points: dict[str, Point] = {}
    try:
        for number, (where, name, point) in enumerate(read(path.read_text(encoding="utf-8-sig")), 1):
            name = name.strip() or f"point {number}"
            if name in points:
                raise RegtorchError(f"{where} names {name} again, expected each name once")
            points[name] = point
        if not points:
            raise RegtorchError(f"no points, expected {_EXPECTED}")
    except OSError as error:
        raise RegtorchError(f"{path}: {error.strerror}, expected {_EXPECTED}") from None
    except (csv.Error, json.JSONDecodeError, RecursionError, UnicodeDecodeError) as error:
        raise RegtorchError(f"{path}: cannot be read ({one_line(error)}), expected {_EXPECTED}") from None
    except RegtorchError as error:
        raise RegtorchError(f"{path}: {error}") from None
    return points


# Each reader gives, for every point: where it stands in the file, its name, its place.


def _csv_points(text: str) -> Iterator[tuple[str, str, Point]]:
    for number, line in enumerate(csv.reader(io.StringIO(text)), 1):
        if line and [word.strip().lower() for word in line[1:4]] != ["x", "y", "z"]:
            yield f"line {number}", line[0], _point(f"line {number} is {one_line(line)}", line[1:])


def _fcsv_points(text: str) -> Iterator[tuple[str, str, Point]]:
    lines = text.splitlines()
    comments = [line[1:].partition("=") for line in lines if line.startswith("#")]
    header = {key.strip(): value.strip() for key, _, value in comments}
    sign = _lps_sign(header.get("CoordinateSystem", "missing"))
    columns = header.get("columns", _FCSV_COLUMNS).split(",")
    if missing := {"x", "y", "z", "label"} - set(columns):
        raise RegtorchError(f"columns {','.join(columns)!r}, expected {min(missing)!r} among them")
    for number, line in enumerate(lines, 1):
        if line.startswith("#") or not line.strip():
            continue
        # Slicer 5 puts the position's status behind the last column, without naming it.
        entry = dict(zip([*columns, "status"], next(csv.reader([line])), strict=False))
        told = f"line {number} is {one_line(line)!r}"
        if entry.get("status", _FCSV_DEFINED) != _FCSV_DEFINED:
            raise RegtorchError(f"{told}: position status {entry['status']}, expected {_FCSV_DEFINED} (defined)")
        yield f"line {number}", entry.get("label", ""), _point(told, [entry.get(axis) for axis in "xyz"], sign)


def _json_points(text: str) -> Iterator[tuple[str, str, Point]]:
    markup = _only_markup(json.loads(text))
    units = markup.get("coordinateUnits", "mm")
    if (units[:1] if isinstance(units, list) else [units]) != ["mm"]:
        raise RegtorchError(f"coordinateUnits {units!r}, expected mm")
    sign = _lps_sign(markup.get("coordinateSystem", "LPS"))
    for number, entry in enumerate(markup["controlPoints"], 1):
        where = f"control point {number}"
        if not isinstance(entry, dict):
            raise RegtorchError(f"{where} is {one_line(entry)!r}, expected an object with label and position")
        label, position = str(entry.get("label") or ""), entry.get("position")
        told = f"{where} ({label!r}) lies at {one_line(position)}"
        if entry.get("positionStatus", "defined") != "defined":
            raise RegtorchError(f"{told}: positionStatus {entry['positionStatus']!r}, expected 'defined'")
        yield where, label, _point(told, position, sign)


def _only_markup(content: Any) -> dict[str, Any]:
    markups = content.get("markups") if isinstance(content, dict) else None
    if not isinstance(markups, list):
        raise RegtorchError(f"no list of 'markups', expected {_EXPECTED}")
    if len(markups) != 1:
        raise RegtorchError(f"{len(markups)} markups, expected one list of points")
    if not (isinstance(markups[0], dict) and isinstance(markups[0].get("controlPoints"), list)):
        raise RegtorchError("no list of 'controlPoints' in its markup, expected one of points")
    return markups[0]


def _lps_sign(system: Any) -> int:
    if str(system) not in _LPS_SIGN:
        raise RegtorchError(f"CoordinateSystem {system}, expected LPS or RAS (1 or 0 in older files)")
    return _LPS_SIGN[str(system)]


def _point(told: str, numbers: Any, sign: int = 1) -> Point:
    """Three numbers in LPS mm, whose x and y may have to change ``sign``; ``told`` begins the message about others."""
    try:
        x, y, z = map(float, numbers)
    except (TypeError, ValueError, OverflowError):
        x = y = z = math.nan
    if isinstance(numbers, str) or not math.isfinite(x + y + z):
        raise RegtorchError(f"{told}, expected a name and x, y, z in mm")
    return sign * x + 0.0, sign * y + 0.0, z  # 0.0 makes -0.0 plain again
