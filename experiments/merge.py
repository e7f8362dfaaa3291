"""Gathers the tables of a study's arms into one Parquet file: python -m experiments.merge results/simulation

Needs no torch. Rows are sorted by arm, view and seed, so that the same rows make the same table whoever made them.
"""

import sys
from pathlib import Path

import pandas as pd

from experiments.table import TABLES, whole_lines
from regtorch.errors import RegtorchError
from regtorch.report.rows import read_table

MERGED = "registrations.parquet"

KEY = ["arm", "view", "seed"]

_TYPES = {"within_region": "boolean", "message": "string"}


def merge(out: Path) -> pd.DataFrame:
    """All rows of OUT/ARM/registrations*.csv, numbers as float32, also written to OUT/registrations.parquet.

    Raises ``RegtorchError`` where there are none, or where one is there twice.
    """
    texts = [whole_lines(path) for path in sorted(out.glob(f"*/{TABLES}"))]
    tables = [read_table(text, _TYPES) for text in texts if text]  # none where a kill came before the header
    if not tables:
        raise RegtorchError(f"{out}: no {TABLES} in any folder of it, expected those of a study")
    rows = pd.concat(tables).sort_values(KEY, ignore_index=True)
    if twice := rows[rows.duplicated(KEY)][KEY].to_numpy().tolist():
        raise RegtorchError(f"{out}: {', '.join(map(str, twice[0]))} is there twice, expected each registration once")
    numbers = list(rows.select_dtypes("float64"))
    rows = rows.astype(dict.fromkeys(numbers, "float32"))
    small = {"use_dictionary": [name for name in rows if name not in numbers], "use_byte_stream_split": numbers}
    rows.to_parquet(out / MERGED, index=False, compression="zstd", **small)
    return rows


if __name__ == "__main__":
    try:
        merged = merge(Path(sys.argv[1] if len(sys.argv) > 1 else "results/simulation"))
    except RegtorchError as error:
        sys.exit(f"merge: error: {error}")
    for arm, count in merged.arm.value_counts(sort=False).items():
        print(f"{arm}: {count} registrations")
