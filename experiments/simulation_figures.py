"""Table and figures of the simulation study, from its rows alone.

    python -m experiments.simulation_figures [FOLDER] [--only figure4]

``figure2``: where the search begins; ``figure4``: errors of the parameters, PDE before and after; ``coupling``: how the
patient makes up for the source in 6-DOF; ``pde``: PDE after against before; ``table``: in numbers, beside the paper's.
Behind figure 2 is what the study left in ``background_PA.png`` and ``background_LAT.png``, if it did. Without the
study's marker in the CT there is no figure 2.
"""

import argparse
import sys
from pathlib import Path

import matplotlib as mpl
import pandas as pd
import seaborn as sns

mpl.use("agg")

import matplotlib.pyplot as plt

from experiments.coupling import coupling_figure
from experiments.simulation_table import ARMS, table
from experiments.start_figure import start_figure, starts_of
from regtorch.errors import RegtorchError
from regtorch.report.figures import before_and_after_figure
from regtorch.report.rows import PARAMETERS, read_rows
from regtorch.report.style import DPI, PALETTE, SHOWN_MM, plain_logarithmic, use_style

_VIEWS = ("LAT", "PA")  # in the paper's order
_LEAST = 1e-6  # for logarithms
_LABELS = {
    "x_s_mm": "$x_s$", "y_s_mm": "$y_s$", "z_s_mm": "$z_s$",
    "x_obj_mm": "$x_{obj}$", "y_obj_mm": "$y_{obj}$", "z_obj_mm": "$z_{obj}$",
    "eta_deg": "η", "theta_deg": "θ", "phi_deg": "φ", "initial_pde": "start", "pde": "end",
}  # fmt: skip
_GROUPS = {"source (mm)": 3, "patient (mm)": 3, "patient (°)": 3, "PDE (mm)": 2}
"""What the labels measure, in this order."""


def main(folder: Path, only: str | None = None) -> None:
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
    for name in figures if only is None else figures.keys() & {only}:
        figure = figures[name]()
        figure.savefig(folder / f"{name}.png", dpi=DPI)
        plt.close(figure)
    if only in (None, "table"):
        (folder / "table.md").write_text(table(rows), encoding="utf-8")


def error_figure(rows: pd.DataFrame) -> mpl.figure.Figure:
    """The paper's figure 4: absolute errors of the nine parameters, PDE before and after, for each arm and view.

    Boxes are quartiles, whiskers reach from the 1st percentile to the 99th, and crosses are what lies above.
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


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", nargs="?", type=Path, default=Path("results/simulation"))
    parser.add_argument("--only", choices=("figure2", "figure4", "coupling", "pde", "table"))
    options = parser.parse_args()
    try:
        main(options.folder, options.only)
    except RegtorchError as error:
        sys.exit(f"simulation_figures: error: {error}")
