"""What NIfTI's C reader passes over in silence: it fills a cut file with zeros and turns NaN into 0."""

import gzip
import zlib
from io import BufferedIOBase
from pathlib import Path

import numpy as np

from regtorch.errors import RegtorchError
from regtorch.files import one_line

_FLOATS = {16: "f4", 64: "f8"}
_BLOCK = 1 << 22


def check_nifti(path: Path) -> None:
    """Raises ``RegtorchError`` for a file that is cut short, damaged or has values that are not finite."""
    opener = gzip.open if path.name.lower().endswith(".gz") else open
    try:
        with opener(path, "rb") as file:
            _check(path, file)
    except (OSError, EOFError, zlib.error) as error:
        raise RegtorchError(f"{path}: cannot be read ({one_line(error)}), expected a whole NIfTI file") from error


def _check(path: Path, file: BufferedIOBase) -> None:
    header = file.read(540)
    order, version = _kind(header)
    if version == 1:
        dimensions, kind, bits = np.frombuffer(header, order + "i2", 8, 40), 70, 72
        offset = int(np.frombuffer(header, order + "f4", 1, 108)[0])
    elif version == 2:
        dimensions, kind, bits = np.frombuffer(header, order + "i8", 8, 16), 12, 14
        offset = int(np.frombuffer(header, order + "i8", 1, 168)[0])
    else:
        raise RegtorchError(f"{path}: no NIfTI header, expected a whole NIfTI file")
    datatype, bits = (int(np.frombuffer(header, order + "i2", 1, at)[0]) for at in (kind, bits))
    wanted = bits // 8 * int(np.prod(dimensions[1 : 1 + max(0, int(dimensions[0]))], dtype=np.int64))
    file.seek(offset)
    length = bad = 0
    while block := file.read(_BLOCK):
        length += len(block)
        if datatype in _FLOATS:
            values = np.frombuffer(block[: len(block) // 8 * 8], order + _FLOATS[datatype])
            bad += values.size - int(np.isfinite(values).sum())
    if length < wanted:
        raise RegtorchError(f"{path}: {length} bytes of voxels where {wanted} belong, expected a whole NIfTI file")
    if bad:
        raise RegtorchError(f"{path}: {bad} voxel(s) are NaN or infinite, expected HU everywhere")


def _kind(header: bytes) -> tuple[str, int]:
    """Byte order and version, 0 for what is not NIfTI."""
    for order in "<>":
        size = int(np.frombuffer(header, order + "i4", 1)[0]) if len(header) >= 352 else 0
        if size == 348 or (size == 540 and len(header) == 540):
            return order, 1 if size == 348 else 2
    return "<", 0
