"""The figure and the tables of the calibration."""

import datetime
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import pandas as pd
import seaborn as sns

mpl.use("agg")

from experiments.calibration.cases import Case, read_cases
from experiments.calibration.limits import JUDGED, limits_table, rules_table, verdicts
from experiments.common import markdown
from experiments.common.style import DPI, PALETTE, use_style
from regtorch.registration.trust import LIMITS

_COLUMNS = 3
_CLASSES = {True: "right", False: "wrong"}


def write(folders: Sequence[Path], out: Path) -> list[Path]:
    """Writes ``limits.csv``, ``rules.csv``, ``table.md`` and ``limits.png`` to ``out``."""
    cases = read_cases(folders)
    limits, rules = limits_table(cases), rules_table(cases)
    out.mkdir(parents=True, exist_ok=True)
    limits.assign(date=datetime.date.today().isoformat()).to_csv(out / "limits.csv", index=False)
    rules.to_csv(out / "rules.csv", index=False)
    (out / "table.md").write_text(_text(cases, limits, rules, folders), encoding="utf-8")
    use_style()
    limits_figure(cases, limits).savefig(out / "limits.png", dpi=DPI)
    return [out / name for name in ("limits.csv", "rules.csv", "table.md", "limits.png")]


def limits_figure(cases: Sequence[Case], limits: pd.DataFrame) -> mpl.figure.Figure:
    """Each number's right and wrong cases, the limit as a line, the interval of equally good values as a band."""
    rows = -(-len(JUDGED) // _COLUMNS)
    figure = mpl.figure.Figure(figsize=(10, 2.6 * rows), layout="constrained")
    panels = figure.subplots(rows, _COLUMNS).flat
    for axes, judged, (_, row) in zip(panels, JUDGED, limits.iterrows(), strict=False):
        known = [(judged.number(case.evidence), _CLASSES[case.right]) for case in cases if case.right is not None]
        some = pd.DataFrame([pair for pair in known if pair[0] is not None], columns=["value", "case"])
        colours = {"right": PALETTE[0], "wrong": PALETTE[5]}
        if judged.limit.endswith("_mm"):
            axes.set_xscale("log")
        sns.stripplot(
            some, x="value", y="case", hue="case", order=list(colours), palette=colours, ax=axes, size=2.5, alpha=0.5,
            legend=False,
        )  # fmt: skip
        axes.axvline(getattr(LIMITS, judged.limit), color="black", linewidth=1)
        ends = [row.low, row.high]
        if not any(map(pd.isna, ends)):
            axes.axvspan(*ends, color="0.85", zorder=0)
        axes.set(xlabel=judged.text, ylabel="", title=judged.limit)
    return figure


def _text(cases: Sequence[Case], limits: pd.DataFrame, rules: pd.DataFrame, folders: Sequence[Path]) -> str:
    right, wrong = (sum(case.right is known for case in cases) for known in (True, False))
    ok, doubted = verdicts(cases)
    shown = limits.astype(object).where(limits.notna(), "none")
    parts = [
        f"{len(cases)} registrations of {', '.join(folder.name for folder in folders)}: {right} right, {wrong} wrong.",
        f"Of the wrong ones {ok} are ok, of the right ones {doubted} are not.",
        "",
        "Limits: values between low and high are as good by these cases; none: no case bounds the limit there.",
        "",
        markdown.table(list(shown), [[_cell(value) for value in row] for row in shown.to_numpy()]),
        "Rules: cases that break a rule, and cases that break this rule alone.",
        "",
        markdown.table(list(rules), [[_cell(value) for value in row] for row in rules.to_numpy()]),
    ]
    return "\n".join(parts)


def _cell(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
