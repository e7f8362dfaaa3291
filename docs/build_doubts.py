"""Draws each reason of doubt: a small registration of the embedded phantom that ends with this reason.

    python docs/build_doubts.py [CODE ...]

A new rule needs an entry of ``CASES``, and its picture on the page docs/explained/doubt.md.
"""

import sys
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("agg")
import matplotlib.pyplot as plt
import numpy as np
import torch
from PIL import Image
from torch import Tensor

from regtorch import attenuation, make_phantom, register, render, simulate
from regtorch.geometry import PHI, Z_S, Detector, pixel_from_patient, project
from regtorch.imaging import Radiograph
from regtorch.plotting import edge_strength
from regtorch.registration import Registration, cmaes
from regtorch.registration.trust import LIMITS
from regtorch.registration.trust.rules import RULES, WARNINGS
from regtorch.similarity import normalized_cross_correlation
from regtorch.simulation import Simulation, add_devices

FOLDER = Path(__file__).parent / "explained" / "doubt"
DETECTOR = Detector(rows=160, columns=140, pixel_mm=2.5)
TRUTH = torch.tensor([20.0, -15.0, 1020.0, 10.0, -60.0, 200.0, 0.03, -0.04, 0.03], dtype=torch.float64)
START = TRUTH + torch.tensor([0, 0, 0, 15, 40, -10, 0.02, 0.02, 0.02], dtype=torch.float64)
KNOWN = {"free": 6, "initial": START}
"""Options of a registration that knows where the source is."""
ALL_TISSUE = KNOWN | {"threshold_hu": None}
"""Options of the paper's method, which has no robust weights: its DRR shows all tissue, as the radiograph does."""

ORANGE, BLUE, GREEN = "#ff9a1a", "#56b4e9", "#00e0a0"
DOT = {"markersize": 6, "markeredgecolor": "black", "markeredgewidth": 0.6}
ZOOM = 2.5
Pose = Callable[[Registration, Tensor], Tensor]
Spoil = Callable[[Simulation], Radiograph]


def whole(made: Simulation) -> Radiograph:
    return Radiograph.from_image(made.image, made.detector)


def noise(made: Simulation) -> Radiograph:
    """No anatomy at all."""
    generator = torch.Generator().manual_seed(1)
    return Radiograph.from_image(torch.randn(made.image.shape, generator=generator), made.detector)


def flipped(made: Simulation) -> Radiograph:
    return Radiograph.from_image(made.image.flip(1), made.detector)


def wired(made: Simulation, *, wires: int) -> Radiograph:
    generator = torch.Generator().manual_seed(2)
    image, _ = add_devices(made.image, made.detector, count=wires, width_mm=(2.0, 6.0), generator=generator)
    return Radiograph.from_image(image, made.detector)


def finer(made: Simulation) -> Radiograph:
    """The same pixels, said to be smaller."""
    return Radiograph.from_image(made.image, replace(made.detector, pixel_mm=2.0))


def collimated(made: Simulation, *, vertebra: str, rows: int, columns: int) -> Radiograph:
    """Only so many rows and columns to each side of a vertebra count."""
    column, row = pixels(made.pixel_from_patient, [vertebra])[0].round().int().tolist()
    weight = torch.zeros_like(made.image)
    weight[max(row - rows, 0) : row + rows + 1, max(column - columns, 0) : column + columns + 1] = 1
    return Radiograph.from_image(made.image, made.detector, weight=weight)


def runner_up(result: Registration, points: Tensor) -> Tensor:
    """The best start that ended elsewhere."""
    here = project(result.pixel_from_patient, points)
    for start in result.starts:
        matrix = pixel_from_patient(start, result.detector, result.view, result.origin_patient_mm)
        if float((project(matrix, points) - here).norm(dim=1).mean()) * DETECTOR.pixel_mm >= LIMITS.agree_mm:
            return start
    raise RuntimeError("all starts agree: expected a runner-up")


def along(result: Registration, points: Tensor, *, index: int) -> Tensor:
    """The answer moved along its covariance, by one standard deviation of one of the nine parameters."""
    return result.parameters + result.covariance[index] / result.covariance[index, index].sqrt()


