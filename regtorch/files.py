"""Output folders that are written whole or not at all, and the text files in them."""

import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from regtorch.errors import RegtorchError


@contextmanager
def output_folder(path: str | Path, names: Iterable[str] = ()) -> Iterator[Path]:
    """A temporary folder whose files are moved to ``path`` when the block ends well; otherwise nothing stays behind.

    Raises ``RegtorchError`` at once when ``path``, or the files in it that will have these ``names``, cannot be
    written. Other files in ``path`` stay.
    """
    if not str(path):  # which pathlib takes for the current folder
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


def write_text(path: Path, text: str) -> None:
    """Raises ``RegtorchError`` where ``path`` cannot be written."""
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise RegtorchError(f"{path}: {error.strerror}, expected a file to write to") from None


def _remove_empty(folders: list[Path]) -> None:
    for folder in folders:
        with suppress(OSError):  # not empty, or never made
            folder.rmdir()
