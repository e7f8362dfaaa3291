"""Volumes, poses and rays that the tests of the projectors share."""

import math
from dataclasses import replace

import numpy as np
import torch

from regtorch.geometry import Detector, world_from_ct
from regtorch.imaging import Volume


def volume_of(data: torch.Tensor, spacing: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> Volume:
    """Attenuation per mm on a grid along the patient axes, centred on the origin."""
    patient_from_voxel = torch.diag(torch.tensor([*spacing, 1.0], dtype=torch.float64))
    last = torch.tensor([n - 1.0 for n in reversed(data.shape)], dtype=torch.float64)
    patient_from_voxel[:3, 3] = -last / 2 * torch.tensor(spacing, dtype=torch.float64)
    return replace(Volume.from_grid(data, patient_from_voxel), unit="per_mm")


def random_volume(
    *shape: int, spacing: tuple[float, float, float] = (1.5, 2.0, 1.0), dtype: torch.dtype = torch.float32
) -> Volume:
    """Dense in some places and empty in others, as thresholded bone is."""
    generator = torch.Generator().manual_seed(sum(shape))
    dense = torch.rand([math.ceil(n / 5) for n in shape], generator=generator) < 0.4
    for axis in range(3):
        dense = dense.repeat_interleave(5, dim=axis)
    values = 0.01 + 0.04 * torch.rand(shape, generator=generator)
    data = torch.where(dense[: shape[0], : shape[1], : shape[2]], values, 0)
    data[shape[0] // 2, shape[1] // 2, shape[2] // 2] = 0.05
    return volume_of(data.to(dtype), spacing)


def smooth_volume() -> Volume:
    """A ball in float64 without jumps between voxels, so that a finite step sees the derivative."""
    k, j, i = torch.meshgrid(*(torch.linspace(-1, 1, n, dtype=torch.float64) for n in (24, 26, 28)), indexing="ij")
    ball = (1 - i.square() - j.square() - k.square()).clamp(min=0).square()
    return volume_of(0.05 * ball * (1 + 0.3 * (3 * i + 2 * j - k).sin()), (1.5, 2.0, 1.0))


def pose_of(
    source: tuple[float, float, float] = (0, 0, 1000),
    patient: tuple[float, float, float] = (0, 0, 300),
    degrees: tuple[float, float, float] = (0, 0, 0),
) -> torch.Tensor:
    return torch.tensor([*source, *patient, *map(math.radians, degrees)], dtype=torch.float64)


def rays_in_ct(pose: torch.Tensor, detector: Detector, view: str) -> tuple[np.ndarray, np.ndarray]:
    """The source, and the pixels (rows, columns, 3): mm of the ``ct`` frame."""
    columns = (np.arange(detector.columns) - (detector.columns - 1) / 2) * detector.pixel_mm + detector.centre_mm[0]
    rows = ((detector.rows - 1) / 2 - np.arange(detector.rows)) * detector.pixel_mm + detector.centre_mm[1]
    y, x = np.meshgrid(rows, columns, indexing="ij")
    ct_from_world = torch.linalg.inv(world_from_ct(pose, view)).numpy()
    pixels = np.stack([x, y, np.zeros_like(x), np.ones_like(x)], axis=-1) @ ct_from_world.T
    return ct_from_world[:3] @ np.append(pose[:3].numpy(), 1), pixels[..., :3]


def relative(found: torch.Tensor, expected: torch.Tensor) -> float:
    """Norm of the difference, relative to the norm of the expected values, or absolute if these are all 0."""
    norm = float(expected.double().norm())
    return float((found.double() - expected.double()).norm()) / (norm if norm > 0 else 1)
