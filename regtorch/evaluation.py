"""How far a registration is from the truth: projection distance error, 3D target error, parameter errors."""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.errors import RegtorchError
from regtorch.geometry import (
    KEYS,
    VIEWS,
    Detector,
    parameters_from_dict,
    parameters_from_matrix,
    project,
    same_view,
    world_from_ct,
)

_SHARED = ("parameters", "view", "mirrored", "detector", "pixel_from_patient")
_SAME, _APART_MM = 1e-6, 1e-3
"""Rotations that differ less are one, and so are centres."""
_OWN = {"result": ("status", "similarity"), "truth": ("targets_patient_mm",)}


def projection_distances(
    estimated: Float[Tensor, "*b 3 4"], true: Float[Tensor, "*#b 3 4"], points_mm: Float[Tensor, "n 3"], pixel_mm: float
) -> Float[Tensor, "*b n"]:
    """Distance in the detector plane (mm) between the projections of each point (LPS mm) by two matrices: eq. (5).

    Infinite for a point that either matrix puts behind the source.
    """
    distance = (project(estimated, points_mm) - project(true, points_mm)).norm(dim=-1) * pixel_mm
    return torch.where(distance.isnan(), torch.inf, distance)


def evaluate(result: Mapping[str, Any], truth: Mapping[str, Any]) -> dict[str, Any]:
    """Compare the contents of a ``result.json`` and of a ``truth.json``.

    Returns ``pde_mm`` (mean over the targets, in the detector plane; infinite where either puts one behind the source),
    ``target_error_mm`` (mean distance in space between where the two put a target, seen from the detector), ``targets``
    (both, for each by name) and ``parameter_errors`` (result less truth, mm and degrees; angles the short way round).
    Where the two are of different parts of a CT, whose centres the patient's place is told by, the truth's is moved to
    the result's.
    """
    if not same_view(result["view"], truth["view"]):
        raise RegtorchError(f"view {result['view']} of the result, expected {truth['view']} as in the truth")
    if not _same_detector(result["detector"], truth["detector"]):
        raise RegtorchError(f"detector {result['detector']} of the result, expected {truth['detector']} of the truth")
    names = list(truth["targets_patient_mm"])
    points = torch.tensor([truth["targets_patient_mm"][name] for name in names], dtype=torch.float64)
    matrices = [torch.tensor(d["pixel_from_patient"], dtype=torch.float64) for d in (result, truth)]
    in_plane = projection_distances(*matrices, points, truth["detector"]["pixel_mm"])
    places = [_world_from_patient(matrix, d) for matrix, d in zip(matrices, (result, truth), strict=True)]
    in_space = torch.stack([points @ p[:3, :3].mT + p[:3, 3] for p in places]).diff(dim=0)[0].norm(dim=-1)
    errors = {key: result["parameters"][key] - truth["parameters"][key] for key in KEYS}
    for key, moved in zip(KEYS[3:6], _moved_mm(result, truth, places), strict=True):
        errors[key] -= moved
    return {
        "pde_mm": float(in_plane.mean()),
        "target_error_mm": float(in_space.mean()),
        "targets": {
            name: {"pde_mm": float(a), "target_error_mm": float(b)}
            for name, a, b in zip(names, in_plane, in_space, strict=True)
        },
        "parameter_errors": {k: math.remainder(e, 360) if k.endswith("_deg") else e for k, e in errors.items()},
    }


def read_json(path: str | Path, kind: Literal["result", "truth"]) -> dict[str, Any]:
    """The contents of a ``result.json`` or ``truth.json``; ``RegtorchError`` names the missing or malformed entry."""
    try:
        content = json.loads(Path(path).read_text())
    except FileNotFoundError:
        raise RegtorchError(f"{path}: no such file, expected a {kind}.json") from None
    except (OSError, UnicodeDecodeError, RecursionError, json.JSONDecodeError) as error:
        raise RegtorchError(f"{path}: cannot be read as JSON ({error}), expected a {kind}.json") from None
    if not isinstance(content, dict):
        raise RegtorchError(f"{path}: a {type(content).__name__} at the top, expected the object of a {kind}.json")
    if missing := [key for key in (*_SHARED, *_OWN[kind]) if key not in content]:
        raise RegtorchError(f"{path}: no {missing[0]!r}, expected a {kind}.json with it")
    try:
        _check(content)
    except ValueError as error:
        raise RegtorchError(f"{path}: {error}, expected the values of a {kind}.json") from None
    return content


