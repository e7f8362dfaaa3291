"""Reads the registrations of a study from all tables of its folder; needs no torch."""

import re
from collections.abc import Mapping
from io import StringIO
from pathlib import Path

import pandas as pd

from regtorch.errors import RegtorchError

PARAMETERS = (
    "x_s_mm", "y_s_mm", "z_s_mm", "x_obj_mm", "y_obj_mm", "z_obj_mm", "eta_deg", "theta_deg", "phi_deg",
)  # fmt: skip

_NAMES = ("arm", "pair", "ct", "view", "kind")
_KEYS = (*_NAMES, "dof", "radiograph_threshold_hu")
"""Columns that name a registration, besides its seed, in one study or another."""

_PLACES = ("pair", "ct", "view", "kind")
"""Columns that name a case, besides its seed. Registrations of different cases are not compared."""

MERGED, TABLES = "registrations.parquet", "registrations*.csv"
"""The name of a study's merged table, and of the tables in a folder: one for each process that works there."""

FAILED_MM, GOOD_MM = 5.0, 2.0
"""PDE over which a registration has failed, and PDE under which it should be trusted."""

DECOY = "decoy_"
"""Begins the kind of a radiograph that fits nowhere."""

_NUMBERS = ("initial_pde_mm", "pde_mm", "evaluations", "seconds")
_KNOWN = ("view", "seed", "status", *_NUMBERS)


def tables_of(folder: Path) -> dict[str, list[Path]]:
    """The tables of each arm of a study, by the arm's name; tables of ``folder`` itself have the name ''.

    A table of the folder holds the rows of all arms. The arms may have more rows than a merged table.
    """
    own = {"": tables} if (tables := _tables_in(folder)) else {}
    if own and not (folder / MERGED).is_file():
        return own
    folders = sorted((path for path in folder.iterdir() if path.is_dir()), key=lambda path: natural(path.name))
    return own | {path.name: tables for path in folders if (tables := _tables_in(path))}


def read_rows(folder: Path) -> pd.DataFrame:
    """One row per registration; ``arm`` is the folder's name where each arm has its own.

    Raises ``RegtorchError`` where there is no table, or one that cannot be read or is not of registrations.
    """
    if not folder.is_dir():
        raise RegtorchError(f"{folder}: no such folder, expected one of a study")
    tables = tables_of(folder)
    if not tables:
        raise RegtorchError(f"{folder}: no {MERGED} or {TABLES}, expected one there or in its folders")
    parts = []
    for arm, paths in tables.items():
        begun = [some for path in paths if not (some := _read(path)).empty]
        if not begun:
            continue
        part = pd.concat(begun, ignore_index=True)
        if arm and "arm" not in part:
            part["arm"] = arm
        elif arm:  # its own, or one of several in a merged table
            part["arm"] = part.arm.where(part.arm == arm, f"{arm}, " + part.arm)
        parts.append(part)
    if not parts:
        raise RegtorchError(f"{folder}: tables without rows, expected registrations")
    rows = pd.concat(parts, ignore_index=True)
    return rows.drop_duplicates([*_named(rows), "seed"], keep="last", ignore_index=True)


def read_table(text: str, types: Mapping[str, str] | None = None) -> pd.DataFrame:
    """The rows of a table's CSV. Names stay texts, even ``010`` and ``NA``; ``types`` are of other columns."""
    rows = pd.read_csv(StringIO(text), dtype=types)
    names = pd.read_csv(StringIO(text), usecols=lambda column: column in _NAMES, dtype=str, keep_default_na=False)
    return rows.assign(**names)


def keys_of(rows: pd.DataFrame) -> list[str]:
    """The columns that tell groups of registrations apart: those that vary, and vary within an arm; never the seed."""
    keys = [key for key in _named(rows) if rows[key].nunique(dropna=False) > 1]
    if "arm" not in keys:
        return keys
    return [key for key in keys if key == "arm" or rows.groupby("arm")[key].nunique(dropna=False).max() > 1]


def cases_of(rows: pd.DataFrame) -> list[str]:
    """The columns in which compared registrations of two arms agree: the case, and all that vary within an arm."""
    varying = {*keys_of(rows), *(key for key in _PLACES if key in rows and rows[key].nunique(dropna=False) > 1)}
    return [*(key for key in _named(rows) if key in varying and key != "arm"), "seed"]


def groups_of(rows: pd.DataFrame, keys: list[str]) -> list[tuple[tuple[str, ...], pd.DataFrame]]:
    """Names and rows of each group, in natural order; without keys one group of all rows."""
    if not keys:
        return [((), rows)]
    named = [(tuple(map(shown, names)), some) for names, some in rows.groupby(keys, sort=False, dropna=False)]
    return sorted(named, key=lambda group: [natural(name) for name in group[0]])


def natural(name: str) -> list[str | float]:
    """A key that sorts numbers within names by their value."""
    parts = re.split(r"(\d+(?:\.\d+)?)", name)
    parts[1::2] = map(float, parts[1::2])
    return parts


def shown(value: object) -> str:
    """A key's value as readers see it: files without suffix, whole numbers without a point."""
    if pd.isna(value):
        return "none"
    if isinstance(value, float):
        return f"{value:g}"
    return re.sub(r"\.(nii(\.gz)?|nrrd|mha)$", "", str(value))


def _tables_in(folder: Path) -> list[Path]:
    merged = folder / MERGED
    return [*([merged] if merged.is_file() else []), *sorted(folder.glob(TABLES))]


def _read(path: Path) -> pd.DataFrame:
    """The rows of one table; an empty frame where a kill left no header."""
    try:
        if path.suffix == ".parquet":
            rows = pd.read_parquet(path)
        else:
            text = path.read_text(encoding="utf-8")
            text = text[: text.rfind("\n") + 1]  # the last row may be being written
            if not text:
                return pd.DataFrame()
            rows = read_table(text)
    except (OSError, ValueError) as error:
        raise RegtorchError(f"{path}: cannot be read ({error}), expected a table of registrations") from None
    if missing := [column for column in _KNOWN if column not in rows]:
        raise RegtorchError(f"{path}: no column {missing[0]!r}, expected a table of registrations")
    if wrong := [column for column in _NUMBERS if not pd.api.types.is_numeric_dtype(rows[column])]:
        raise RegtorchError(f"{path}: {wrong[0]} is not of numbers, expected a table of registrations")
    rows = rows[rows.status.notna()]  # missing where a kill cut a row short
    kinds = dict.fromkeys(rows.select_dtypes("category"), str)
    return rows.astype(kinds | dict.fromkeys(rows.select_dtypes("float32"), "float64"))


def _named(rows: pd.DataFrame) -> list[str]:
    return [key for key in _KEYS if key in rows]
