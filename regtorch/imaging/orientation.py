"""Turns a radiograph from its stored orientation to the view from the source."""

from collections.abc import Sequence

import torch
from jaxtyping import Float, Shaped
from torch import Tensor

from regtorch.geometry import world_from_patient_axes

_LETTERS = {"L": (0, 1), "R": (0, -1), "P": (1, 1), "A": (1, -1), "H": (2, 1), "F": (2, -1)}


def directions(view: str) -> tuple[str, str]:
    """DICOM's PatientOrientation of an image seen from the source: the directions in which columns and rows grow.

    >>> directions("PA")
    ('R', 'F')
    """
    x, y, _ = world_from_patient_axes(view).tolist()
    letter = {(axis, float(sign)): name for name, (axis, sign) in _LETTERS.items()}
    names = []
    for direction in (x, [-v for v in y]):
        axis = max(range(3), key=lambda a: abs(direction[a]))
        names.append(letter[axis, direction[axis]])
    return names[0], names[1]


def pixel_axes(
    stored: Sequence[str] | None, view: str, mirrored: bool | None, file_columns: int, file_rows: int
) -> tuple[Float[Tensor, "3 3"], str | None]:
    """The matrix ``stored_from_pixel`` that turns a stored image into ``view``, and a warning or None.

    Args:
        stored: PatientOrientation of the stored image; only the first letter of a compound direction counts.
            Directions that ``view`` cannot have leave the image as stored and give the warning.
        view: View seen from the source.
        mirrored: Whether the stored image is mirrored left to right; unless None, this overrules ``stored``.
        file_columns: Width of the stored image in pixels.
        file_rows: Height of the stored image in pixels.
    """
    wanted = directions(view)
    transposed, flips, complaint = False, (False, False), None
    if stored:
        found = [_LETTERS.get(str(s)[:1].upper()) for s in stored]
        want = [_LETTERS[w] for w in wanted]
        axes = [f[0] if f else None for f in found]
        if axes in ([w[0] for w in want], [w[0] for w in reversed(want)]):
            transposed = axes[0] != want[0][0]
            if transposed:
                found = found[::-1]
            flips = found[0][1] != want[0][1], found[1][1] != want[1][1]
        else:
            complaint = (
                f"PatientOrientation {'/'.join(map(str, stored))} does not fit a {view} view, where "
                f"{'/'.join(wanted)} is seen from the source: taken as stored"
            )
    if mirrored is not None and (transposed ^ flips[0] ^ flips[1]) != mirrored:
        flips = not flips[0], flips[1]
    columns, rows = (file_rows, file_columns) if transposed else (file_columns, file_rows)
    matrix = torch.eye(3, dtype=torch.float64)
    for axis, (flip, count) in enumerate(zip(flips, (columns, rows), strict=True)):
        if flip:
            matrix[axis, axis], matrix[axis, 2] = -1, count - 1
    if transposed:
        matrix = matrix[[1, 0, 2]]
    return matrix, complaint


def turned(stored: Shaped[Tensor, "h w"], stored_from_pixel: Float[Tensor, "3 3"]) -> Shaped[Tensor, "h2 w2"]:
    """The stored image turned by ``stored_from_pixel``, a matrix from ``pixel_axes``."""
    transposed = float(stored_from_pixel[0, 0]) == 0
    image = stored.mT if transposed else stored
    row_of_x, row_of_y = (1, 0) if transposed else (0, 1)
    flipped = [d for d, r, c in ((1, row_of_x, 0), (0, row_of_y, 1)) if float(stored_from_pixel[r, c]) < 0]
    return image.flip(flipped).contiguous()
