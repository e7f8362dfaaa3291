"""Reading of DICOM headers and pixels: a broken file prints nothing, and its pixels raise ``RegtorchError``."""

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
    """Suppresses the warnings of pydicom and the messages of its decoders."""
    with native_silence(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def read_header(path: Path, keywords: Sequence[str] | None = None) -> Dataset | None:
    """The header without pixels, reduced to ``keywords`` if given; None if the file is not DICOM or is broken."""
    try:
        return pydicom.dcmread(path, stop_before_pixels=True, specific_tags=list(keywords) if keywords else None)
    except Exception:  # for broken files pydicom raises KeyError, struct.error and more
        return None


def read_pixels(path: Path) -> Shaped[ndarray, "*shape"]:
    """Stored values, decompressed. Raises ``RegtorchError`` if they cannot be decoded."""
    try:
        return pydicom.dcmread(path).pixel_array
    except Exception as error:  # each decoder raises exceptions of its own
        raise RegtorchError(f"{path}: pixels cannot be decoded ({one_line(error)}), expected a whole image") from error


def words(header: Dataset, keyword: str) -> list[str]:
    """All values of an attribute as text; an empty list if it is absent or empty."""
    value = header.get(keyword)
    if value is None or value == "":
        return []
    values = [value] if isinstance(value, str | int | float) else list(value)
    return [str(v).strip() for v in values]


def numbers(header: Dataset, keyword: str) -> list[float]:
    """All values of an attribute as numbers; an empty list unless all are finite numbers."""
    try:
        values = [float(v) for v in words(header, keyword)]
    except ValueError:
        return []
    return values if all(math.isfinite(v) for v in values) else []


def number(header: Dataset, keyword: str) -> float | None:
    """The value of an attribute with a single finite number, else None."""
    values = numbers(header, keyword)
    return values[0] if len(values) == 1 else None
