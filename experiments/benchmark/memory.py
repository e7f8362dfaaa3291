"""Growth of a process's memory while poses are scored. Only Linux tells and resets the peak."""

import time
from pathlib import Path

import torch
from omegaconf import DictConfig, OmegaConf

from experiments.benchmark.scene import Scenes
from experiments.benchmark.timing import use_threads
from regtorch.drr import render
from regtorch.errors import RegtorchError
from regtorch.scoring import gradient_correlations

OPTIONS = {
    "ct": None,
    "phantom_spacing_mm": 4.0,
    "view": "PA",
    "detector_mm": 350,
    "range": {"source_mm": [25, 25, 50], "patient_mm": [25, 25, 50], "rotation_deg": 5},
    "seed": 0,
    "pixels": 8,
    "voxel_mm": 8.0,
    "poses": 1000,
    "threads": 1,
}


def options_of(words: list[str]) -> DictConfig:
    """The options that ``words``, each NAME=VALUE, change. Raises ``RegtorchError`` for an unknown name."""
    given = OmegaConf.from_dotlist(words)
    if unknown := [name for name in given if name not in OPTIONS]:
        raise RegtorchError(f"{unknown[0]}: no such option, expected of {', '.join(OPTIONS)}")
    return OmegaConf.merge(OPTIONS, given)


def measure(options: DictConfig) -> tuple[float, float]:
    """Megabytes (10^6 bytes) of growth at most, and seconds. The poses themselves are there before."""
    use_threads(options.threads)
    scenes = Scenes(options)
    scene = scenes.scene(options.pixels, options.voxel_mm, options.poses)
    place = scene.detector, scene.view
    fixed = render(scene.volume, scenes.start(scene.detector)[None], *place)[0]
    scenes.forget()
    gradient_correlations(scene.volume, scene.poses[:64], *place, fixed)
    Path("/proc/self/clear_refs").write_text("5")  # the peak starts anew
    before, start = _kilobytes("VmRSS"), time.perf_counter()
    found = gradient_correlations(scene.volume, scene.poses, *place, fixed)
    seconds = time.perf_counter() - start
    assert bool(torch.isfinite(found).all())
    return (_kilobytes("VmHWM") - before) * 1024 / 1e6, seconds


def _kilobytes(key: str) -> int:
    lines = dict(line.split(":") for line in Path("/proc/self/status").read_text().splitlines())
    return int(lines[key].split()[0])
