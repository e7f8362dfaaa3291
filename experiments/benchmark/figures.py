"""Tables and figure of the benchmark, from its rows alone; needs no torch."""

from pathlib import Path

import matplotlib as mpl
import matplotlib.ticker
import pandas as pd

mpl.use("agg")

import matplotlib.pyplot as plt

from experiments.common import markdown
from experiments.common.style import DPI, PALETTE, use_style
from regtorch.errors import RegtorchError

_WANTED = [
    # case, implementation, threads (None: any), column, at least (1) or at most (-1), bound
    ("value_125", "RTK", None, "times_regtorch", 1, 10),
    ("value_125", "nanodrr", None, "times_regtorch", 1, 100),
    ("value_125", "nanodrr, 500 samples", None, "times_regtorch", 1, 100),
    ("value_125_all_tissue", "RTK", None, "times_regtorch", 1, 5),
    ("jacobian_125", "nanodrr", None, "times_regtorch", 1, 250),
    ("jacobian_125", "nanodrr, 500 samples", None, "times_regtorch", 1, 250),
    ("value_500_full_resolution", "RTK", None, "times_regtorch", 1, 10),
    ("two_classes_125", "regtorch two classes", None, "times_regtorch", -1, 1.4),
    ("gc_125", "regtorch, rendering alone", None, "times_regtorch", 1, 0.9),
    ("gc_125", "regtorch", None, "per_second", 1, 2000),
    ("gc_50", "regtorch", None, "per_second", 1, 15000),
    ("threads", "regtorch", 1, "times_regtorch", 1, 1.8),
    ("gpu_paper_budget", "regtorch", None, "seconds", -1, 3),
    ("gpu_nanodrr_200", "nanodrr Triton", None, "times_regtorch", 1, 2),
]
"""The claims of the project about speed."""


def write(folder: Path) -> list[Path]:
    """Writes ``table.md`` and ``cost.png`` and returns their paths; raises ``RegtorchError`` without a table."""
    path = folder / "benchmark.csv"
    if not path.is_file():
        raise RegtorchError(f"{path}: no such file, expected the table of the benchmark")
    rows = pd.read_csv(path)
    paths = [folder / "table.md", folder / "cost.png"]
    paths[0].write_text(wanted(rows) + "\n" + table(rows), encoding="utf-8")
    use_style()
    cost_figure(rows).savefig(paths[1], dpi=DPI)
    return paths


def wanted(rows: pd.DataFrame) -> str:
    """Markdown: each claim, its bound and what was found."""
    lines = []
    for case, implementation, threads, column, sign, bound in _WANTED:
        some = rows[(rows.case == case) & (rows.implementation == implementation)]
        some = some if threads is None else some[some.threads == threads]
        value = pd.to_numeric(some[column], errors="coerce").dropna()
        found, met = "not measured", ""
        if len(value):
            found, met = f"{value.iloc[-1]:.3g}", "yes" if sign * (value.iloc[-1] - bound) >= 0 else "no"
        limit = f"{'at least' if sign > 0 else 'at most'} {bound:g}"
        lines.append([case, implementation, column, limit, found, met])
    return markdown.table(["case", "against", "what", "wanted", "found", "met"], lines)


def table(rows: pd.DataFrame) -> str:
    """Markdown: all rows but those of the sweeps; the figure shows these."""
    header = ["case", "implementation", "device", "threads", "per second", "times regtorch", "share of limit"]
    header += ["samples per second", "difference", "spread", "poses", "voxels", "MB"]
    columns = ["case", "implementation", "device", "threads", "per_second", "times_regtorch", "share_of_limit"]
    columns += ["samples_per_second", "relative_difference", "seconds_spread", "poses", "voxels", "megabytes"]
    some = rows[~rows.case.str.startswith("sweep")]
    return markdown.table(header, [[_cell(column, row[column]) for column in columns] for _, row in some.iterrows()])


def cost_figure(rows: pd.DataFrame) -> mpl.figure.Figure:
    """Milliseconds per image against pixels, voxels, batch and threads."""
    rows = rows.assign(per_second=pd.to_numeric(rows.per_second, errors="coerce"))
    rows = rows[rows.per_second.notna()]
    rows["ms"] = 1000 / rows.per_second
    names = sorted(rows[rows.case.str.startswith("sweep") | (rows.case == "threads")].implementation.unique())
    names.sort(key=lambda name: name != "regtorch")
    colours = dict(zip(names, PALETTE, strict=False))
    figure, panels = plt.subplots(2, 2, figsize=(9, 7), constrained_layout=True)
    for panel, (case, column, label) in zip(
        panels.flat,
        [
            ("sweep_pixels", "pixels", "pixels along a side"),
            ("sweep_voxels", "voxel_mm", "size of a voxel (mm)"),
            ("sweep_batch", "poses", "poses in a call"),
            ("threads", "threads", "threads"),
        ],
        strict=True,
    ):
        some = rows[rows.case == case]
        for number, name in enumerate(names):
            line = some[some.implementation == name].sort_values(column)
            style = {"color": colours.get(name, "0.4"), "marker": "osD^vPX"[number % 7], "label": name}
            if len(line):
                panel.plot(line[column], line.ms, **style)
        ticks = sorted(some[column].dropna().unique())
        panel.set(xscale="log", yscale="log", xlabel=label, ylabel="ms per image")
        panel.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        panel.yaxis.set_major_locator(mpl.ticker.LogLocator(subs=(1, 2, 5)))
        panel.yaxis.set_major_formatter("{x:g}")
        panel.minorticks_off()
    handles = {h.get_label(): h for panel in panels.flat for h in panel.get_lines()}
    if handles:
        figure.legend(handles.values(), handles.keys(), loc="outside upper center", ncols=len(handles), frameon=False)
    return figure


def _cell(column: str, value: object) -> str:
    if pd.isna(value):
        return ""
    number = pd.to_numeric(value, errors="coerce")
    if column in ("case", "implementation", "device", "voxels") or pd.isna(number):
        return str(value)
    if column in ("share_of_limit", "relative_difference", "seconds_spread"):
        return f"{100 * number:.2g} %"
    return f"{number:,.0f}" if number >= 1000 else f"{number:.3g}"
