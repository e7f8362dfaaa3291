"""Tables of registrations on disk: rows are appended one by one, and a later process resumes; needs no torch."""

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pandas as pd

from experiments.common.registrations import MERGED, TABLES
from regtorch.errors import RegtorchError

try:
    import fcntl
except ImportError:  # not a Unix
    fcntl = None


def parse_shard(shard: str | None) -> tuple[int, int]:
    """Number and count of ``i/n``; None is the whole. Raises ``RegtorchError`` for any other text."""
    if shard is None:
        return 0, 1
    number, _, count = str(shard).partition("/")
    if not (number.isdecimal() and count.isdecimal() and int(number) < int(count)):
        raise RegtorchError(f"shard={shard}: expected i/n, i from 0 to n - 1")
    return int(number), int(count)


def table_name(shard: str | None) -> str:
    return "registrations.csv" if shard is None else f"registrations-{parse_shard(shard)[0]}.csv"


@contextmanager
def locked(table: Path) -> Iterator[None]:
    """Keeps other processes from the table, by a lock on a file beside it, where the system has locks.

    Raises ``RegtorchError`` where another process holds the lock.
    """
    table.parent.mkdir(parents=True, exist_ok=True)
    with table.with_name(f".{table.name}.lock").open("w") as file:
        try:
            if fcntl is not None:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise RegtorchError(f"{table}: another process is writing it, expected one at a time") from None
        except OSError:
            pass  # a file system without locks
        yield


def done(folder: Path, key: Sequence[str]) -> set[tuple[str, ...]]:
    """The cases, named by the columns ``key``, in the folder's tables and in the merged table beside the folder.

    Raises ``RegtorchError`` where a table lacks a column of ``key``.
    """
    found = set()
    for table in folder.glob(TABLES):
        rows = csv.DictReader(io.StringIO(whole_lines(table), newline=""))
        if missing := [column for column in key if column not in (rows.fieldnames or key)]:
            raise RegtorchError(f"{table}: no column {missing[0]!r}, expected a table of this study")
        found |= {tuple(row[column] for column in key) for row in rows}
    if (merged := folder.parent / MERGED).is_file():
        found |= set(pd.read_parquet(merged, columns=[*key]).astype(str).itertuples(index=False, name=None))
    return found


def written(value: object) -> str:
    """A case's value as a table holds it."""
    return "" if value is None else str(value)


def refuse_other_columns(folder: Path, columns: Sequence[str]) -> None:
    """Raises ``RegtorchError`` where a table of the folder, or the merged one beside it, has other columns."""
    for table in sorted(folder.glob(TABLES)):
        if _whole_size(table):
            _refuse(table, _header(table), columns)
    if (merged := folder.parent / MERGED).is_file():
        _refuse(merged, [*pd.read_parquet(merged)], columns)


def append(table: Path, row: Mapping[str, Any]) -> None:
    """Adds a row in the order of the table's header, in place of a last row that a kill cut short.

    Raises ``RegtorchError`` where the header has other columns.
    """
    lines = io.StringIO()
    with table.open("ab", buffering=0) as file:
        size = _whole_size(table)
        file.truncate(size)
        columns = _header(table) if size else [*row]
        _refuse(table, columns, row)
        writer = csv.DictWriter(lines, columns)
        if not size:
            writer.writeheader()
        writer.writerow(row)
        file.write(lines.getvalue().encode())


def whole_lines(table: Path) -> str:
    """The table's text, less a last row that a kill cut short."""
    return table.read_bytes()[: _whole_size(table)].decode()


def _refuse(table: Path, header: Sequence[str], columns: Sequence[str] | Mapping[str, Any]) -> None:
    if missing := [column for column in columns if column not in header]:
        raise RegtorchError(f"{table}: no column {missing[0]!r}, begun by another version; out=FOLDER begins anew")
    if unknown := [column for column in header if column not in columns]:
        raise RegtorchError(f"{table}: unknown column {unknown[0]!r}, of another version; out=FOLDER begins anew")


def _header(table: Path) -> list[str]:
    with table.open(newline="", encoding="utf-8") as file:
        return next(csv.reader(file))


def _whole_size(table: Path) -> int:
    return table.read_bytes().rfind(b"\n") + 1
