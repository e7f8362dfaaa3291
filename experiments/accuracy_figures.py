"""Table and figures of the accuracy study, from its rows alone: python -m experiments.accuracy_figures [FOLDER]"""

import sys
from pathlib import Path

import matplotlib as mpl
import pandas as pd
import seaborn as sns

mpl.use("agg")

_PARAMETERS = [
    "x_s_mm", "y_s_mm", "z_s_mm", "x_obj_mm", "y_obj_mm", "z_obj_mm", "eta_deg", "theta_deg", "phi_deg",
]  # fmt: skip
_PALETTE = ["#0072b2", "#e69f00", "#009e73"]


def main(folder: Path) -> None:
    rows = pd.read_csv(folder / "registrations.csv")
    thresholded = rows.radiograph_threshold_hu.notna()
    rows["radiograph"] = thresholded.map({True: "bone alone", False: "full CT"})
    rows["arm"] = rows.dof.astype(str) + "-DOF, " + rows.radiograph
    (folder / "table.md").write_text(table(rows))
    sns.set_theme(style="whitegrid", context="paper", font_scale=1.1)
    accuracy_figure(rows).savefig(folder / "accuracy.png", dpi=150)
    coupling_figure(rows).savefig(folder / "coupling.png", dpi=150)


def table(rows: pd.DataFrame) -> str:
    """Markdown: one line per arm and view; medians of absolute errors."""
    header = ["arm", "view", "n", "initial PDE", "median PDE", "max PDE", "over 1 mm", "over 5 mm", "3D error"]
    header += [f"abs. {p.rsplit('_', 1)[0]}" for p in _PARAMETERS] + ["evaluations", "seconds", "longest", "not ok"]
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    for (arm, view), some in rows.groupby(["arm", "view"], sort=False):
        pde = some.pde_mm
        cells = [arm, view, len(some), f"{some.initial_pde_mm.median():.1f}", f"{pde.median():.4f}", f"{pde.max():.3f}"]
        cells += [int((pde > 1).sum()), int((pde > 5).sum()), f"{some.target_error_mm.median():.3f}"]
        cells += [f"{some[f'error_{p}'].abs().median():.3f}" for p in _PARAMETERS]
        cells += [f"{some.evaluations.mean():.0f}", f"{some.seconds.median():.0f}", f"{some.seconds.max():.0f}"]
        cells += [int((some.status != "ok").sum())]
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    note = "\nMillimetres and degrees; PDE in the detector plane. Radiographs are simulated by Siddon's method.\n"
    return "\n".join(lines) + "\n" + note


def accuracy_figure(rows: pd.DataFrame) -> mpl.figure.Figure:
    """PDE before and after, one point per registration."""
    long = pd.concat(
        [
            rows.assign(when="before", pde=rows.initial_pde_mm),
            rows.assign(when="after", pde=rows.pde_mm),
        ]
    )
    grid = sns.catplot(
        data=long, x="pde", y="arm", hue="when", col="view", kind="strip", dodge=True, palette=_PALETTE[:2],
        alpha=0.8, height=3, aspect=1.4, log_scale=True,
    )  # fmt: skip
    grid.set_axis_labels("projection distance error (mm)", "")
    grid.set_titles("{col_name}")
    return grid.figure


def coupling_figure(rows: pd.DataFrame) -> mpl.figure.Figure:
    """What an error of the source does to the patient: errors of x_obj, y_obj, z_obj against x_s, y_s, z_s."""
    some = rows[rows.radiograph == "bone alone"]
    parts = []
    for axis in "xyz":
        part = some[["view", "dof"]].copy()
        part["axis"] = axis
        part["source"], part["patient"] = some[f"error_{axis}_s_mm"], some[f"error_{axis}_obj_mm"]
        part["share"] = some.initial_z_obj_mm / some.initial_z_s_mm
        parts.append(part)
    long = pd.concat(parts)
    long["degrees of freedom"] = long.dof.astype(str)
    grid = sns.relplot(
        data=long, x="source", y="patient", col="axis", row="view", hue="degrees of freedom",
        style="degrees of freedom", palette=_PALETTE[:2], height=2.8, s=45,
    )  # fmt: skip
    for (view, _), axes in grid.axes_dict.items():
        share = float(long.loc[long["view"] == view, "share"].iloc[0])
        axes.axline((0, 0), slope=share, color="0.5", linestyle="--", linewidth=1, zorder=0)
        axes.text(0.04, 0.94, f"ODD:SDD = {share:.2f}", transform=axes.transAxes, color="0.4", va="top", fontsize=8)
    grid.set_axis_labels("error of the source (mm)", "error of the patient (mm)")
    grid.set_titles("{row_name}, {col_name}")
    return grid.figure


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("results/accuracy"))