def _check(content: dict[str, Any]) -> None:
    targets = content.get("targets_patient_mm", {"none": [0, 0, 0]})
    parameters, detector = content["parameters"], content["detector"]
    for key, value in (("parameters", parameters), ("detector", detector), ("targets_patient_mm", targets)):
        if not isinstance(value, dict) or not value:
            raise ValueError(f"{key} {value!r}")
    if missing := [key for key in KEYS if key not in parameters]:
        raise ValueError(f"no parameter {missing[0]!r}")
    _check_numbers("parameters", [parameters[key] for key in KEYS], (9,))
    _check_numbers("detector", [detector.get(key) for key in ("rows", "columns", "pixel_mm")], (3,))
    _check_numbers("pixel_from_patient", content["pixel_from_patient"], (3, 4))
    _check_numbers("targets_patient_mm", list(targets.values()), (len(targets), 3))
    _detector(content)
    if content["view"] not in VIEWS:
        raise ValueError(f"unknown view {content['view']!r}")
    if not isinstance(content["mirrored"], bool):
        raise ValueError(f"mirrored {content['mirrored']!r}")


def _check_numbers(name: str, values: Any, shape: tuple[int, ...]) -> None:
    try:
        numbers = torch.tensor(values, dtype=torch.float64)
    except (TypeError, ValueError, RuntimeError, OverflowError):
        numbers = torch.empty(0)
    if numbers.shape != shape or not bool(numbers.isfinite().all()):
        raise ValueError(f"{name} {values!r}, not {' x '.join(map(str, shape))} finite numbers")


def _detector(content: Mapping[str, Any]) -> Detector:
    grid = content["detector"]
    return Detector(int(grid["rows"]), int(grid["columns"]), float(grid["pixel_mm"]))


def _same_detector(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    same_grid = (one["rows"], one["columns"]) == (other["rows"], other["columns"])
    return same_grid and math.isclose(one["pixel_mm"], other["pixel_mm"], rel_tol=1e-4)


def _world_from_patient(matrix: Float[Tensor, "3 4"], content: Mapping[str, Any]) -> Float[Tensor, "4 4"]:
    """Where a projection matrix to stored pixels puts the patient (LPS mm) relative to the detector."""
    detector = _detector(content)
    if content["mirrored"]:
        flip = matrix.new_tensor([[-1, 0, detector.columns - 1], [0, 1, 0], [0, 0, 1]])
        matrix = flip @ matrix
    # With the patient's own origin in place of the CT's centre, the nine parameters place the patient frame itself.
    return world_from_ct(
        parameters_from_matrix(matrix, detector, content["view"], matrix.new_zeros(3)), content["view"]
    )


def _moved_mm(
    result: Mapping[str, Any], truth: Mapping[str, Any], world_from_patient: Sequence[Float[Tensor, "4 4"]]
) -> list[float]:
    """How much further the truth has the CT's centre of the result than its own: x_obj, y_obj, z_obj.

    A centre o is where the parameters say that it is, x_obj = R o + t with R, t of ``world_from_patient``. Nothing for
    an image stored on its side, whose matrix is of another detector than its parameters.
    """
    turned = [world_from_ct(parameters_from_dict(d["parameters"]), d["view"]) for d in (result, truth)]
    own, true = world_from_patient
    if any(float((told - found)[:3, :3].abs().max()) > _SAME for told, found in zip(turned, (own, true), strict=True)):
        return [0.0] * 3
    centres = [p[:3, :3].mT @ (told[:3, 3] - p[:3, 3]) for told, p in zip(turned, (own, true), strict=True)]
    moved = true[:3, :3] @ (centres[0] - centres[1])
    return moved.tolist() if float(moved.norm()) > _APART_MM else [0.0] * 3
