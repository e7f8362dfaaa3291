"""Errors of the patient that make up for errors of the source, in a search that takes the source for known."""

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from experiments.common.registrations import FAILED_MM
from experiments.common.style import legend_above, palette


def slopes(rows: pd.DataFrame, axis: str) -> tuple[float, float]:
    """ODD:SDD where the search began (median), and the slope of the patient's error along ``axis`` by the source's.

    The slope is that of a least-squares line through the registrations with a PDE under 5 mm.
    """
    some = rows[rows.pde_mm < FAILED_MM]
    expected = (rows.initial_z_obj_mm / rows.initial_z_s_mm).median()
    if len(some) < 2:
        return expected, np.nan
    return expected, np.polyfit(some[f"error_{axis}_s_mm"], some[f"error_{axis}_obj_mm"], 1)[0]


def coupling_figure(rows: pd.DataFrame) -> mpl.figure.Figure:
    """Errors of x_obj, y_obj, z_obj against those of x_s, y_s, z_s; dashed: ODD:SDD, the slope expected of 6-DOF."""
    views, freedoms = sorted(rows["view"].unique()), sorted(rows.dof.unique())
    figure, panels = plt.subplots(
        len(views), 3, figsize=(9, 0.6 + 2.6 * len(views)), sharex="col", sharey="col", squeeze=False,
        layout="constrained",
    )  # fmt: skip
    box = {"color": "0.2", "va": "top", "bbox": {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1}}
    size = 8 + 200 / np.sqrt(len(rows))
    for line, view in zip(panels, views, strict=True):
        for axes, axis in zip(line, "xyz", strict=True):
            for dof, colour, marker in zip(freedoms, palette(len(freedoms)), "osD", strict=False):
                some = rows[(rows["view"] == view) & (rows.dof == dof)]
                source, patient = some[f"error_{axis}_s_mm"], some[f"error_{axis}_obj_mm"]
                point = {"color": colour, "marker": marker, "linewidths": 0, "alpha": 0.6}
                axes.scatter(source, patient, size, label=f"{dof}-DOF", **point)
            axes.set_title(f"{view}, {axis}")
            six = rows[(rows["view"] == view) & (rows.dof == 6)]
            if len(six):
                expected, fitted = slopes(six, axis)
                axes.axline((0, 0), slope=expected, color="0.2", linestyle="--", linewidth=1.2)
                text = f"ODD:SDD {expected:.2f}\nslope {fitted:.2f}"
                axes.text(0.04, 0.95, text, transform=axes.transAxes, fontsize=10, **box)
    figure.supxlabel("error of the source (mm)", fontsize=11)
    figure.supylabel("error of the patient (mm)", fontsize=11)
    legend_above(figure, len(freedoms))
    return figure
