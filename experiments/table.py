"""Tables of registrations on disk: rows are appended one by one, to be resumed; needs no torch."""

import csv
import io
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from regtorch.errors import RegtorchError

TABLES = "registrations*.csv"
"""Names of the tables in a study's folder: one, or one of each process that works on it."""


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


def refuse_to_mix(config: DictConfig, folder: Path, cases: Iterable[str], parts: Iterable[str] = ()) -> None:
    """Rows of one folder share all settings but ``cases``, which say what was asked for; ``settings.yaml`` keeps them.

    Settings that are ``parts`` by name may get further ones. Raises ``RegtorchError`` where a setting has changed.
    """
    own = {key: value for key, value in OmegaConf.to_container(config).items() if key not in cases}
    kept, before = folder / "settings.yaml", {}
    if kept.exists():
        before = OmegaConf.to_container(OmegaConf.load(kept))
        changed = [key for key in own if key not in parts and own[key] != before.get(key)]
        for key in parts:
            old = before.get(key, {})
            changed += [f"{key}.{name}" for name in old if own[key].get(name, old[name]) != old[name]]
            own[key] = old | own[key]
        if changed:
            raise RegtorchError(f"{folder}: made with another {changed[0]!r}, expected that of {kept} or another out=")
    if own != before:
        folder.mkdir(parents=True, exist_ok=True)
        whole = kept.with_name(f".settings-{os.getpid()}.yaml")  # other processes may read and write at the same time
        whole.write_text(OmegaConf.to_yaml(OmegaConf.create(own)))
        os.replace(whole, kept)


def done(folder: Path, key: Iterable[str]) -> set[tuple[str, ...]]:
    """The cases, as the columns of ``key`` name them, that the folder's tables have."""
    return {tuple(row[column] for column in key) for table in folder.glob(TABLES) for row in _whole_rows(table)}


def append(table: Path, row: Mapping[str, Any]) -> None:
    """Adds a row, after the header if it is the first, in place of what a kill left of one."""
    lines = io.StringIO()
    writer = csv.DictWriter(lines, row)
    with table.open("ab", buffering=0) as file:
        size = _whole_size(table)
        file.truncate(size)
        if not size:
            writer.writeheader()
        writer.writerow(row)
        file.write(lines.getvalue().encode())


def _whole_size(table: Path) -> int:
    """Bytes up to the end of the last line: a kill may have cut one short."""
    return table.read_bytes().rfind(b"\n") + 1


def _whole_rows(table: Path) -> csv.DictReader:
    text = table.read_bytes()[: _whole_size(table)].decode()
    return csv.DictReader(io.StringIO(text, newline=""))
