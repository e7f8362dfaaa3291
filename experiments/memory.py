"""What a process's memory grows by at most while poses are scored: python -m experiments.memory ct=... poses=1000000

Prints megabytes (10^6 bytes) and seconds. The poses themselves are there before. Linux alone tells and resets the peak.
"""

import sys
import time
from pathlib import Path

import torch
from omegaconf import OmegaConf

from experiments.benchmark_scene import Scenes
from experiments.timing import use_threads
from regtorch.drr import render
from regtorch.scoring import gradient_correlations

_OPTIONS = {
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


def main(words: list[str]) -> None:
    options = OmegaConf.merge(_OPTIONS, OmegaConf.from_dotlist(words))
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
    print((_kilobytes("VmHWM") - before) * 1024 / 1e6, seconds)


def _kilobytes(key: str) -> int:
    lines = dict(line.split(":") for line in Path("/proc/self/status").read_text().splitlines())
    return int(lines[key].split()[0])


if __name__ == "__main__":
    main(sys.argv[1:])
