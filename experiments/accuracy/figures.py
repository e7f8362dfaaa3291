"""Table and figures of the accuracy study, from its rows alone; needs no torch."""

from pathlib import Path

import matplotlib as mpl
import pandas as pd
import seaborn as sns

mpl.use("agg")

from experiments.common import markdown
from experiments.common.coupling import coupling_figure
from experiments.common.registrations import PARAMETERS, read_rows
from experiments.common.style import DPI, palette, use_style
from regtorch.errors import RegtorchError


def write(folder: Path) -> list[Path]:
    """Writes ``table.md``, ``accuracy.png`` and ``coupling.png`` and returns their paths.

    Raises ``RegtorchError`` for rows of another study.
    """
    rows = read_rows(folder)
    if missing := [column for column in ("dof", "radiograph_threshold_hu") if column not in rows]:
        raise RegtorchError(f"{folder}: no column {missing[0]!r}, expected rows of the accuracy study")
    thresholded = rows.radiograph_threshold_hu.notna()
    rows["radiograph"] = thresholded.map({True: "bone alone", False: "full CT"})
    rows["arm"] = rows.dof.astype(str) + "-DOF, " + rows.radiograph
    paths = [folder / name for name in ("table.md", "accuracy.png", "coupling.png")]
    paths[0].write_text(table(rows), encoding="utf-8")
    use_style()
    accuracy_figure(rows).savefig(paths[1], dpi=DPI)
    coupling_figure(rows[rows.radiograph == "bone alone"]).savefig(paths[2], dpi=DPI)
    return paths


def table(rows: pd.DataFrame) -> str:
    """Markdown: one line per arm and view; medians of absolute errors."""
    header = ["arm", "view", "n", "initial PDE", "median PDE", "max PDE", "over 1 mm", "over 5 mm", "3D error"]
    header += [f"abs. {p.rsplit('_', 1)[0]}" for p in PARAMETERS] + ["evaluations", "seconds", "longest", "not ok"]
    lines = []
    for (arm, view), some in rows.groupby(["arm", "view"], sort=False):
        pde = some.pde_mm
        cells = [arm, view, len(some), f"{some.initial_pde_mm.median():.1f}", f"{pde.median():.4f}", f"{pde.max():.3f}"]
        cells += [int((pde > 1).sum()), int((pde > 5).sum()), f"{some.target_error_mm.median():.3f}"]
        cells += [f"{some[f'error_{p}'].abs().median():.3f}" for p in PARAMETERS]
        cells += [f"{some.evaluations.mean():.0f}", f"{some.seconds.median():.0f}", f"{some.seconds.max():.0f}"]
        cells += [int((some.status != "ok").sum())]
        lines.append(cells)
    note = "\nMillimetres and degrees; PDE in the detector plane. Radiographs are simulated by Siddon's method.\n"
    return markdown.table(header, lines) + note


def accuracy_figure(rows: pd.DataFrame) -> mpl.figure.Figure:
    """PDE before and after, one point per registration."""
    long = pd.concat(
        [
            rows.assign(when="before", pde=rows.initial_pde_mm),
            rows.assign(when="after", pde=rows.pde_mm),
        ]
    )
    grid = sns.catplot(
        data=long, x="pde", y="arm", hue="when", col="view", kind="strip", dodge=True, palette=palette(2),
        alpha=0.8, height=3, aspect=1.4, log_scale=True,
    )  # fmt: skip
    grid.set_axis_labels("projection distance error (mm)", "")
    grid.set_titles("{col_name}")
    return grid.figure
