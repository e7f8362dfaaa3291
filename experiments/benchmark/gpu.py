"""The cases of the benchmark that need a GPU; without one their rows say 'not measured'."""

import importlib
import importlib.metadata
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import torch

from experiments.benchmark.cases import Bench, Row, relative
from experiments.benchmark.limits import GROUP_BYTES, bytes_per_second, device_name, samples_all, samples_needed
from experiments.benchmark.scene import Scene
from experiments.benchmark.timing import Run, alternate
from regtorch.drr import reference, render
from regtorch.drr.rendering import rays_of
from regtorch.geometry import ray_jacobian
from regtorch.similarity.gram import fixed_gradients

_DEVICE = "cuda"
_CACHE_MB, _MEMORY_MB = 16, 2048
_PARITY, _JACOBIAN_PARITY = 1e-5, 1e-4


def or_not_measured(case: Callable[..., list[Row]]) -> Callable[..., list[Row]]:
    def measured(bench: Bench, **options: Any) -> list[Row]:
        if torch.cuda.is_available():
            return case(bench, **options)
        return [{"implementation": "regtorch", "device": "no GPU", "per_second": "not measured"}]

    return measured


@or_not_measured
def table(
    bench: Bench, *, levels: Sequence[dict[str, Any]], budget: Sequence[dict[str, Any]], before: str | None = None
) -> list[Row]:
    """Images, their Jacobians, scores and normal equations a second, to ``gpu.csv`` beside the other table.

    First what is timed is compared with the reference in float64. ``before`` is the name under which an older version
    of the package can be imported; it takes turns with this one. Images and Jacobians are counted from rays, scores
    and equations from poses.
    """
    rows = []
    for level in levels:
        scene = bench.scenes.scene(**{key: value for key, value in level.items() if key != "targets"}).on(_DEVICE)
        _check_parity(bench, scene)
        works = {name: _works(name, scene, bench.scenes.start(scene.detector)) for name in _packages(before)}
        for what in works["regtorch"]:
            count = len(scene.poses) if what != "with Jacobian" else max(1, len(scene.poses) // 4)
            runs = [Run(name, work[what], count, bench.config.threads) for name, work in works.items()]
            _take_turns(runs, bench.config.repeats, bench.config.least_s)
            rows += [_row(scene, what, run.name, run.per_second, runs[-1], run.spread, run.poses) for run in runs]
            target = level.get("targets", {}).get(what)
            rows[-len(runs)]["target"] = target
            bench.say(", ".join(f"{run.name} {what} {run.per_second:.4g}/s" for run in runs))
    rows += _budget_rows(bench, budget, before)
    of_machine = {"device": device_name(_DEVICE), "torch": torch.__version__, "triton": _version("triton")}
    written = pd.DataFrame([row | of_machine for row in rows])
    written.to_csv(Path(bench.config.out) / "gpu.csv", index=False, float_format="%.6g")
    return [row | {"device": of_machine["device"]} for row in rows]


def _take_turns(runs: Sequence[Run], repeats: int, least_s: float) -> None:
    """As ``alternate``, all poses in each call: what one pose takes tells nothing of many on a GPU."""
    for run in runs:
        run.poses, run.seconds = run.most, []
        run.once()
        run.calls = max(1, round(least_s / max(run.once(), 1e-9)))
    for _ in range(repeats):
        for run in runs:
            start = time.perf_counter()
            for _ in range(run.calls):
                run.work(run.poses)
            torch.cuda.synchronize()
            run.seconds.append(time.perf_counter() - start)


def _packages(before: str | None) -> list[str]:
    return ["regtorch"] if before is None else ["regtorch", before]


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return ""


def _check_parity(bench: Bench, scene: Scene) -> None:
    """One pose of the scene; raises ``AssertionError``."""
    from regtorch.drr import triton

    volume, some, detector = scene.volume, scene.poses[:1], scene.detector
    rays = rays_of(volume, some, detector, scene.view)
    by_pose = ray_jacobian(some, detector, scene.view, volume.voxel_from_ct).to(rays)
    place = volume.grid, detector.rows, detector.columns, "joseph"
    images = triton.project(volume.data, rays, *place)
    both = triton.project_with_jacobian(volume.data, rays, by_pose, *place)
    right = reference.project_with_jacobian(volume.data.double(), rays, by_pose, *place)
    off = relative(images, right[0]), relative(both[0], right[0])
    by_parameter = [relative(both[1][:, :, p], right[1][:, :, p]) for p in range(9)]
    bench.say(f"{detector.columns}^2: images differ by {max(off):.1e}, Jacobians by {max(by_parameter):.1e}")
    assert max(off) < _PARITY
    assert max(by_parameter) < _JACOBIAN_PARITY


def _works(package: str, scene: Scene, start: torch.Tensor) -> dict[str, Callable[[int], object]]:
    """What is timed, of the first n poses."""
    drr, scoring, gram = (
        importlib.import_module(f"{package}.{m}") for m in ("drr.triton", "scoring", "similarity.gram")
    )
    volume, poses, detector, view = scene.volume, scene.poses, scene.detector, scene.view
    rays = rays_of(volume, poses, detector, view)
    by_pose = ray_jacobian(poses, detector, view, volume.voxel_from_ct).to(rays)
    place = volume.grid, detector.rows, detector.columns, "joseph"
    fixed = gram.fixed_gradients(render(volume, start.to(_DEVICE), detector, view), None)
    return {
        "images": lambda n: drr.project(volume.data, rays[:n], *place),
        "with Jacobian": lambda n: drr.project_with_jacobian(volume.data, rays[:n], by_pose[:n], *place),
        "gradient correlation": lambda n: scoring.gradient_correlations(volume, poses[:n], detector, view, fixed),
        "normal equations": lambda n: scoring.normal_equations(volume, poses[:n], detector, view, fixed),
    }


def _row(scene: Scene, what: str, name: str, per_second: float, last: Run, spread: float, poses: int) -> Row:
    return {
        "case": "gpu",
        "implementation": f"{name}, {what}",
        "per_second": per_second,
        "times_before": per_second / last.per_second,
        "seconds_spread": spread,
        "poses": poses,
        "pixels": scene.detector.columns,
        "voxel_mm": round(scene.voxel_mm, 3),
        "voxels": "x".join(map(str, scene.volume.data.shape)),
    }


def _budget_rows(bench: Bench, levels: Sequence[dict[str, Any]], before: str | None) -> list[Row]:
    """Seconds for all evaluations; the older version has one turn, since it takes long."""
    seconds = {}
    scenes = [bench.scenes.scene(**level).on(_DEVICE) for level in levels]
    for name in _packages(before):
        scoring, gram = (importlib.import_module(f"{name}.{m}") for m in ("scoring", "similarity.gram"))
        starts = [bench.scenes.start(scene.detector).to(_DEVICE) for scene in scenes]
        fixed = [
            gram.fixed_gradients(render(s.volume, start, s.detector, s.view), None)
            for s, start in zip(scenes, starts, strict=True)
        ]
        few = [replace(scene, poses=scene.poses[:4096]) for scene in scenes]
        _seconds(scoring, few, fixed)
        turns = bench.config.repeats if name == "regtorch" else 1
        seconds[name] = statistics.median(_seconds(scoring, scenes, fixed) for _ in range(turns))
        bench.say(f"{name}: {sum(len(scene.poses) for scene in scenes)} evaluations in {seconds[name]:.3g} s")
    count = sum(len(scene.poses) for scene in scenes)
    return [
        {
            "case": "gpu",
            "implementation": f"{name}, budget",
            "per_second": count / one,
            "times_before": list(seconds.values())[-1] / one,
            "seconds": one,
            "poses": count,
        }
        for name, one in seconds.items()
    ]


def _seconds(scoring: Any, scenes: list[Scene], fixed: list[Any]) -> float:
    torch.cuda.synchronize()
    start = time.perf_counter()
    for scene, gradients in zip(scenes, fixed, strict=True):
        scoring.gradient_correlations(scene.volume, scene.poses, scene.detector, scene.view, gradients)
    torch.cuda.synchronize()
    return time.perf_counter() - start


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
