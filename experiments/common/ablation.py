"""Arms of a sweep compared, from its rows alone: accuracy and cost of each, and tests against a reference."""

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd

mpl.use("agg")

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from experiments.common import markdown
from experiments.common.registrations import cases_of, groups_of, natural, read_rows
from experiments.common.statistics import median_interval, paired, share_interval
from experiments.common.style import DPI, clipped, palette, plain_logarithmic, use_style
from experiments.common.summary import distance
from regtorch.errors import RegtorchError

_SHARES = {1: {"markerfacecolor": "white", "markersize": 9}, 5: {"markersize": 5}}
"""Shares of registrations under so many mm, with their markers: a small one is seen within a large one."""

_ENOUGH = 6
"""So few registrations bound their median with 95 %: 1 - 2 / 2**n."""

_SPREAD = 0.7
"""Height of an arm's views, where arms are 1 apart."""


def write(folder: Path, reference: str | None = None) -> list[Path]:
    """Writes ``table.md`` and ``ablation.png`` and returns their paths; the reference is by default the first arm.

    Raises ``RegtorchError`` for fewer than two arms and for a reference that is none of them.
    """
    rows = read_rows(folder)
    rows = rows[rows.pde_mm.notna()]
    arms = sorted(rows["arm"].unique(), key=natural) if "arm" in rows else []
    if len(arms) < 2:
        raise RegtorchError(f"{folder}: arms [{', '.join(arms)}], expected two or more to compare")
    reference = reference or arms[0]
    if reference not in arms:
        raise RegtorchError(f"--reference {reference}: expected one of {', '.join(arms)}")
    found = summary(rows)
    paths = [folder / "table.md", folder / "ablation.png"]
    paths[0].write_text(table(rows, found, reference), encoding="utf-8")
    use_style()
    figure = ablation_figure(rows, found)
    figure.savefig(paths[1], dpi=DPI)
    plt.close(figure)
    return paths


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """One line per arm and view; ``pde`` (mm) and ``under_N`` (%) come with ``_low`` and ``_high``, 95 % intervals."""
    lines = []
    for (arm, view), some in groups_of(rows, ["arm", "view"]):
        pde = some.pde_mm
        line = {"arm": arm, "view": view, "n": len(some), "worst": pde.max(), "pde": pde.median()}
        line["pde_low"], line["pde_high"] = median_interval(pde)
        for limit in _SHARES:
            low, high = share_interval((pde < limit).sum(), len(pde))
            line |= {f"under_{limit}": 100 * (pde < limit).mean()}
            line |= {f"under_{limit}_low": 100 * low, f"under_{limit}_high": 100 * high}
        lines.append(line | {"evaluations": some.evaluations.median(), "seconds": some.seconds.median()})
    return pd.DataFrame(lines)


def table(rows: pd.DataFrame, found: pd.DataFrame, reference: str) -> str:
    """Markdown: each arm and view by itself, then each arm against the reference."""
    header = ["arm", "view", "n", "PDE", *(f"under {limit} mm, %" for limit in _SHARES), "worst"]
    lines = []
    for _, line in found.iterrows():
        measured = ["pde", *(f"under_{limit}" for limit in _SHARES)]
        cells = [line.arm, line["view"], line.n, *(_with_interval(line, name) for name in measured)]
        lines.append([*cells, distance(line.worst), f"{line.evaluations:,.0f}", f"{line.seconds:.3g}"])
    alone = markdown.table([*header, "evaluations", "seconds"], lines)
    cases = cases_of(rows)
    against = paired(rows.assign(pde_mm=clipped(rows.pde_mm)), reference, cases, "pde_mm")
    lines = [
        [arm, f"{line.pairs:.0f}", distance(line.ratio), _p(line.p), _p(line.p_holm)]
        for arm, line in against.iterrows()
    ]
    header = ["arm", "pairs", f"PDE by that of {reference}", "p", "p, corrected"]
    note = "PDE in the detector plane, mm. Medians, where nothing else is said; in brackets 95 % intervals, those of\n"
    note += "medians by bootstrap, of shares by Wilson. p: Wilcoxon's signed-rank test of the logarithms of PDE, in\n"
    note += f"pairs of like {', '.join(cases)}, two-sided; corrected for the number of arms by Holm.\n"
    if found.n.min() < _ENOUGH:
        note += f"Of fewer than {_ENOUGH} not even their whole range holds the median with 95 %.\n"
    return "\n".join(["## Arms\n", alone, f"## Against {reference}\n", markdown.table(header, lines), note])


def ablation_figure(rows: pd.DataFrame, found: pd.DataFrame) -> mpl.figure.Figure:
    """PDE of all and its median, shares under 1 and 5 mm, evaluations and seconds; bars are 95 % intervals."""
    arms, views = list(dict.fromkeys(found.arm)), sorted(found["view"].unique())
    figure, panels = plt.subplots(
        1, 4, figsize=(10, 1.6 + 0.26 * len(found)), sharey=True, width_ratios=(3, 2, 1.3, 1.3), layout="constrained"
    )
    colours = dict(zip(views, palette(len(views)), strict=True))
    scatter = np.random.default_rng(0)
    for _, line in found.iterrows():
        colour = colours[line["view"]]
        y = arms.index(line.arm) + _SPREAD * ((views.index(line["view"]) + 0.5) / len(views) - 0.5)
        pde = clipped(rows.pde_mm[(rows["arm"] == line.arm) & (rows["view"] == line["view"])])
        jitter = y + scatter.uniform(-0.1, 0.1, len(pde))
        panels[0].scatter(pde, jitter, 3 + 60 / np.sqrt(len(pde)), color=colour, alpha=0.3, linewidths=0)
        _point(panels[0], y, clipped(line[["pde", "pde_low", "pde_high"]].astype(float)), color=colour, ecolor="0.1")
        for limit, style in _SHARES.items():
            name = f"under_{limit}"
            _point(panels[1], y, line[[name, f"{name}_low", f"{name}_high"]], color=colour, **style)
        panels[2].plot(line.evaluations / 1000, y, "o", color=colour)
        panels[3].plot(line.seconds, y, "o", color=colour)
    for axes, label in zip(panels, ("PDE (mm)", "share (%)", "evaluations (1000)", "seconds"), strict=True):
        axes.set_xlabel(label)
        if axes is not panels[1]:
            plain_logarithmic(axes, "x")
    panels[0].set_yticks(range(len(arms)), arms)
    panels[0].set_ylim(len(arms) - 0.5, -0.5)
    kinds = {view: {"color": colour} for view, colour in colours.items()}
    kinds |= {f"under {limit} mm": {"color": "0.1"} | style for limit, style in _SHARES.items()}
    handles = [Line2D([], [], marker="o", linestyle="none", label=label, **kind) for label, kind in kinds.items()]
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles), frameon=False)
    return figure


def _point(axes: Axes, y: float, value_low_high: pd.Series, **style: Any) -> None:
    value, low, high = value_low_high
    bar = {"fmt": "o", "markeredgecolor": "0.1", "elinewidth": 1.2, "capsize": 2.5} | style
    axes.errorbar(value, y, xerr=[[max(0, value - low)], [max(0, high - value)]], **bar)


def _with_interval(line: pd.Series, name: str) -> str:
    return f"{distance(line[name])} [{distance(line[f'{name}_low'])}, {distance(line[f'{name}_high'])}]"


def _p(value: float) -> str:
    """A p value; empty for an arm without a test."""
    return "" if np.isnan(value) else f"{value:.2g}"
