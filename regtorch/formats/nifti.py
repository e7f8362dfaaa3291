"""Faults that NIfTI's C reader passes over in silence: it fills a cut file with zeros, turns NaN into 0, and chooses
where a header tells two places."""

import gzip
import zlib
from io import BufferedIOBase
from pathlib import Path

import numpy as np
from jaxtyping import Float, Shaped

from regtorch.errors import RegtorchError
from regtorch.files import one_line

_FLOATS = {16: "f4", 64: "f8"}
_BLOCK = 1 << 22


def check_nifti(path: Path) -> tuple[str, ...]:
    """Faults of the header, one line each.

    Raises ``RegtorchError`` for a file that is cut short or damaged. It also does for values that are not finite, and
    for voxels of two sizes or in two places.
    """
    opener = gzip.open if path.name.lower().endswith(".gz") else open
    try:
        with opener(path, "rb") as file:
            return _check(path, file)
    except (OSError, EOFError, zlib.error) as error:
        raise RegtorchError(f"{path}: cannot be read ({one_line(error)}), expected a whole NIfTI file") from error


def _check(path: Path, file: BufferedIOBase) -> tuple[str, ...]:
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
    return _check_place(path, header, order, version, dimensions[1:4])


def _check_place(path: Path, header: bytes, order: str, version: int, size: Shaped[np.ndarray, "3"]) -> tuple[str, ...]:
    """The NIfTI standard's method 2 (qform, of ``pixdim`` and a quaternion) and method 3 (sform, an affine matrix)."""
    kind, code_kind, places = ("f4", "i2", (76, 252, 256, 280)) if version == 1 else ("f8", "i4", (104, 344, 352, 400))
    pixdim = np.frombuffer(header, order + kind, 8, places[0]).astype(float)
    qform, sform = np.frombuffer(header, order + code_kind, 2, places[1]).tolist()
    b, c, d, *offset = np.frombuffer(header, order + kind, 6, places[2]).astype(float).tolist()
    by_sform = np.frombuffer(header, order + kind, 12, places[3]).astype(float).reshape(3, 4)
    voxel = pixdim[1:4]
    if not (np.isfinite(voxel).all() and voxel.min() > 0):
        raise RegtorchError(f"{path}: voxel size (pixdim) {voxel.tolist()} mm, expected three positive numbers")
    if sform > 0:
        columns = np.linalg.norm(by_sform[:, :3], axis=0)
        if _upright(by_sform[:, :3]) and not np.allclose(columns, voxel, rtol=0.01):
            sizes = " and ".join(" x ".join(f"{mm:.3g}" for mm in each) for each in (voxel, columns))
            raise RegtorchError(f"{path}: voxels of {sizes} mm by pixdim and by sform, expected one size")
    if sform > 0 and qform > 0:
        a = max(0.0, 1 - b * b - c * c - d * d) ** 0.5
        turn = np.array(
            [
                [a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)],
                [2 * (b * c + a * d), a * a + c * c - b * b - d * d, 2 * (c * d - a * b)],
                [2 * (b * d - a * c), 2 * (c * d + a * b), a * a + d * d - c * c - b * b],
            ]
        )
        along = voxel * (1, 1, -1 if pixdim[0] < 0 else 1)
        by_qform = np.column_stack([turn * along, offset])
        corners = np.array([[*at, 1] for at in np.ndindex(2, 2, 2)]) * [*(size.astype(float) - 1), 1]
        apart = float(np.linalg.norm(corners @ (by_sform - by_qform).T, axis=1).max())
        if not apart < 0.5 * voxel.min():
            raise RegtorchError(
                f"{path}: sform and qform put voxels up to {apart:.3g} mm apart, expected one place (the other code 0)"
            )
    if sform <= 0 and qform <= 0:
        return ("no orientation is stated (qform and sform codes are 0): rows are taken to run to the left, then back",)
    return ()


def _upright(axes: Float[np.ndarray, "3 3"]) -> bool:
    """Whether columns are at 90 degrees; others the reader refuses."""
    cosines = axes.T @ axes / np.outer(*[np.linalg.norm(axes, axis=0)] * 2)
    return bool(np.abs(cosines - np.eye(3)).max() < 1e-3)


def _kind(header: bytes) -> tuple[str, int]:
    """Byte order and version, 0 for a file that is not NIfTI."""
    for order in "<>":
        size = int(np.frombuffer(header, order + "i4", 1)[0]) if len(header) >= 352 else 0
        if size == 348 or (size == 540 and len(header) == 540):
            return order, 1 if size == 348 else 2
    return "<", 0
