"""Figures of the simulation study, from its rows alone; needs no torch."""

from pathlib import Path

import matplotlib as mpl
import pandas as pd
import seaborn as sns

mpl.use("agg")

import matplotlib.pyplot as plt

from experiments.common.coupling import coupling_figure
from experiments.common.registrations import PARAMETERS, read_rows
from experiments.common.report.figures import before_and_after_figure
from experiments.common.style import DPI, PALETTE, SHOWN_MM, plain_logarithmic, use_style
from experiments.simulation.numbers import ARMS, table
from experiments.simulation.start_figure import start_figure, starts_of
from regtorch.errors import RegtorchError

_VIEWS = ("LAT", "PA")  # in the paper's order
_LEAST = 1e-6  # for logarithms
_LABELS = {
    "x_s_mm": "$x_s$", "y_s_mm": "$y_s$", "z_s_mm": "$z_s$",
    "x_obj_mm": "$x_{obj}$", "y_obj_mm": "$y_{obj}$", "z_obj_mm": "$z_{obj}$",
    "eta_deg": "η", "theta_deg": "θ", "phi_deg": "φ", "initial_pde": "start", "pde": "end",
}  # fmt: skip
_GROUPS = {"source (mm)": 3, "patient (mm)": 3, "patient (°)": 3, "PDE (mm)": 2}
"""The labels' quantities and how many labels each has, in order."""


NAMES = ("figure2", "figure4", "coupling", "pde", "table")


def write(folder: Path, only: str | None = None) -> list[Path]:
    """Writes the figures and the table of ``NAMES``, or one of them, and returns the paths.

    Without the study's marker in the CT there is no figure 2. Raises ``RegtorchError`` for rows of another study.
    """
    rows = read_rows(folder)
    if "arm" not in rows or not set(ARMS) & set(rows.arm):
        raise RegtorchError(f"{folder}: no arm {' or '.join(ARMS)} in its table, expected the simulation study's")
    rows = rows[rows.arm.isin(ARMS)]
    use_style()
    figures = {
        "figure2": lambda: start_figure(rows, folder),
        "figure4": lambda: error_figure(rows),
        "coupling": lambda: coupling_figure(rows),
        "pde": lambda: before_and_after_figure(rows, ["arm", "view"]),
    }
    if only is None and starts_of(rows, folder).empty:
        del figures["figure2"]
    written = []
    for name in figures if only is None else figures.keys() & {only}:
        figure = figures[name]()
        written.append(folder / f"{name}.png")
        figure.savefig(written[-1], dpi=DPI)
        plt.close(figure)
    if only in (None, "table"):
        written.append(folder / "table.md")
        written[-1].write_text(table(rows), encoding="utf-8")
    return written


def error_figure(rows: pd.DataFrame) -> mpl.figure.Figure:
    """The paper's figure 4: absolute errors of the nine parameters, PDE before and after, for each arm and view.

    Boxes are quartiles. Whiskers reach from the 1st percentile to the 99th; crosses lie above.
    """
    arms = [arm for arm in ARMS if (rows.arm == arm).any()]
    colours = [PALETTE[number] for number, count in enumerate(_GROUPS.values()) for _ in range(count)]
    figure, panels = plt.subplots(
        len(arms), 2, figsize=(10, 3.5 * len(arms)), sharex=True, sharey=True, squeeze=False, layout="constrained"
    )
    letters = iter("abcd")
    for line, arm in zip(panels, arms, strict=True):
        for axes, view in zip(line, _VIEWS, strict=True):
            some = rows[(rows.arm == arm) & (rows.view == view)]
            errors = some[[f"error_{key}" for key in PARAMETERS]].abs().set_axis(PARAMETERS, axis=1)
            errors = errors.assign(initial_pde=some.initial_pde_mm, pde=some.pde_mm).clip(_LEAST, SHOWN_MM[1])
            sns.boxplot(
                errors.clip(errors.quantile(0.01), axis=1), palette=colours, saturation=1, width=0.65, linewidth=1,
                linecolor="0.15", fliersize=3.5, flierprops={"marker": "x", "markeredgewidth": 0.7},
                medianprops={"linewidth": 2}, whis=(0, 99), log_scale=True, ax=axes,
            )  # fmt: skip
            plain_logarithmic(axes)
            axes.set_title(f"({next(letters)}) {view}, {arm}, n = {len(some)}", fontsize=11)
            axes.set_xticks(range(len(_LABELS)), _LABELS.values(), fontsize=11)
            for place in (2.5, 5.5, 8.5):
                axes.axvline(place, color="0.6", linewidth=1)
    for axes in panels[-1]:
        left = 0
        for name, count in _GROUPS.items():
            axes.text(left + count / 2 - 0.5, -0.15, name, transform=axes.get_xaxis_transform(), ha="center", va="top")
            left += count
    figure.supylabel("absolute error", fontsize=11)
    return figure
