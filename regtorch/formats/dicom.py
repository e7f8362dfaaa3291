"""DICOM headers and pixels without surprises: an unreadable file ends in a ``RegtorchError``, without other output."""

import math
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pydicom
from jaxtyping import Shaped
from numpy import ndarray
from pydicom import Dataset

from regtorch.errors import RegtorchError
from regtorch.files import one_line
from regtorch.formats.files import native_silence


@contextmanager
def quiet() -> Iterator[None]:
    """Keeps pydicom's warnings and its decoders' messages off the screen."""
    with native_silence(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def read_header(path: Path, keywords: Sequence[str] | None = None) -> Dataset | None:
    """Without pixels, only ``keywords`` if given; None for a file that is not DICOM."""
    try:
        return pydicom.dcmread(path, stop_before_pixels=True, specific_tags=list(keywords) if keywords else None)
    except Exception:  # a broken file of any kind; pydicom raises KeyError, struct.error and more
        return None


def read_pixels(path: Path) -> Shaped[ndarray, "*shape"]:
    """Stored values, decompressed."""
    try:
        return pydicom.dcmread(path).pixel_array
    except Exception as error:  # each decoder raises what it likes
        raise RegtorchError(f"{path}: pixels cannot be decoded ({one_line(error)}), expected a whole image") from error


def words(header: Dataset, keyword: str) -> list[str]:
    """Values as text, however many there are; none where absent or empty."""
    value = header.get(keyword)
    if value is None or value == "":
        return []
    values = [value] if isinstance(value, str | int | float) else list(value)
    return [str(v).strip() for v in values]


def numbers(header: Dataset, keyword: str) -> list[float]:
    """Values as finite numbers; none where absent, empty or something else."""
    try:
        values = [float(v) for v in words(header, keyword)]
    except ValueError:
        return []
    return values if all(math.isfinite(v) for v in values) else []


def number(header: Dataset, keyword: str) -> float | None:
    """A single number, or None."""
    values = numbers(header, keyword)
    return values[0] if len(values) == 1 else None
