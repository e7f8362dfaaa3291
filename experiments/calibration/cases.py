"""Registrations of any studies as cases of the verdict: their evidence, and whether the answer is right or wrong."""

from collections.abc import Sequence
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any

import pandas as pd

from experiments.common.registrations import DECOY, FAILED_MM, GOOD_MM, read_rows
from regtorch.errors import RegtorchError
from regtorch.registration import Evidence

EVIDENCE = "evidence_"
"""Begins the columns of the evidence."""

_LISTS = ("frozen", "at_limit")
_FLAGS = ("comparable",)
_COUNTS = ("starts", "agreeing", "looks")
_TEXTS = ("tissue",)

_MEASURED = [field.name for field in fields(Evidence) if field.default is MISSING]


@dataclass(frozen=True)
class Case:
    """One registration; ``right`` is None where its PDE lies between the bounds of right and wrong."""

    study: str
    evidence: Evidence
    right: bool | None


def read_cases(folders: Sequence[Path]) -> list[Case]:
    """Cases of all folders. A decoy is wrong wherever it ends.

    Evidence that has a default may have no column, as in older rows. Raises ``RegtorchError`` for rows without other
    evidence.
    """
    cases = []
    for folder in folders:
        rows = read_rows(folder)
        if missing := [name for name in _MEASURED if EVIDENCE + name not in rows]:
            raise RegtorchError(f"{folder}: no column '{EVIDENCE}{missing[0]}', expected rows with evidence")
        decoy = rows.kind.astype(str).str.startswith(DECOY) if "kind" in rows else pd.Series(False, rows.index)
        cases += [
            Case(folder.name, _evidence(row), _right(row["pde_mm"], is_decoy))
            for row, is_decoy in zip(rows.to_dict("records"), decoy, strict=True)
        ]
    return cases


def _right(pde_mm: float, decoy: bool) -> bool | None:
    if decoy or pde_mm > FAILED_MM:
        return False
    return True if pde_mm < GOOD_MM else None


def _evidence(row: dict[str, Any]) -> Evidence:
    """The numbers of a row; an empty cell was not measured."""
    told = {field.name: row[EVIDENCE + field.name] for field in fields(Evidence) if EVIDENCE + field.name in row}
    return Evidence(**{name: _value(name, value) for name, value in told.items()})


def _value(name: str, value: Any) -> Any:
    if name in _LISTS:
        return () if pd.isna(value) else tuple(str(value).split())
    if name in _FLAGS:
        return str(value) == "True"
    if pd.isna(value):
        return None
    if name in _TEXTS:
        return str(value)
    return int(value) if name in _COUNTS else float(value)
