"""The cases of the benchmark on a CPU: each times implementations in turns and returns rows of the table."""

import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from omegaconf import DictConfig
from torch import Tensor

from experiments.benchmark.limits import device_name, gathers_per_second, samples_all, samples_needed
from experiments.benchmark.scene import Scene, Scenes
from experiments.benchmark.timing import Run, alternate
from regtorch.drr import render
from regtorch.imaging import BONE_HU
from regtorch.similarity.gram import fixed_gradients

Row = dict[str, Any]


@dataclass
class Bench:
    """The state of all cases; ``peers`` are those of ``conf/benchmark.yaml``, instantiated."""

    config: DictConfig
    scenes: Scenes
    peers: dict[str, dict[str, Any]]
    say: Callable[[str], None] = print
    _limits: dict[int, float] = field(default_factory=dict)

    def limit(self, threads: int) -> float:
        if threads not in self._limits:
            self._limits[threads] = gathers_per_second(threads)
        return self._limits[threads]

    def rows(self, scene: Scene, runs: Sequence[Run], reference: Run | None = None) -> list[Row]:
        """Times the runs in turns; ``times_regtorch`` is the rate of ``reference``, the first one, over each one's."""
        alternate(runs, self.config.repeats, self.config.least_s, self.config.most_s)
        reference = reference or runs[0]
        rows = []
        for run in runs:
            row = {
                "implementation": run.name,
                "device": device_name(),
                "threads": run.threads,
                "per_second": run.per_second,
                "times_regtorch": reference.per_second / run.per_second,
                "relative_difference": run.relative_difference,
                "seconds": run.median_s / run.calls,
                "seconds_spread": run.spread,
                "poses": run.poses,
                "pixels": scene.detector.columns,
                "voxel_mm": round(scene.voxel_mm, 3),
            }
            own = run.name.startswith("regtorch")
            rows.append(row | (self.samples(scene, run.per_second, run.threads) if own else {}))
        return rows

    def samples(self, scene: Scene, per_second: float, threads: int) -> Row:
        place = scene.volume, scene.poses[:2], scene.detector, scene.view
        return {
            "share_of_limit": per_second * samples_needed(*place) / self.limit(threads),
            "samples_per_second": per_second * samples_all(*place),
            "voxels": "x".join(map(str, scene.volume.data.shape)),
        }

    def ours(self, name: str, scene: Scene, work: Callable[[Tensor], object], threads: int | None = None) -> Run:
        return Run(name, lambda n: work(scene.poses[:n]), len(scene.poses), threads or self.config.threads)

    def theirs(self, scene: Scene, names: Sequence[str] | None = None) -> list[Run]:
        """Peers whose images are ours: those that are installed, of these names, or all."""
        runs = []
        some = scene.poses[:2]
        for name, peer in self.peers.items():
            if names is not None and name not in names:
                continue
            try:
                images = peer["images"](scene.volume, scene.detector, scene.view, self.config.threads)
            except ImportError as error:
                self.say(f"{name}: not installed ({error})")
                continue
            ours = render(scene.volume, some, scene.detector, scene.view, method=peer["method"])
            difference = relative(images(some), ours)
            if difference > self.config.tolerance:
                self.say(f"{name}: images differ from regtorch's by {difference:.1%}, so it is not timed")
                continue
            run = self.ours(name, scene, images)
            run.relative_difference = difference
            run.own_seconds = (lambda its=images: its.seconds) if hasattr(images, "seconds") else None
            runs.append(run)
        return runs


def relative(found: Tensor, expected: Tensor) -> float:
    """Difference over the expected value, by norm."""
    return float((found.double() - expected.double()).norm() / expected.double().norm())


def limits(bench: Bench) -> list[Row]:
    """The limits to which ``share_of_limit`` refers."""
    name, threads = "reads of 16 bytes from second-level cache", bench.config.threads
    return [
        {"implementation": name, "device": device_name(), "threads": n, "per_second": bench.limit(n)}
        for n in sorted({1, threads})
    ]


def value(
    bench: Bench,
    *,
    pixels: int,
    voxel_mm: float | None,
    threshold_hu: float | None = BONE_HU,
    poses: int | None = None,
    peers: Sequence[str] | None = None,
) -> list[Row]:
    """Images alone, against every peer or those named."""
    scene = bench.scenes.scene(pixels, voxel_mm, poses, threshold_hu)
    return bench.rows(scene, [bench.ours("regtorch", scene, _renders(scene)), *bench.theirs(scene, peers)])


