"""Tables of registrations on disk: rows are appended one by one, to be resumed; needs no torch."""

import csv
import io
import os
import socket
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from itertools import zip_longest
from pathlib import Path
from typing import Any

import pandas as pd
from omegaconf import DictConfig, OmegaConf

from regtorch.errors import RegtorchError
from regtorch.report.rows import MERGED, TABLES

try:
    import fcntl
except ImportError:  # not a Unix
    fcntl = None

SETTINGS = "settings.yaml"


def parse_shard(shard: str | None) -> tuple[int, int]:
    """Number and count of ``i/n``; None is the whole. Raises ``RegtorchError`` for anything else."""
    if shard is None:
        return 0, 1
    number, _, count = str(shard).partition("/")
    if not (number.isdecimal() and count.isdecimal() and int(number) < int(count)):
        raise RegtorchError(f"shard={shard}: expected i/n, i from 0 to n - 1")
    return int(number), int(count)


def table_name(shard: str | None) -> str:
    return "registrations.csv" if shard is None else f"registrations-{parse_shard(shard)[0]}.csv"


def refuse_to_mix(config: DictConfig, folder: Path, cases: Iterable[str], parts: Iterable[str] = ()) -> dict[str, Any]:
    """Settings that all rows of a folder share: those but ``cases``, which say what was asked for.

    Settings that are ``parts`` by name may get further ones. Raises ``RegtorchError`` where one is not as kept there.
    """
    own = {key: value for key, value in OmegaConf.to_container(config).items() if key not in cases}
    kept = folder / SETTINGS
    if kept.exists():
        before = OmegaConf.to_container(OmegaConf.load(kept))
        changed = [key for key in own | before if key not in parts and own.get(key, ...) != before.get(key, ...)]
        if changed:  # or only written in another way, as ``arm: ${dof}-DOF`` and ``arm: 9-DOF``
            now, then = (OmegaConf.to_container(each, resolve=True) for each in (config, OmegaConf.load(kept)))
            changed = [key for key in changed if now.get(key, ...) != then.get(key, ...)]
        for key in parts:
            old = before.get(key, {})
            changed += [f"{key}.{name}" for name in old if own[key].get(name, old[name]) != old[name]]
            own[key] = old | own[key]
        if changed:
            raise RegtorchError(f"{folder}: made with another {changed[0]!r}, expected that of {kept} or another out=")
    return own


def keep(config: DictConfig, folder: Path, cases: Iterable[str], parts: Iterable[str] = ()) -> None:
    """Writes ``settings.yaml``, at one stroke: other processes may read and write it at the same time.

    Raises ``RegtorchError`` where ``refuse_to_mix`` does, also if another process has just written others.
    """
    folder.mkdir(parents=True, exist_ok=True)
    whole = folder / f".{socket.gethostname()}-{os.getpid()}.yaml"
    try:
        whole.write_text(OmegaConf.to_yaml(OmegaConf.create(refuse_to_mix(config, folder, cases, parts))))
        os.link(whole, folder / SETTINGS)
    except OSError:  # another process was first, or the file system has no links
        whole.write_text(OmegaConf.to_yaml(OmegaConf.create(refuse_to_mix(config, folder, cases, parts))))
        os.replace(whole, folder / SETTINGS)
    finally:
        whole.unlink(missing_ok=True)


@contextmanager
def locked(table: Path) -> Iterator[None]:
    """Keeps other processes from the table, by a lock on a file beside it, where the system has locks.

    Raises ``RegtorchError`` where another process has it.
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


def done(folder: Path, key: list[str]) -> set[tuple[str, ...]]:
    """The cases, as the columns of ``key`` name them, in the tables of a folder and in the merged one beside it."""
    tables = [csv.DictReader(io.StringIO(whole_lines(table), newline="")) for table in folder.glob(TABLES)]
    found = {tuple(row[column] for column in key) for rows in tables for row in rows}
    if (merged := folder.parent / MERGED).is_file():
        found |= set(pd.read_parquet(merged, columns=key).astype(str).itertuples(index=False, name=None))
    return found


def whole_lines(table: Path) -> str:
    """A table without what a kill left of a last row."""
    return table.read_bytes()[: _whole_size(table)].decode()


def append(table: Path, row: Mapping[str, Any]) -> None:
    """Adds a row, after the header if it is the first, in place of what a kill left of one.

    Raises ``RegtorchError`` where the header is of other columns.
    """
    lines = io.StringIO()
    writer = csv.DictWriter(lines, row)
    with table.open("ab", buffering=0) as file:
        size = _whole_size(table)
        file.truncate(size)
        if not size:
            writer.writeheader()
        elif (header := _header(table)) != [*row]:
            was, wanted = next(pair for pair in zip_longest(header, row) if pair[0] != pair[1])
            raise RegtorchError(f"{table}: column {was!r} where {wanted!r} is expected, or another out=")
        writer.writerow(row)
        file.write(lines.getvalue().encode())


def _header(table: Path) -> list[str]:
    with table.open(newline="", encoding="utf-8") as file:
        return next(csv.reader(file))


def _whole_size(table: Path) -> int:
    return table.read_bytes().rfind(b"\n") + 1
