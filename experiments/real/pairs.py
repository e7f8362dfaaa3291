"""Pairs of a CT and a radiograph, as a YAML file beside the data tells them."""

import json
import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import torch
import yaml
from jaxtyping import Float
from torch import Tensor

from regtorch.errors import RegtorchError


@dataclass(frozen=True)
class Pair:
    """Files and facts of one pair. What is None is unknown, or stands in the radiograph's file.

    Args:
        ct: File or folder of the CT.
        radiograph: File of the radiograph.
        view: How the patient stands: PA, AP, LLAT (or LAT), RLAT.
        sdd_mm: Source-detector distance.
        pixel_mm: Pixel size in the detector plane.
        intensity: ``line``, ``counts`` or ``auto``.
        mirrored: Whether the file shows the image as seen towards the source.
        targets: File of named points of the CT; without one points are spread over the bones.
        truth: JSON with the true ``pixel_from_patient``, as in ``truth.json``.
        answer: JSON with the ``pixel_from_patient`` of another method.
    """

    ct: Path
    radiograph: Path
    view: str
    sdd_mm: float | None = None
    pixel_mm: float | None = None
    intensity: str = "auto"
    mirrored: bool | None = None
    targets: Path | None = None
    truth: Path | None = None
    answer: Path | None = None


_FILES = ("ct", "radiograph", "targets", "truth", "answer")
_LENGTHS = ("sdd_mm", "pixel_mm")
_NEEDED = ("ct", "radiograph", "view")


def read_pairs(path: str | Path) -> dict[str, Pair]:
    """The pairs of a file, by name; their paths are relative to it.

    Raises ``RegtorchError`` for a file that cannot be read, and for unknown or missing entries.
    """
    path = Path(path)
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise RegtorchError(f"{path}: cannot be read ({error}), expected YAML with the pairs") from None
    if not isinstance(content, dict) or not content:
        raise RegtorchError(f"{path}: no pairs, expected NAME: {{ct: FILE, radiograph: FILE, view: PA}}")
    return {str(name): _pair(f"{path}: pair {name}", facts, path.parent) for name, facts in content.items()}


def _pair(where: str, facts: Any, folder: Path) -> Pair:
    known = [field.name for field in fields(Pair)]
    if not isinstance(facts, dict):
        raise RegtorchError(f"{where} is {facts!r}, expected entries of {', '.join(known)}")
    if unknown := [name for name in facts if name not in known]:
        raise RegtorchError(f"{where}: unknown entry {unknown[0]!r}, expected of {', '.join(known)}")
    if missing := [name for name in _NEEDED if facts.get(name) is None]:
        raise RegtorchError(f"{where}: no {missing[0]!r}, expected ct, radiograph and view")
    files = {name: folder / str(facts[name]) for name in _FILES if facts.get(name) is not None}
    return Pair(**{**facts, **files, **{name: _length(where, name, facts[name]) for name in _LENGTHS if name in facts}})


def _length(where: str, name: str, value: Any) -> float | None:
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < math.inf:
        raise RegtorchError(f"{where}: {name} {value!r}, expected a positive number")
    return float(value)


def read_matrix(path: Path) -> Float[Tensor, "3 4"]:
    """``pixel_from_patient`` of a JSON file: LPS mm to (column, row) of the stored image."""
    try:
        matrix = torch.tensor(json.loads(path.read_text())["pixel_from_patient"], dtype=torch.float64)
    except (OSError, UnicodeDecodeError, ValueError, TypeError, KeyError) as error:
        raise RegtorchError(f"{path}: cannot be read ({error}), expected JSON with pixel_from_patient") from None
    if matrix.shape != (3, 4) or not bool(matrix.isfinite().all()):
        raise RegtorchError(f"{path}: pixel_from_patient of shape {tuple(matrix.shape)}, expected 3 x 4 finite numbers")
    return matrix
