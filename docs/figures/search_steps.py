"""Draws the steps of the default search, on the embedded phantom, and the frames.

python docs/figures/search_steps.py [FOLDER]
"""

import sys
from pathlib import Path

import matplotlib

matplotlib.use("agg")
import matplotlib.pyplot as plt
import numpy as np
import torch
from PIL import Image

from regtorch import attenuation, make_phantom, register, render
from regtorch.geometry import Detector, project
from regtorch.imaging import Radiograph
from regtorch.plotting import edge_strength
from regtorch.registration import Settings, hybrid
from regtorch.registration.search import screening
from regtorch.registration.search.matcher import Matcher
from regtorch.registration.search.tissues import pyramid
from regtorch.registration.trace import Trace
from regtorch.similarity.robust import explained_weight
from regtorch.simulation import realistic

BLUE, ORANGE = "#0072b2", "#e69f00"
SETTINGS = Settings()
ANCHOR = "L1"


def main(folder: Path) -> None:
    ct, vertebrae = make_phantom(4.0)
    detector = Detector(rows=330, columns=270, pixel_mm=1.3)
    truth = torch.tensor([25.0, -20.0, 1030.0, 20.0, 30.0, 200.0, 0.04, -0.05, 0.03], dtype=torch.float64)
    made = realistic(ct, truth, "PA", detector=detector, targets=vertebrae, seed=3)
    radiograph = Radiograph.from_image(made.image, detector)
    problems = []

    def kept(problem):
        problems.append(problem)
        return hybrid(problem)

    result = register(ct, radiograph, "PA", method=kept)
    problem = problems[0]
    bone = pyramid(problem, SETTINGS, problem.attenuating, SETTINGS.levels, Trace())
    anchor = torch.tensor([vertebrae[ANCHOR]], dtype=torch.float64)
    draw_frames(folder / "frames.png")
    draw_screening(folder / "search_screen.png", bone[0])
    draw_climbs(folder / "search_climb.png", bone[0], radiograph, anchor, truth)
    finest = Matcher.of(problem, SETTINGS, problem.attenuating, SETTINGS.finest_pixels, Trace())
    draw_levels(folder / "search_levels.png", [*bone, finest], result.parameters)
    draw_robust(folder / "search_robust.png", bone[-1], result.parameters)
    draw_answer(folder / "search_answer.png", ct, radiograph, result)
    print(f"{result.status}: {result.message}")


def draw_frames(path: Path) -> None:
    """Source, patient and detector from the side, with the nine parameters."""
    figure, axes = plt.subplots(figsize=(7.5, 4.6), layout="constrained")
    z_s, z_obj, y_obj, y_s = 1000, 260, 40, 60
    axes.plot([0, 0], [-215, 215], color="black", linewidth=5, solid_capstyle="butt")
    axes.fill([z_s, 0, 0], [y_s, 215, -215], color=ORANGE, alpha=0.12)
    axes.add_patch(matplotlib.patches.Ellipse((z_obj, y_obj), 220, 330, facecolor=BLUE, alpha=0.2, edgecolor=BLUE))
    for corner in (-215, 215):
        axes.plot([z_s, 0], [y_s, corner], color=ORANGE, linewidth=1)
    axes.plot(z_s, y_s, "*", color=ORANGE, markersize=20)
    axes.plot(z_obj, y_obj, "o", color=BLUE, markersize=7)
    axes.text(z_s + 20, y_s + 25, "source\n(x_s, y_s, z_s)", color="#8a5f00", ha="right", va="bottom")
    axes.text(z_obj + 12, y_obj + 12, "CT centre\n(x_obj, y_obj, z_obj)", color=BLUE, va="bottom")
    axes.text(z_obj + 90, y_obj - 130, "patient, turned by\neta, theta, phi", color=BLUE)
    axes.text(-14, -205, "detector, Z = 0", rotation=90, ha="right", va="bottom", fontsize=9)
    arrow = {"arrowstyle": "-|>", "color": "black", "linewidth": 1.6}
    axes.annotate("", (130, 0), (0, 0), arrowprops=arrow)
    axes.annotate("", (0, 250), (0, 0), arrowprops=arrow)
    axes.text(136, -6, "Z", va="center", weight="bold")
    axes.text(-14, 30, "Y: up, rows decrease", rotation=90, ha="right", va="bottom", fontsize=9)
    axes.plot(0, 0, "o", color="white", markeredgecolor="black", markersize=13)
    axes.plot(0, 0, "x", color="black", markersize=8)
    axes.text(18, -40, "X: into the page,\ncolumns increase", va="top", fontsize=9)
    span = {"arrowstyle": "<->", "color": "black", "linewidth": 1}
    axes.annotate("", (0, -255), (z_s, -255), arrowprops=span)
    axes.text(z_s / 2, -250, "SDD = z_s", ha="center", va="bottom")
    axes.annotate("", (0, -300), (z_obj, -300), arrowprops=span)
    axes.text(z_obj / 2, -295, "ODD = z_obj", ha="center", va="bottom")
    axes.set(xlim=(-80, 1060), ylim=(-325, 265), xlabel="Z (mm)", ylabel="Y (mm)", aspect="equal")
    axes.set_title("The frame 'world', seen from the side")
    _save(figure, path)


