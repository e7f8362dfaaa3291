"""Output folders that are written whole or not at all."""

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from regtorch.errors import RegtorchError


@contextmanager
def output_folder(path: str | Path) -> Iterator[Path]:
    """A temporary folder whose files are moved to ``path`` when the block ends well; otherwise nothing stays behind.

    Raises ``RegtorchError`` at once when ``path`` cannot be written.
    """
    path = Path(path)
    missing = [folder for folder in (path, *path.parents) if not folder.exists()]
    try:
        path.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=".regtorch-", dir=path))
    except OSError as error:
        _remove_empty(missing)
        raise RegtorchError(f"{path}: {error.strerror}, expected a folder to write to") from None
    try:
        yield temporary
        for file in temporary.iterdir():
            os.replace(file, path / file.name)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        _remove_empty(missing)


def _remove_empty(folders: list[Path]) -> None:
    for folder in folders:
        if folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()
