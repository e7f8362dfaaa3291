"""Table and figure of the study of real pairs, from its rows alone; needs no torch."""

from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

mpl.use("agg")

from experiments.common import markdown
from experiments.common.registrations import GOOD_MM, PARAMETERS
from experiments.common.style import DPI, clipped, palette, use_style
from experiments.common.summary import distance, statuses
from experiments.real import spread

_STATUSES = ("ok", "doubtful", "failed")
_COLUMNS = 4
_AGAIN = """\
Distances are PDE at the targets, mm in the detector plane. The modal answer of a pair comes from the arm with the
highest median similarity: most answers of this arm are within 2 mm of it. It is no truth.

New rows with new code: delete `registrations*.csv` and `settings.yaml` in this folder, then
`python -m experiments.real pairs=FILE out=FOLDER && python -m experiments.real_figures FOLDER`.
"""


def write(folder: Path) -> list[Path]:
    """Writes ``table.md`` and ``spread.png``; raises ``RegtorchError`` for rows of another study."""
    rows = spread.read(folder)
    parts = [places(rows), sdd(rows), verdicts(rows), expected(rows), halves(rows), _AGAIN]
    written = [folder / "table.md", folder / "spread.png"]
    written[0].write_text("\n".join(filter(None, parts)), encoding="utf-8")
    use_style()
    figure = spread_figure(rows)
    figure.savefig(written[1], dpi=DPI)
    plt.close(figure)
    return written


def places(rows: pd.DataFrame) -> str:
    """Markdown: how often the arms end at the modal answer, and how far runs lie apart."""
    header = ["pair", "arm", "n", f"within {GOOD_MM:g} mm of the modal answer", "between runs", "95 %", "largest"]
    told = [column for column in ("pde_mm", "answer_mm") if rows[column].notna().any()]
    header += [{"pde_mm": "PDE", "answer_mm": "from the other answer"}[column] for column in told]
    header += ["median from the modal answer", "similarity, least to most", "seconds"]
    lines = []
    for pair, arm, some in spread.by_arm(rows):
        between = spread.between(some)
        three = (np.median(between), np.quantile(between, 0.95), between.max()) if len(between) else (np.nan,) * 3
        line = [pair, arm, len(some), markdown.share(some.modal_mm < GOOD_MM), *map(distance, three)]
        line += [distance(some[column].median()) for column in told]
        line += [distance(some.modal_mm.median()), f"{some.similarity.min():.3f} to {some.similarity.max():.3f}"]
        line += [f"{some.seconds.median():.1f}"]
        lines.append(line)
    return markdown.table(header, lines)


def sdd(rows: pd.DataFrame) -> str:
    """Markdown: the SDD found and expected, where it is free."""
    header = ["pair", "arm", "SDD of the file", "found, median", "least to most", "expected +-", "within two of it"]
    lines = []
    for pair, arm, some in spread.by_arm(rows[rows.dof > 6]):
        found, expected_mm, told = some.found_z_s_mm, some.expected_z_s_mm, some.told_sdd_mm
        line = [pair, arm, "" if told.isna().all() else f"{told.iloc[0]:g}", f"{found.median():.1f}"]
        line += [f"{found.min():.1f} to {found.max():.1f}", f"{expected_mm.median():.1f}"]
        inside = ((found - told).abs() < 2 * expected_mm)[told.notna() & expected_mm.notna()]
        lines.append([*line, markdown.share(inside)])
    return markdown.table(header, lines)


def verdicts(rows: pd.DataFrame) -> str:
    """Markdown: statuses at the modal answer and elsewhere, and the reasons told."""
    header = ["pair", "arm", "at the modal answer", "elsewhere", "reasons"]
    lines = []
    for pair, arm, some in spread.by_arm(rows):
        near = some.modal_mm < GOOD_MM
        reasons = some.reasons.dropna().astype(str).str.split().explode()
        line = [pair, arm, statuses(some.status[near]) or "none", statuses(some.status[~near]) or "none"]
        lines.append([*line, statuses(reasons) or "none"])
    return markdown.table(header, lines)


def expected(rows: pd.DataFrame) -> str:
    """Markdown: the spread of each parameter over starts at the modal answer, over the expected deviation."""
    whole = rows[rows.half.isna()]
    lines = []
    for pair, arm, some in spread.by_arm(whole):
        near = some[some.modal_mm < GOOD_MM]
        if len(near) > 1:
            ratios = spread.over_starts(some)
            lines.append([pair, arm, len(near), *(distance(ratios[key]) for key in PARAMETERS)])
    table = markdown.table(["pair", "arm", "n", *map(_name, PARAMETERS)], lines)
    told = (
        "Spread over starts at the modal answer, over the expected standard deviation. One image: its errors are in\n"
    )
    return table and f"{told}all runs alike, so a true expectation makes this less than 1.\n\n{table}"


def halves(rows: pd.DataFrame) -> str:
    """Markdown: how far the answers of two halves of an image differ, over what they expect."""
    lines = []
    for pair, some in rows.groupby("pair"):
        for level, near in _alike(some[some.half.notna()]):
            ratios, count = spread.over_halves(near)
            if count:
                lines.append([pair, level, count, *(distance(ratios[key]) for key in (*PARAMETERS, "targets"))])
    table = markdown.table(["pair", "halves", "n", *map(_name, PARAMETERS), "targets"], lines)
    told = "Difference of the answers of two halves of the image, root mean square over what both expect: 1 where the\n"
    return table and f"{told}expectation is right. `alike`: similarities differ by less than 0.1.\n\n{table}"


def _alike(rows: pd.DataFrame) -> list[tuple[str, pd.DataFrame]]:
    """All rows, and those of halves that ended with about the same similarity: one tissue explained both."""
    wide = rows.pivot_table(index="seed", columns="half", values="similarity")
    if {*wide} < {spread.FIRST, spread.OTHER}:
        return []
    alike = wide.index[(wide[spread.FIRST] - wide[spread.OTHER]).abs() < 0.1]
    return [("all", rows), ("alike", rows[rows.seed.isin(alike)])]


def spread_figure(rows: pd.DataFrame) -> mpl.figure.Figure:
    """One panel per arm: similarity and distance from the modal answer of each run, by status."""
    groups = spread.by_arm(rows)
    lines = -(-len(groups) // _COLUMNS)
    figure, panels = plt.subplots(
        lines, _COLUMNS, figsize=(11, 0.6 + 2.3 * lines), sharex=True, sharey=True, squeeze=False, layout="constrained"
    )
    for axes, (pair, arm, some) in zip(panels.flat, groups, strict=False):
        for status, colour, marker in zip(_STATUSES, palette(3), "osD", strict=True):
            few = some[some.status == status]
            look = {"color": colour, "marker": marker, "alpha": 0.5, "linewidths": 0}
            axes.scatter(clipped(few.modal_mm), few.similarity, 22, label=status, **look)
        axes.axvline(GOOD_MM, color="0.4", linestyle="--", linewidth=1)
        axes.set_xscale("log")
        axes.set_title(arm if rows["pair"].nunique() == 1 else f"{pair}: {arm}", fontsize=10)
    for axes in panels.flat[len(groups) :]:
        axes.set_visible(False)
    for axes in panels.flat[max(0, len(groups) - _COLUMNS) : len(groups)]:
        axes.tick_params(labelbottom=True)
    handles, labels = panels.flat[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3, frameon=False)
    figure.supxlabel("distance from the modal answer (mm)", fontsize=11)
    figure.supylabel("similarity", fontsize=11)
    return figure


def _name(key: str) -> str:
    return key.rpartition("_")[0]