def draw_screening(path: Path, matcher: Matcher) -> None:
    """The wide DRR of the best draw, and its correlation at all shifts."""
    problem, fixed = matcher.problem, matcher.fixed
    detector = fixed.detector
    draws = screening._draws(problem, SETTINGS.poses, 0)
    margins = screening._margins(problem, detector, draws, SETTINGS.most_magnified)
    wide = Detector(detector.rows + 2 * margins[1], detector.columns + 2 * margins[0], detector.pixel_mm)
    size = [screening._fast_size(n) for n in (wide.rows, wide.columns)]
    fixed_terms, weight_term = screening._fixed_terms(fixed, size)
    images = render(matcher.volume, draws, wide, problem.view)
    moving = torch.stack(screening.image_gradients(images), dim=1)
    product = screening._correlate(moving, fixed_terms, size, margins)
    energy = screening._correlate(moving.square().sum(1, keepdim=True), weight_term, size, margins)
    least = SETTINGS.least_energy * energy.flatten(1).amax(1)[:, None, None].clamp_min(1e-20)
    score = product / torch.maximum(energy, least).sqrt()
    score = score.masked_fill(~screening._in_range(problem, detector, draws, margins), torch.nan)
    best = int(score.nan_to_num(nan=-1).flatten(1).amax(1).argmax())
    _, at = screening._peaks(score[best : best + 1].nan_to_num(nan=-1), SETTINGS.peaks)

    figure, panels = plt.subplots(1, 3, figsize=(10.5, 4.2), layout="constrained")
    mm = detector.pixel_mm

    def extent(across: float, down: float) -> tuple[float, float, float, float]:
        return -across * mm / 2, across * mm / 2, -down * mm / 2, down * mm / 2

    panels[0].imshow(fixed.image, cmap="gray", extent=extent(detector.columns, detector.rows))
    panels[0].set_title(f"radiograph, {detector.columns} x {detector.rows} pixels")
    panels[1].imshow(images[best], cmap="gray", extent=extent(wide.columns, wide.rows))
    half = detector.columns * mm / 2, detector.rows * mm / 2
    panels[1].add_patch(
        plt.Rectangle((-half[0], -half[1]), 2 * half[0], 2 * half[1], fill=False, color=ORANGE, linewidth=2)
    )
    panels[1].set_title("wide DRR of one pose")
    shown = panels[2].imshow(score[best], cmap="viridis", extent=extent(2 * margins[0] + 1, 2 * margins[1] + 1), vmin=0)
    for number, (row, column) in enumerate(at[0].tolist(), 1):
        x, y = (column - margins[0]) * mm, (margins[1] - row) * mm
        panels[2].plot(x, y, "o", color="none", markeredgecolor=ORANGE, markersize=14, markeredgewidth=2.2)
        panels[2].annotate(
            f"{number}", (x, y), (10, 7), textcoords="offset points", color=ORANGE, weight="bold", fontsize=12
        )
    panels[2].set_title("correlation; two peaks")
    figure.colorbar(shown, ax=panels[2], shrink=0.7, label="correlation of gradients")
    for axes in panels[:2]:
        axes.set(xlabel="X (mm)", ylabel="Y (mm)")
    panels[2].set(xlabel="shift in X (mm)", ylabel="shift in Y (mm)")
    _save(figure, path)


