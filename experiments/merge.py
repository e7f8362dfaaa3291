"""Gathers the tables of a study's arms into one Parquet file: python -m experiments.merge results/simulation

Needs no torch. Rows are sorted by arm, view and seed, so that the same rows make the same table whoever made them.
"""

import argparse
import sys
from pathlib import Path

import pandas as pd

from experiments.table import whole_lines
from regtorch.errors import RegtorchError
from regtorch.files import written_whole
from regtorch.report.rows import MERGED, TABLES, read_table

KEY = ["arm", "view", "seed"]

_TYPES = {"within_region": "boolean", "message": "string"}


def merge(out: Path) -> pd.DataFrame:
    """All rows of OUT/ARM/registrations*.csv, numbers as float32, also written to OUT/registrations.parquet.

    Rows that this has already, and no other table, stay. Raises ``RegtorchError`` where there are none, where one is
    there twice, or where tables are not of this study's kind or not of the same columns.
    """
    paths = [path for path in sorted(out.glob(f"*/{TABLES}")) if whole_lines(path)]  # a kill may come before the header
    tables = {path: read_table(whole_lines(path), _TYPES) for path in paths}
    if (out / MERGED).is_file():
        tables[out / MERGED] = pd.read_parquet(out / MERGED)
    if not tables:
        raise RegtorchError(f"{out}: no {TABLES} in any folder of it, expected those of a study")
    columns = [*next(iter(tables.values()))]
    for path, table in tables.items():
        if missing := [name for name in KEY if name not in table]:
            raise RegtorchError(f"{path}: no column {missing[0]!r}, expected a table of the simulation study")
        if [*table] != columns:
            raise RegtorchError(f"{path}: other columns than {next(iter(tables))}, expected the same")
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


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, nargs="?", default=Path("results/simulation"))
    try:
        merged = merge(parser.parse_args().folder)
    except RegtorchError as error:
        sys.exit(f"merge: error: {error}")
    for arm, of_arm in merged.groupby("arm"):
        versions = of_arm["version"].nunique() if "version" in of_arm else 1
        print(f"{arm}: {len(of_arm)} registrations" + (f", of {versions} versions" if versions > 1 else ""))
