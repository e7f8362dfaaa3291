"""Tables and figures of the search study, from its rows alone; needs no torch."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
import seaborn as sns

mpl.use("agg")

from experiments.common import markdown
from experiments.common.registrations import DECOY, FAILED_MM, GOOD_MM, read_rows, shown
from experiments.common.style import DPI, clipped, palette, use_style
from experiments.common.summary import statuses
from regtorch.errors import RegtorchError

_KEY = ["ct", "view", "kind", "seed"]


def write(folder: Path) -> list[Path]:
    """Writes ``table.md``, ``pde.png`` and, where registrations expect an error, ``calibration.png``.

    Raises ``RegtorchError`` for rows of another study.
    """
    rows = read_rows(folder)
    if missing := [column for column in (*_KEY, "expected_pde_mm", "within_region") if column not in rows]:
        raise RegtorchError(f"{folder}: no column {missing[0]!r}, expected rows of the search study")
    rows = rows.sort_values(_KEY, ignore_index=True)
    rows["ct"] = rows.ct.map(shown)
    decoy = rows.kind.str.startswith(DECOY)
    right, decoys = rows[~decoy], rows[decoy]
    parts = [accuracy_table(right), verdict_table(right), decoy_table(decoys)]
    note = "PDE in the detector plane, mm. Medians, where nothing else is said; '95 %' is the 95th percentile.\n"
    written = [folder / "table.md"]
    written[0].write_text("\n".join([*filter(None, parts), note]), encoding="utf-8")
    use_style()
    if len(right):
        written.append(folder / "pde.png")
        pde_figure(right).savefig(written[-1], dpi=DPI)
    if right.expected_pde_mm.notna().any():
        written.append(folder / "calibration.png")
        calibration_figure(right).savefig(written[-1], dpi=DPI)
    return written


def accuracy_table(rows: pd.DataFrame) -> str:
    """Markdown: one line per CT, view and kind of radiograph."""
    header = ["CT", "view", "kind", "n", "initial PDE", "median PDE", "95 % PDE", "worst PDE"]
    header += [f"under {FAILED_MM:g} mm", "seconds", "95 % seconds", "evaluations", "statuses"]
    lines = []
    for (ct, view, kind), some in rows.groupby(_KEY[:3]):
        pde = some.pde_mm
        cells = [ct, view, kind, len(some), f"{some.initial_pde_mm.median():.0f}", f"{pde.median():.3g}"]
        cells += [f"{pde.quantile(0.95, interpolation='higher'):.3g}", f"{pde.max():.3g}"]
        cells += [markdown.share(pde < FAILED_MM), f"{some.seconds.median():.1f}"]
        cells += [f"{some.seconds.quantile(0.95):.1f}", f"{some.evaluations.median():.0f}", statuses(some.status)]
        lines.append(cells)
    return markdown.table(header, lines)


def verdict_table(rows: pd.DataFrame) -> str:
    """Markdown: how far verdict and expected PDE can be trusted, by kind of radiograph and of all."""
    header = ["kind", f"ok of those over {FAILED_MM:g} mm", f"not ok of those under {GOOD_MM:g} mm"]
    header += ["rank correlation of expected and actual PDE", "within their 95 % region"]
    groups = [*rows.groupby("kind"), ("all", rows)] if len(rows) else []
    lines = []
    for kind, some in groups:
        ok = some.status == "ok"
        failed, good = some.pde_mm > FAILED_MM, some.pde_mm < GOOD_MM
        told = some[some.expected_pde_mm.notna()]
        rank = told.expected_pde_mm.rank().corr(told.pde_mm.rank()) if len(told) > 2 else np.nan
        inside = some.within_region.dropna().astype(str) == "True"
        cells = [kind, f"{int((ok & failed).sum())} of {int(failed.sum())}", markdown.share(~ok[good])]
        lines.append([*cells, "not told" if np.isnan(rank) else f"{rank:.2f}", markdown.share(inside)])
    return markdown.table(header, lines)


def decoy_table(rows: pd.DataFrame) -> str:
    """Markdown: the statuses of images that fit nowhere."""
    groups = rows.groupby(_KEY[:3])
    lines = [
        [ct, view, kind.removeprefix(DECOY), len(some), statuses(some.status)] for (ct, view, kind), some in groups
    ]
    return markdown.table(["CT", "view", "decoy", "n", "statuses"], lines)


def pde_figure(rows: pd.DataFrame) -> mpl.figure.Figure:
    """Share of the registrations up to each PDE."""
    grid = sns.displot(
        data=rows.assign(pde=clipped(rows.pde_mm)), x="pde", hue="kind", row="ct", col="view", kind="ecdf",
        palette=palette(rows.kind.nunique()), log_scale=(True, False), height=2.6, aspect=1.5,
    )  # fmt: skip
    grid.refline(x=FAILED_MM)
    grid.set_axis_labels("projection distance error (mm)", "share of registrations")
    grid.set_titles("{row_name}, {col_name}")
    return grid.figure


def calibration_figure(rows: pd.DataFrame) -> mpl.figure.Figure:
    """The PDE that a registration expects of itself, against the actual one."""
    rows = rows[rows.expected_pde_mm.notna()]
    grid = sns.relplot(
        data=rows.assign(expected=clipped(rows.expected_pde_mm), pde=clipped(rows.pde_mm)), x="expected", y="pde",
        col="kind", hue="ct", style="status", style_order=["ok", "doubtful", "failed"],
        palette=palette(rows.ct.nunique()), height=3.2, s=30, alpha=0.7,
    )  # fmt: skip
    for axes in grid.axes.flat:
        axes.set(xscale="log", yscale="log")
        axes.axline((1, 1), (10, 10), color="0.5", linestyle="--", linewidth=1, zorder=0)
    grid.set_axis_labels("expected PDE (mm)", "actual PDE (mm)")
    grid.set_titles("{col_name}")
    return grid.figure
