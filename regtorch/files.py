"""Output that is written whole or not at all: folders and files. Messages of one line."""

import os
import secrets
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from regtorch.errors import RegtorchError


@contextmanager
def output_folder(path: str | Path, names: Iterable[str] = ()) -> Iterator[Path]:
    """A temporary folder, whose files move to ``path`` when the block ends without an error.

    After an error nothing stays behind. Other files in ``path`` stay. Raises ``RegtorchError`` before the block if
    ``path``, or a file of ``names`` in it, cannot be written.
    """
    if not str(path):  # pathlib takes it for the current folder
        raise RegtorchError("empty name, expected a folder to write to")
    folder, missing, temporary = Path(path), [], None
    try:
        try:
            missing = [f for f in (folder, *folder.parents) if not f.exists()]
            folder.mkdir(parents=True, exist_ok=True)
            temporary = Path(tempfile.mkdtemp(prefix=".regtorch-", dir=folder))
        except OSError as error:
            raise RegtorchError(f"{folder}: {error.strerror}, expected a folder to write to") from None
        if taken := [name for name in names if (folder / name).is_dir()]:
            raise RegtorchError(f"{folder / taken[0]}: a folder, expected a file to write")
        yield temporary
        for file in temporary.iterdir():
            os.replace(file, folder / file.name)
    finally:
        if temporary is not None:
            shutil.rmtree(temporary, ignore_errors=True)
        _remove_empty(missing)


@contextmanager
def written_whole(path: Path, suffix: str) -> Iterator[Path]:
    """A temporary file beside ``path``, which replaces it when the block ends without an error.

    After an error the temporary file is removed. Raises ``RegtorchError`` if ``path`` cannot be written.
    """
    if path.exists() and not path.is_file():
        raise RegtorchError(f"{path}: no ordinary file, expected one to write to")
    temporary = path.with_name(f".{path.name.removesuffix(suffix)}-{secrets.token_hex(4)}{suffix}")
    try:
        yield temporary
        os.replace(temporary, path)
    except (OSError, RuntimeError) as error:
        why = getattr(error, "strerror", None) or one_line(error)
        raise RegtorchError(f"{path}: {why}, expected a file to write to") from error
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file whole. Raises ``RegtorchError`` if ``path`` cannot be written."""
    with written_whole(path, path.suffix) as temporary:
        temporary.write_text(text, encoding="utf-8")


def one_line(text: object, longest: int = 160) -> str:
    """``text`` without line breaks, cut to ``longest`` characters, for long messages of other libraries."""
    line = " ".join(str(text).split())
    return line if len(line) <= longest else line[: longest - 3] + "..."


def _remove_empty(folders: list[Path]) -> None:
    for folder in folders:
        with suppress(OSError):  # not empty, or never made
            folder.rmdir()
