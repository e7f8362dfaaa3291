"""The cases of the benchmark that need a GPU; without one their rows say 'not measured'."""

import statistics
import time
from collections.abc import Callable, Sequence
from typing import Any

import torch

from experiments.benchmark.cases import Bench, Row, relative
from experiments.benchmark.limits import GROUP_BYTES, bytes_per_second, device_name, samples_all, samples_needed
from experiments.benchmark.scene import Scene
from experiments.benchmark.timing import Run, alternate
from regtorch.drr import render
from regtorch.similarity.gram import fixed_gradients

_DEVICE = "cuda"
_CACHE_MB, _MEMORY_MB = 16, 2048


def or_not_measured(case: Callable[..., list[Row]]) -> Callable[..., list[Row]]:
    def measured(bench: Bench, **options: Any) -> list[Row]:
        if torch.cuda.is_available():
            return case(bench, **options)
        return [{"implementation": "regtorch", "device": "no GPU", "per_second": "not measured"}]

    return measured


@or_not_measured
def limits(bench: Bench) -> list[Row]:
    """Bytes per second from cache and from memory."""
    name = device_name(_DEVICE)
    return [
        {"implementation": f"bytes from {what}", "device": name, "per_second": bytes_per_second(_DEVICE, megabytes)}
        for what, megabytes in (("cache", _CACHE_MB), ("memory", _MEMORY_MB))
    ]


@or_not_measured
def paper_budget(bench: Bench, *, levels: Sequence[dict[str, Any]]) -> list[Row]:
    """As many evaluations of gradient correlation as the paper's registration needed, from poses to numbers."""
    from regtorch.scoring import gradient_correlations

    scenes = [bench.scenes.scene(**level).on(_DEVICE) for level in levels]
    scored = []
    for scene in scenes:
        start = bench.scenes.start(scene.detector)[None].to(_DEVICE)
        fixed = fixed_gradients(render(scene.volume, start[0], scene.detector, scene.view), None)
        scored.append((scene.volume, scene.poses, scene.detector, scene.view, fixed))
    for volume, poses, *rest in scored:
        gradient_correlations(volume, poses[:1024], *rest)
    seconds = []
    for _ in range(bench.config.repeats):
        torch.cuda.synchronize()
        start = time.perf_counter()
        found = [gradient_correlations(*arguments) for arguments in scored]
        torch.cuda.synchronize()
        seconds.append(time.perf_counter() - start)
    assert all(bool(torch.isfinite(some).all()) for some in found)
    count, median = sum(len(scene.poses) for scene in scenes), statistics.median(seconds)
    needed = sum(len(scene.poses) * samples_needed(*_few(scene)) for scene in scenes)
    every = sum(len(scene.poses) * samples_all(*_few(scene)) for scene in scenes)
    return [
        {
            "implementation": "regtorch",
            "device": device_name(_DEVICE),
            "per_second": count / median,
            "times_regtorch": 1.0,
            "share_of_limit": needed * GROUP_BYTES / median / bytes_per_second(_DEVICE, _CACHE_MB),
            "samples_per_second": every / median,
            "seconds": median,
            "seconds_spread": (max(seconds) - min(seconds)) / median,
            "poses": count,
        }
    ]


@or_not_measured
def against_nanodrr(
    bench: Bench, *, pixels: int, voxel_mm: float, samples: Sequence[int | None], poses: int | None = None
) -> list[Row]:
    """Images alone, against nanodrr's fused Triton backend with so many samples a ray, all poses at once."""
    from experiments.benchmark.peers import nanodrr

    scene = bench.scenes.scene(pixels, voxel_mm, poses).on(_DEVICE)
    place = scene.detector, scene.view
    most, threads = len(scene.poses), bench.config.threads
    runs = [Run("regtorch", lambda n: render(scene.volume, scene.poses[:n], *place), most, threads)]
    ours = render(scene.volume, scene.poses[:2], *place)
    for count in samples:
        name = "nanodrr Triton" + (f", {count} samples" if count else "")
        try:
            images = nanodrr(scene.volume, *place, threads, samples=count, at_once=most, backend="triton")
        except ImportError as error:
            bench.say(f"{name}: not installed ({error})")
            continue
        difference = relative(images(scene.poses[:2]), ours)
        if difference > bench.config.tolerance:
            bench.say(f"{name}: images differ from regtorch's by {difference:.1%}, so it is not timed")
            continue
        work = lambda n, its=images: its(scene.poses[:n])  # noqa: E731
        runs.append(Run(name, work, most, threads, relative_difference=difference))
    alternate(runs, bench.config.repeats, bench.config.least_s, bench.config.most_s)
    cache = bytes_per_second(_DEVICE, _CACHE_MB)
    rows = []
    for run in runs:
        row = {
            "implementation": run.name,
            "device": device_name(_DEVICE),
            "per_second": run.per_second,
            "times_regtorch": runs[0].per_second / run.per_second,
            "relative_difference": run.relative_difference,
            "seconds": run.median_s / run.calls,
            "seconds_spread": run.spread,
            "poses": run.poses,
            "pixels": pixels,
            "voxel_mm": voxel_mm,
        }
        if run is runs[0]:
            row["share_of_limit"] = run.per_second * samples_needed(*_few(scene)) * GROUP_BYTES / cache
            row["samples_per_second"] = run.per_second * samples_all(*_few(scene))
        rows.append(row)
    return rows


def _few(scene: Scene) -> tuple[Any, ...]:
    return scene.volume, scene.poses[:2], scene.detector, scene.view
