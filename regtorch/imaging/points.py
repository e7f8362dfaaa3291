"""Points on the anatomy, spread evenly: what accuracy is asked of where nobody named targets."""

import csv
import math
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.errors import RegtorchError
from regtorch.imaging.averaging import coarsen
from regtorch.imaging.files import one_line
from regtorch.imaging.volume import Volume

_GRID_MM = 6.0


def spread_points(volume: Volume, n: int) -> Float[Tensor, "n 3"]:
    """Up to ``n`` places (LPS mm) in the denser half of what attenuates, each as far as can be from those before it.

    The first is the one nearest to the middle of them all. Deterministic.
    """
    coarse = coarsen(volume, _GRID_MM)
    dense = coarse.data >= coarse.data[coarse.data > 0].median()
    index = dense.nonzero().flip(1).cpu().double()
    candidates = index @ coarse.patient_from_voxel[:3, :3].mT + coarse.patient_from_voxel[:3, 3]
    chosen = [int((candidates - candidates.mean(0)).norm(dim=1).argmin())]
    distance = torch.full((len(candidates),), torch.inf, dtype=torch.float64)
    while len(chosen) < min(n, len(candidates)):
        distance = torch.minimum(distance, (candidates - candidates[chosen[-1]]).norm(dim=1))
        chosen.append(int(distance.argmax()))
    return candidates[chosen]


def read_points(path: str | Path) -> dict[str, tuple[float, float, float]]:
    """Named points (LPS mm) of a CSV file with the columns name, x, y, z."""
    path = Path(path)
    points: dict[str, tuple[float, float, float]] = {}
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            for number, line in enumerate(csv.reader(file), 1):
                if not line or (not points and line[1:4] == ["x", "y", "z"]):
                    continue
                if line[0] in points:
                    raise RegtorchError(f"{path}: line {number} names {line[0]} again, expected each name once")
                points[line[0]] = _coordinates(f"{path}: line {number}", line)
    except OSError as error:
        raise RegtorchError(f"{path}: {error.strerror}, expected a CSV file of name,x,y,z in LPS mm") from None
    except (csv.Error, UnicodeDecodeError) as error:
        raise RegtorchError(f"{path}: no text ({error}), expected a CSV file of name,x,y,z in LPS mm") from None
    if not points:
        raise RegtorchError(f"{path}: no points, expected lines of name,x,y,z in LPS mm")
    return points


def _coordinates(where: str, line: list[str]) -> tuple[float, float, float]:
    try:
        x, y, z = map(float, line[1:])
    except ValueError:
        x = y = z = math.nan
    if not math.isfinite(x + y + z):
        raise RegtorchError(f"{where} is {one_line(line)}, expected name,x,y,z in LPS mm")
    return x, y, z
