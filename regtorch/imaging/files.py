"""Files as every reader and writer here needs them: kinds, whole or not at all, messages of one line."""

import os
import secrets
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from regtorch.errors import RegtorchError


def one_line(text: object, longest: int = 160) -> str:
    """``text`` without line breaks, cut to ``longest`` characters: other libraries' messages are long."""
    line = " ".join(str(text).split())
    return line if len(line) <= longest else line[: longest - 3] + "..."


def is_dicom(path: Path) -> bool:
    """Whether the file has DICOM's preamble."""
    try:
        with path.open("rb") as file:
            return file.read(132)[128:] == b"DICM"
    except OSError as error:
        raise RegtorchError(f"{path}: cannot be read ({error.strerror}), expected a file one may read") from error


@contextmanager
def written_whole(path: Path, suffix: str) -> Iterator[Path]:
    """A temporary file beside ``path`` that takes its place when the block ends well and vanishes when it does not."""
    temporary = path.with_name(f".{path.name.removesuffix(suffix)}-{secrets.token_hex(4)}{suffix}")
    try:
        yield temporary
        os.replace(temporary, path)
    except (OSError, RuntimeError) as error:
        raise RegtorchError(f"{path}: cannot be written ({one_line(error)}), expected a folder to write in") from error
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def native_silence() -> Iterator[None]:
    """Drops what C++ libraries print on the process' standard error; what matters they raise as well."""
    sys.stderr.flush()
    kept = os.dup(2)
    try:
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