def jacobian(bench: Bench, *, pixels: int, voxel_mm: float, poses: int | None = None) -> list[Row]:
    """Images and the derivatives of every pixel, against peers' forward plus backward pass, one number per pose.

    Their gradient is compared with ours, contracted with the same weights, each parameter in its own scale.
    """
    from regtorch.drr import render_with_jacobian

    scene = bench.scenes.scene(pixels, voxel_mm, poses)
    weight = render(scene.volume, bench.scenes.start(scene.detector)[None], scene.detector, scene.view)[0]
    weight = weight / weight.norm()
    place = scene.detector, scene.view
    runs = [bench.ours("regtorch", scene, lambda some: render_with_jacobian(scene.volume, some, *place))]
    runs.append(bench.ours("regtorch, images alone", scene, _renders(scene)))
    some = scene.poses[:4]
    ours = (render_with_jacobian(scene.volume, some, *place)[1].double() * weight).sum(dim=(-2, -1))
    scale = ours.square().mean(dim=0).sqrt()
    for name, peer in bench.peers.items():
        if "gradient" not in peer:
            continue
        try:
            gradient = peer["gradient"](scene.volume, *place, bench.config.threads)
        except ImportError as error:
            bench.say(f"{name}: not installed ({error})")
            continue
        run = bench.ours(name, scene, partial(_swapped, gradient, weight))
        run.relative_difference = relative(gradient(some, weight) / scale, ours / scale)
        if run.relative_difference > bench.config.gradient_tolerance:
            bench.say(f"{name}: gradient differs from regtorch's by {run.relative_difference:.1%}, so it is not timed")
            continue
        runs.append(run)
    return bench.rows(scene, runs)


def two_classes(bench: Bench, *, pixels: int, voxel_mm: float, poses: int | None = None) -> list[Row]:
    """Bone and the rest in one pass, against all tissue as one class (``regtorch``) and against bone alone."""
    scenes = bench.scenes.classes(pixels, voxel_mm, poses)
    names = {"all tissue": "regtorch", "two classes": "regtorch two classes", "bone alone": "regtorch bone alone"}
    both = render(scenes["two classes"].volume, *_first(scenes["two classes"]))
    whole = render(scenes["all tissue"].volume, *_first(scenes["all tissue"]))
    runs = [bench.ours(own, scenes[name], _renders(scenes[name])) for name, own in names.items()]
    runs[1].relative_difference = relative(both.sum(dim=1), whole)
    rows = bench.rows(scenes["all tissue"], runs)
    for scene, row in zip(scenes.values(), rows, strict=True):
        row |= bench.samples(scene, row["per_second"], row["threads"])
    return rows


def similarity(bench: Bench, *, pixels: int, voxel_mm: float, poses: int | None = None) -> list[Row]:
    """From poses to gradient correlations, against rendering alone."""
    from regtorch.scoring import gradient_correlations

    return _scored(bench, gradient_correlations, bench.scenes.scene(pixels, voxel_mm, poses))


def normal_equations(bench: Bench, *, pixels: int, voxel_mm: float, poses: int | None = None) -> list[Row]:
    """From poses to the normal equations of gradient correlation, against rendering alone."""
    from regtorch import scoring

    return _scored(bench, scoring.normal_equations, bench.scenes.scene(pixels, voxel_mm, poses))


def threads(bench: Bench, *, pixels: int, voxel_mm: float, counts: Sequence[int]) -> list[Row]:
    """Images alone by so many threads; the others are compared with the rate by the most threads."""
    scene = bench.scenes.scene(pixels, voxel_mm)
    runs = [bench.ours("regtorch", scene, _renders(scene), n) for n in sorted(counts)]
    return bench.rows(scene, runs, runs[-1])


def memory(bench: Bench, *, counts: Sequence[int], pixels: int = 8, voxel_mm: float = 8.0) -> list[Row]:
    """Growth of memory at most while ``counts`` poses are scored, each count in a process of its own."""
    rows = []
    for count in counts:
        options = [f"ct={bench.config.ct or 'null'}", f"pixels={pixels}", f"voxel_mm={voxel_mm}", f"poses={count}"]
        options.append(f"threads={bench.config.threads}")
        said = subprocess.run(
            [sys.executable, "-m", "experiments.memory", *options],
            check=True, capture_output=True, text=True, cwd=Path(__file__).parents[2],
        ).stdout  # fmt: skip
        megabytes, seconds = map(float, said.split()[-2:])
        rows.append(
            {
                "implementation": "regtorch",
                "device": device_name(),
                "threads": bench.config.threads,
                "per_second": count / seconds,
                "seconds": seconds,
                "poses": count,
                "pixels": pixels,
                "voxel_mm": voxel_mm,
                "megabytes": megabytes,
            }
        )
    return rows


def sweep(bench: Bench, *, over: dict[str, Sequence[float]], **options: Any) -> list[Row]:
    """``value`` with one of its options taking many values."""
    ((name, values),) = over.items()
    return [row for one in values for row in value(bench, **options, **{name: one})]


def _scored(bench: Bench, score: Callable[..., Any], scene: Scene) -> list[Row]:
    start = bench.scenes.start(scene.detector)
    fixed = fixed_gradients(render(scene.volume, start, scene.detector, scene.view), None)  # once, as in a search
    own = bench.ours("regtorch", scene, lambda some: score(scene.volume, some, scene.detector, scene.view, fixed))
    return bench.rows(scene, [own, bench.ours("regtorch, rendering alone", scene, _renders(scene))])


def _renders(scene: Scene) -> Callable[[Tensor], Tensor]:
    return lambda poses: render(scene.volume, poses, scene.detector, scene.view)


def _first(scene: Scene) -> tuple[Any, ...]:
    return scene.poses[:2], scene.detector, scene.view


def _swapped(gradient: Callable[..., Tensor], weight: Tensor, poses: Tensor) -> Tensor:
    return gradient(poses, weight)
