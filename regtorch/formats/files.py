"""The kind of a file, and silence for the libraries that read it."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from regtorch.errors import RegtorchError


def is_dicom(path: Path) -> bool:
    """Whether the file has DICOM's preamble. Raises ``RegtorchError`` for a file that cannot be read."""
    try:
        with path.open("rb") as file:
            return file.read(132)[128:] == b"DICM"
    except OSError as error:
        raise RegtorchError(f"{path}: cannot be read ({error.strerror}), expected a file one may read") from error


@contextmanager
def native_silence() -> Iterator[None]:
    """Discards messages of C++ libraries on standard error; the libraries raise an exception for every real error."""
    sys.stderr.flush()
    kept = os.dup(2)
    try:
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
