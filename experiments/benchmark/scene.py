"""The scene that all implementations render: volumes of one CT, poses about a start, a square detector."""

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import torch
from jaxtyping import Float
from omegaconf import DictConfig
from torch import Tensor

from regtorch.formats import read_volume
from regtorch.geometry import Detector
from regtorch.imaging import BONE_HU, Volume, attenuation, coarsen, crop_to_anatomy
from regtorch.phantom import make_phantom
from regtorch.registration import initial_parameters


@dataclass(frozen=True)
class Scene:
    volume: Volume
    poses: Float[Tensor, "b 9"]
    detector: Detector
    view: str

    def on(self, device: str) -> "Scene":
        volume = self.volume.with_data(self.volume.data.to(device))
        return replace(self, volume=volume, poses=self.poses.to(device))

    @property
    def voxel_mm(self) -> float:
        return float(self.volume.spacing_mm.max())


class Scenes:
    """Makes scenes of one CT and remembers its last volumes."""

    def __init__(self, config: DictConfig) -> None:
        self.config = config
        self.ct = make_phantom(float(config.phantom_spacing_mm))[0] if config.ct is None else read_volume(config.ct)
        self.volume = lru_cache(maxsize=3)(self._volume)

    def scene(
        self, pixels: int, voxel_mm: float | None, poses: int | None = None, threshold_hu: float | None = BONE_HU
    ) -> Scene:
        """``voxel_mm``: None is the CT's own; ``poses``: None is the study's number."""
        return self._of(self.volume(threshold_hu, voxel_mm), pixels, poses)

    def classes(self, pixels: int, voxel_mm: float, poses: int | None = None) -> dict[str, Scene]:
        """All tissue; bone and the rest as two classes; bone alone: on one grid."""
        everything, bone = (
            _in_air(coarsen(attenuation(self.ct, threshold_hu=hu), float(voxel_mm))) for hu in (None, BONE_HU)
        )
        both = replace(everything, data=torch.stack([bone.data, everything.data - bone.data]))
        volumes = {"all tissue": everything, "two classes": both, "bone alone": bone}
        return {name: self._of(volume, pixels, poses) for name, volume in volumes.items()}

    def forget(self) -> None:
        """The volumes: they stay only where they are used."""
        self.volume.cache_clear()

    def start(self, detector: Detector) -> Float[Tensor, "9"]:
        return initial_parameters(self.ct, detector, self.config.view)

    def draw(self, detector: Detector, poses: int) -> Float[Tensor, "poses 9"]:
        limits = self.config.range
        half = torch.tensor(
            [*limits.source_mm, *limits.patient_mm, *[math.radians(limits.rotation_deg)] * 3], dtype=torch.float64
        )
        generator = torch.Generator().manual_seed(self.config.seed)
        return self.start(detector) + half * (2 * torch.rand(poses, 9, generator=generator, dtype=torch.float64) - 1)

    def _of(self, volume: Volume, pixels: int, poses: int | None) -> Scene:
        detector = Detector(pixels, pixels, self.config.detector_mm / pixels)
        drawn = self.draw(detector, self.config.poses if poses is None else poses)
        return Scene(volume, drawn, detector, self.config.view)

    def _volume(self, threshold_hu: float | None, voxel_mm: float | None) -> Volume:
        volume = attenuation(crop_to_anatomy(self.ct, threshold_hu=threshold_hu), threshold_hu=threshold_hu)
        return _in_air(volume if voxel_mm is None else coarsen(volume, float(voxel_mm)))


def _in_air(volume: Volume) -> Volume:
    """With one voxel of air around it: how a projector treats the outermost voxels is its own."""
    patient_from_voxel = volume.patient_from_voxel.clone()
    patient_from_voxel[:, 3] = volume.patient_from_voxel @ torch.tensor([-1, -1, -1, 1], dtype=torch.float64)
    return volume.on_grid(torch.nn.functional.pad(volume.data, (1,) * 6), patient_from_voxel)