@dataclass(frozen=True)
class Case:
    """A radiograph of the phantom and its registration.

    Args:
        spoil: What becomes of the simulated radiograph.
        options: Of ``register``.
        photons: Per pixel of the open beam.
        moved: How far the true parameters are from ``TRUTH`` (mm, rad).
        other: Name of a second pose whose edges are drawn, and what finds it.
        marked: Whether the true vertebrae are drawn; not where ``spoil`` has moved or removed them.
        zoom: The edges are shown around this vertebra alone, with the vertebrae's names.
    """

    spoil: Spoil = whole
    options: Mapping[str, Any] = field(default_factory=dict)
    photons: float = 1e5
    moved: tuple[float, ...] = (0.0,) * 9
    other: tuple[str, Pose] | None = None
    marked: bool = True
    zoom: str | None = None


def paper(starts: int) -> Callable:
    return partial(cmaes, starts=starts, generations=60, pixels=(24, 60), survivors=2, final_generations=80)


CASES = {
    "no_match": Case(noise, marked=False),
    "other_similarity": Case(options=ALL_TISSUE | {"method": paper(8), "similarity": normalized_cross_correlation}),
    "mirrored_better": Case(flipped, KNOWN, marked=False),
    "at_limit": Case(
        options={"half_range": torch.tensor([75, 75, 150, 150, 150, 150, 0.02, 0.02, 0.02])},
        moved=(0, 0, 0, 0, 0, 0, 0, 0, 0.1),
    ),
    "behind_detector": Case(finer, KNOWN, marked=False),
    "mirrored_close": Case(partial(wired, wires=30), KNOWN),
    "found_once": Case(options=ALL_TISSUE | {"method": paper(3), "seed": 5}, other=("runner-up", runner_up)),
    "rivalled": Case(
        partial(collimated, vertebra="T10", rows=8, columns=8), KNOWN, other=("runner-up", runner_up), zoom="T10"
    ),
    "frozen_wrong": Case(
        options={"free": ("x_obj", "y_obj", "z_obj", "eta", "theta"), "initial": START},
        moved=(0, 0, 0, 0, 0, 0, 0, 0, 0.1),
        other=("once all are free", partial(along, index=PHI)),
    ),
    "uncertain": Case(partial(collimated, vertebra="T7", rows=10, columns=8), KNOWN),
    "unexplained": Case(options=KNOWN, photons=100),
    "flat_sdd": Case(
        partial(collimated, vertebra="L3", rows=26, columns=26), other=("longer SDD", partial(along, index=Z_S))
    ),
    "runner_up_vertebra": Case(other=("runner-up", runner_up), zoom="T10"),
}
"""By the code of each rule."""


@cache
def patient() -> tuple:
    """The CT and the middle of each vertebral body, LPS mm."""
    return make_phantom(5.0)


def pixels(matrix: Tensor, names: list[str]) -> Tensor:
    _, vertebrae = patient()
    return project(matrix, torch.tensor([vertebrae[name] for name in names], dtype=torch.float64))


def registered(code: str) -> tuple[Simulation, Radiograph, Registration]:
    """The case of a rule. Raises ``RuntimeError`` where its registration does not break the rule."""
    case, (ct, vertebrae) = CASES[code], patient()
    truth = TRUTH + torch.tensor(case.moved, dtype=torch.float64)
    made = simulate(ct, truth, detector=DETECTOR, photons=case.photons, targets=vertebrae, seed=1)
    radiograph = case.spoil(made)
    result = register(ct, radiograph, **case.options)
    if sentence(code, result) is None:
        raise RuntimeError(f"{code}: ended as {[reason.code for reason in result.reasons]}, {result.warnings}")
    return made, radiograph, result


def sentence(code: str, result: Registration) -> str | None:
    """The sentence of a rule that a result breaks; None where it does not."""
    (rule,) = (rule for rule in (*RULES, *WARNINGS) if rule.code == code)
    told = [reason.sentence for reason in result.reasons if reason.code == code]
    if rule in WARNINGS and rule.broken(result.evidence, LIMITS):
        return rule.sentence.format(**result.evidence.to_dict())
    return told[0] if told else None


