"""Gathers the tables of a study's arms into one Parquet file; needs no torch."""

from pathlib import Path

import pandas as pd

from experiments.common.registrations import MERGED, TABLES, read_table
from experiments.common.table import whole_lines
from regtorch.errors import RegtorchError
from regtorch.files import written_whole

KEY = ["arm", "view", "seed"]

_TYPES = {"within_region": "boolean", "message": "string"}


def merge(out: Path) -> pd.DataFrame:
    """Writes all rows of OUT/ARM/registrations*.csv to OUT/registrations.parquet, numbers as float32.

    Rows that only the Parquet file has stay. Raises ``RegtorchError`` for a folder without rows, for a registration
    that is there twice, and for tables of another study or of different columns.
    """
    tables = _tables(out)
    kept = tables.pop(out / MERGED, None)
    rows = pd.concat(tables.values(), ignore_index=True) if tables else kept
    if twice := rows[rows.duplicated(KEY)][KEY].to_numpy().tolist():
        raise RegtorchError(f"{out}: {', '.join(map(str, twice[0]))} is there twice, expected each registration once")
    numbers = list(rows.select_dtypes("floating"))
    rows = rows.astype(dict.fromkeys(numbers, "float32"))
    if kept is not None:
        rows = pd.concat([kept, rows], ignore_index=True).drop_duplicates(KEY, keep="last")
    rows = rows.sort_values(KEY, ignore_index=True)
    small = {"use_dictionary": [name for name in rows if name not in numbers], "use_byte_stream_split": numbers}
    with written_whole(out / MERGED, ".parquet") as temporary:
        rows.to_parquet(temporary, index=False, compression="zstd", **small)
    return rows


def _tables(out: Path) -> dict[Path, pd.DataFrame]:
    """The tables of the arms, and the merged table last; all have the same columns."""
    paths = [path for path in sorted(out.glob(f"*/{TABLES}")) if whole_lines(path)]  # a kill may leave no header
    tables = {path: read_table(whole_lines(path), _TYPES) for path in paths}
    if (out / MERGED).is_file():
        tables[out / MERGED] = pd.read_parquet(out / MERGED)
    if not tables:
        raise RegtorchError(f"{out}: no {TABLES} in any folder of it, expected those of a study")
    first = next(iter(tables))
    for path, table in tables.items():
        if missing := [name for name in KEY if name not in table]:
            raise RegtorchError(f"{path}: no column {missing[0]!r}, expected a table of the simulation study")
        if other := {*table}.symmetric_difference(tables[first]):
            raise RegtorchError(f"{path}: other columns than {first}, {min(other)!r} in one alone, expected the same")
    return tables
