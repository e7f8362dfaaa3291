"""Figures of any study's registrations: shares by PDE, and PDE before and after."""

from collections.abc import Callable

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from experiments.common.registrations import FAILED_MM, groups_of
from experiments.common.style import PALETTE, clipped, legend_above, palette, plain_logarithmic

_WIDTH, _HEIGHT, _LEGEND_LETTERS = 9.0, 3.6, 110
_LINES, _MARKERS = ("-", "--", ":"), "os^"


def share_figure(rows: pd.DataFrame, keys: list[str]) -> Figure:
    """The share of the registrations up to each PDE (mm): a panel for each view, a line for each group of ``keys``."""

    def draw(axes: Axes, some: pd.DataFrame, number: int, style: dict[str, str]) -> None:
        axes.ecdf(clipped(some.pde_mm), linestyle=_LINES[number % len(_LINES)], linewidth=1.8, **style)

    figure = _by_view(rows, keys, draw)
    for axes in figure.axes:
        axes.axvline(FAILED_MM, color="0.5", linestyle="--", linewidth=1, zorder=0)
        axes.set(xlabel="PDE (mm)", ylim=(0, 1.02))
        plain_logarithmic(axes, "x")
    figure.axes[0].set_ylabel("share of registrations")
    return figure


def before_and_after_figure(rows: pd.DataFrame, keys: list[str]) -> Figure:
    """PDE (mm) after against before: a panel for each view, a colour for each group; dashed: no better than before."""

    def draw(axes: Axes, some: pd.DataFrame, number: int, style: dict[str, str]) -> None:
        size, marker = 4 + 160 / np.sqrt(len(some)), _MARKERS[number % len(_MARKERS)]
        before, after = clipped(some.initial_pde_mm), clipped(some.pde_mm)
        axes.scatter(before, after, size, marker=marker, alpha=0.5, linewidths=0, **style)

    figure = _by_view(rows, keys, draw)
    last = clipped(rows.initial_pde_mm).max()
    same = np.linspace(last / 100, last, 100)
    for axes in figure.axes:
        axes.plot(same, same, color="0.5", linestyle="--", linewidth=1, zorder=0)
        axes.set(xlabel="PDE before (mm)", xlim=(0, 1.02 * last))
        plain_logarithmic(axes, "y")
    figure.axes[0].set_ylabel("PDE after (mm)")
    return figure


def _by_view(
    rows: pd.DataFrame, keys: list[str], draw: Callable[[Axes, pd.DataFrame, int, dict[str, str]], None]
) -> Figure:
    """A panel for each view, into which ``draw`` puts each group with its colour and label.

    The number that ``draw`` gets counts how often the palette was used up before.
    """
    others = [key for key in keys if key != "view"]
    labels = [", ".join(names) for names, _ in groups_of(rows, others)]
    colours = dict(zip(labels, palette(len(labels)), strict=True))
    views = sorted(rows["view"].unique())
    columns = max(1, _LEGEND_LETTERS // (6 + max(map(len, labels))))
    lines = -(-len(labels) // columns) if others else 0
    figure = Figure(figsize=(_WIDTH, _HEIGHT + 0.25 * lines), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, len(views), sharex=True, sharey=True, squeeze=False)[0]
    for axes, view in zip(panels, views, strict=True):
        axes.set_title(view)
        for names, some in groups_of(rows[rows["view"] == view], others):
            label = ", ".join(names)
            draw(axes, some, labels.index(label) // len(PALETTE), {"color": colours[label], "label": label})
    if others:
        legend_above(figure, columns)
    return figure
