"""The kind of a file, and other libraries' messages about it."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from regtorch.errors import RegtorchError


def is_dicom(path: Path) -> bool:
    """Whether the file has DICOM's preamble."""
    try:
        with path.open("rb") as file:
            return file.read(132)[128:] == b"DICM"
    except OSError as error:
        raise RegtorchError(f"{path}: cannot be read ({error.strerror}), expected a file one may read") from error


@contextmanager
def native_silence() -> Iterator[None]:
    """Drops messages of C++ libraries on the process's standard error; they raise the important ones as well."""
    sys.stderr.flush()
    kept = os.dup(2)
    try:
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