def draw(code: str, folder: Path) -> None:
    """The radiograph; the DRR of the answer; the radiograph with edges of bone and with vertebrae."""
    case, (ct, _) = CASES[code], patient()
    made, radiograph, result = registered(code)
    figure, panels = plt.subplots(1, 3, figsize=(8.4, 4.0))
    figure.subplots_adjust(0.005, 0.08, 0.995, 0.82, wspace=0.02)
    dimmed = 0.4 + 0.6 * radiograph.weight
    drr = render(attenuation(ct, threshold_hu=None), result.parameters, result.detector)
    shown = {
        "radiograph": _grey(radiograph.image) * dimmed,
        "DRR of the answer": _grey(drr),
        "radiograph, even contrast; edges of bone": _grey(_evened(radiograph.image)) * dimmed,
    }
    for axes, (title, image) in zip(panels, shown.items(), strict=True):
        axes.imshow(image, cmap="gray", vmin=0, vmax=1, interpolation="nearest")
        axes.set_title(title, fontsize=9)
        axes.set_axis_off()
    poses = {"answer": (result.parameters, ORANGE)}
    if case.other:
        label, pose = case.other
        points = torch.tensor(list(made.targets.values()), dtype=torch.float64)
        poses = {label: (pose(result, points), BLUE)} | poses
    for label, (parameters, colour) in poses.items():
        matrix = pixel_from_patient(parameters, result.detector, result.view, result.origin_patient_mm)
        _draw_pose(panels[2], parameters, result.detector, colour, label)
        _draw_vertebrae(panels[2], pixels(matrix, list(made.targets)), colour, list(made.targets) if case.zoom else [])
    if case.marked:
        true = pixels(made.pixel_from_patient, list(made.targets))
        panels[2].plot(*true.mT, "+", color=GREEN, markersize=9, markeredgewidth=1.8, label="true vertebrae")
    if case.zoom:
        _zoom(panels[2], *pixels(result.pixel_from_patient, [case.zoom])[0].tolist())
    else:
        panels[2].set(xlim=(-0.5, DETECTOR.columns - 0.5), ylim=(DETECTOR.rows - 0.5, -0.5))
    figure.legend(loc="lower right", ncols=5, fontsize=8, frameon=False, borderaxespad=0.1)
    told = textwrap.fill(f"{code} ({result.status}): {sentence(code, result)}", 110)
    figure.suptitle(told, fontsize=9.5, x=0.005, y=0.98, ha="left")
    _save(figure, folder / f"{code}.png")


def _grey(image: Tensor) -> Tensor:
    low, high = np.quantile(image, (0.005, 0.995))
    return ((image - low) / (high - low)).clamp(0, 1)


def _evened(image: Tensor) -> Tensor:
    """Less its mean over 21 x 21 pixels, so that bone shows before thick and thin parts alike."""
    padded = torch.nn.functional.pad(image[None, None], (10, 10, 10, 10), mode="replicate")
    return image - torch.nn.functional.avg_pool2d(padded, 21, stride=1)[0, 0]


def _draw_pose(axes: plt.Axes, parameters: Tensor, detector: Detector, colour: str, label: str) -> None:
    """Edges of bone."""
    bone = attenuation(patient()[0], threshold_hu=100.0)
    strength = edge_strength(render(bone, parameters, detector)).clamp(max=0.9)
    opaque = torch.where(strength > 0.3, strength, 0).numpy()
    tint = np.broadcast_to(matplotlib.colors.to_rgb(colour), (*opaque.shape, 3))
    axes.imshow(np.dstack([tint, opaque]), interpolation="nearest")
    axes.plot([], [], "o-", color=colour, **DOT, label=label)


def _draw_vertebrae(axes: plt.Axes, places: Tensor, colour: str, names: list[str]) -> None:
    """Dots (column, row); names stand left of the answer's and right of the other pose's."""
    axes.plot(*places.mT, "o", color=colour, **DOT)
    side = {"xytext": (-8, -3), "ha": "right"} if colour == ORANGE else {"xytext": (8, -3), "ha": "left"}
    box = {"facecolor": "black", "alpha": 0.7, "pad": 1, "linewidth": 0}
    for name, place in zip(names, places.tolist(), strict=False):
        axes.annotate(name, place, **side, textcoords="offset points", color=colour, weight="bold", bbox=box)


def _zoom(axes: plt.Axes, column: float, row: float) -> None:
    """A part of the detector; what lies outside is not drawn."""
    across, down = DETECTOR.columns / 2 / ZOOM, DETECTOR.rows / 2 / ZOOM
    axes.set(xlim=(column - across, column + across), ylim=(row + down, row - down))
    for text in axes.texts:
        text.set_visible(abs(text.xy[1] - row) < down - 2)


def _save(figure: plt.Figure, path: Path) -> None:
    """A picture of 128 colours: a third of the size."""
    figure.savefig(path, dpi=95)
    plt.close(figure)
    Image.open(path).convert("RGB").quantize(128, Image.Quantize.MAXCOVERAGE, kmeans=1).save(path, optimize=True)


def main(codes: list[str]) -> None:
    FOLDER.mkdir(exist_ok=True)
    for code in codes or CASES:
        draw(code, FOLDER)
        print(f"wrote docs/explained/doubt/{code}.png")


if __name__ == "__main__":
    main(sys.argv[1:])