def draw_climbs(path: Path, matcher: Matcher, radiograph: Radiograph, anchor, truth) -> None:
    """Where candidates put one vertebra, before and after the climb on the widest level."""
    problem = matcher.problem
    found = screening.screen(matcher, SETTINGS.poses, 0)
    chosen = problem.distinct(found.parameters, matcher.pixel_mm, SETTINGS.levels[0].candidates)
    before = found.parameters[chosen]
    climbed = matcher.climb(before, SETTINGS.levels[0].steps)
    places = [project(problem.pixel_from_patient(p), anchor)[:, 0] for p in (before, climbed.parameters)]
    true = project(problem.pixel_from_patient(truth), anchor)[0]
    values = [found.similarity[chosen], climbed.similarity]
    rows, columns = radiograph.image.shape
    figure, panels = plt.subplots(1, 2, figsize=(8.6, 4.9), layout="constrained", sharey=True)
    titles = [f"{len(chosen)} candidates, screened", f"after {SETTINGS.levels[0].steps} steps of the climb"]
    for axes, place, value, title in zip(panels, places, values, titles, strict=True):
        axes.imshow(radiograph.image, cmap="gray")
        shown = axes.scatter(
            *place.mT, c=value, cmap="viridis", vmin=0, vmax=float(values[1].max()), s=45, edgecolor="white"
        )
        axes.plot(*true, "+", color=ORANGE, markersize=20, markeredgewidth=2.5, label=f"{ANCHOR}, true")
        axes.set(title=title, xlabel="column (pixel of 1.3 mm)", xlim=(-20, columns + 20), ylim=(rows + 20, -20))
        axes.set_facecolor("#dddddd")
        axes.legend(loc="lower left")
    panels[0].set_ylabel("row (pixel of 1.3 mm)")
    figure.colorbar(shown, ax=panels, shrink=0.7, label="similarity of bone")
    _save(figure, path)


def draw_levels(path: Path, levels: list[Matcher], parameters) -> None:
    """The radiograph and the DRR of the answer on each level."""
    counts = [*(stage.candidates for stage in SETTINGS.levels), 1]
    figure, panels = plt.subplots(2, 4, figsize=(8.8, 5.8), layout="constrained", sharex=True, sharey=True)
    for (above, below), matcher, count in zip(panels.T, levels, counts, strict=True):
        fixed, detector = matcher.fixed, matcher.fixed.detector
        across, down = detector.columns * detector.pixel_mm / 2, detector.rows * detector.pixel_mm / 2
        shown = {"cmap": "gray", "extent": (-across, across, -down, down), "interpolation": "nearest"}
        above.imshow(fixed.image, **shown)
        below.imshow(render(matcher.volume, parameters, detector, matcher.problem.view), **shown)
        above.set_title(
            f"{detector.columns} x {detector.rows} pixels\nof {detector.pixel_mm:.1f} mm, "
            f"{count} candidate{'s' * (count > 1)}",
            fontsize=9,
        )
        below.set(xlabel="X (mm)")
    panels[0, 0].set_ylabel("radiograph: Y (mm)")
    panels[1, 0].set_ylabel("DRR of bone: Y (mm)")
    _save(figure, path)


def draw_robust(path: Path, matcher: Matcher, parameters) -> None:
    """The radiograph, the DRR, and the weight of each pixel."""
    fixed = matcher.fixed
    moving = render(matcher.volume, parameters, fixed.detector, matcher.problem.view)
    weight = explained_weight(
        moving, fixed.image, fixed.weight, width_px=SETTINGS.robust_width_px, floor=SETTINGS.robust_floor
    )
    share = (weight / weight.max()).numpy()
    figure, panels = plt.subplots(1, 3, figsize=(9.5, 4), layout="constrained", sharey=True)
    for axes, image, title in zip(panels, (fixed.image, moving), ("radiograph", "DRR of bone"), strict=False):
        axes.imshow(image, cmap="gray")
        axes.set_title(title)
    shown = panels[2].imshow(share, cmap="viridis", vmin=0, vmax=1)
    panels[2].set_title("robust weight")
    figure.colorbar(shown, ax=panels[2], shrink=0.7, label="weight, share of the largest")
    for axes in panels:
        axes.set_xlabel(f"column (pixel of {fixed.detector.pixel_mm:.1f} mm)")
    panels[0].set_ylabel("row")
    _save(figure, path)


def draw_answer(path: Path, ct, radiograph: Radiograph, result) -> None:
    """Edges of bone at the start and at the answer."""
    bone = attenuation(ct, threshold_hu=100.0)
    figure, panels = plt.subplots(1, 2, figsize=(7, 4.6), layout="constrained", sharey=True)
    for axes, parameters, title in zip(
        panels, (result.initial, result.parameters), ("start", f"answer: {result.status}"), strict=True
    ):
        edges = edge_strength(render(bone, parameters, radiograph.detector, "PA")).clamp(max=0.9).numpy()
        axes.imshow(radiograph.image, cmap="gray")
        axes.imshow(np.dstack([np.broadcast_to((1.0, 0.6, 0.1), (*edges.shape, 3)), edges]))
        axes.set(title=title, xlabel="column (pixel of 1.3 mm)")
    panels[0].set_ylabel("row (pixel of 1.3 mm)")
    _save(figure, path)


def _save(figure, path: Path) -> None:
    """A picture of 256 colours, chosen so that scales of colours stay smooth: a third of the size."""
    figure.savefig(path, dpi=85)
    plt.close(figure)
    Image.open(path).convert("RGB").quantize(256, Image.Quantize.MAXCOVERAGE, kmeans=2).save(path, optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
