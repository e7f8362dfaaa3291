"""The CT of a study, the embedded phantom or any file, with the targets at which accuracy is measured."""

from functools import lru_cache
from pathlib import Path

import torch
from hydra.utils import instantiate
from omegaconf import OmegaConf

from regtorch.errors import RegtorchError
from regtorch.formats import read_points, read_volume
from regtorch.imaging import Volume
from regtorch.phantom import make_phantom
from regtorch.simulation.simulator import bone_points

Targets = dict[str, tuple[float, float, float]]


@lru_cache(maxsize=1)
def read(component: str) -> tuple[Volume, Targets]:
    """CT and targets of a component's YAML, read once for all jobs of a process."""
    return instantiate(OmegaConf.create(component))()


def phantom(*, spacing_mm: float = 1.5) -> tuple[Volume, Targets]:
    """The embedded phantom with cubic voxels of ``spacing_mm``; its targets (LPS mm) are the vertebrae's middles."""
    return make_phantom(spacing_mm)


def ct(*, path: str | Path, targets: str | Path | None = None) -> tuple[Volume, Targets]:
    """A CT from a file or folder, and targets (LPS mm) from a file, or points spread over the bones.

    Raises ``RegtorchError`` for files that are missing or cannot be read.
    """
    volume = read_volume(path)
    return volume, (targets and read_targets(targets, volume)) or bone_points(volume)


def read_targets(path: str | Path, volume: Volume) -> Targets:
    """Named points (LPS mm) of a CT. Raises ``RegtorchError`` where none of them lies in it, as with RAS for LPS."""
    points = read_points(path)
    if points and not bool(volume.holds(torch.tensor([*points.values()], dtype=torch.float64)).any()):
        raise RegtorchError(
            f"{path}: none of its {len(points)} targets lies in the CT, expected LPS mm of the CT's file"
        )
    return points
