"""Markdown tables of the studies' table.md."""

from collections.abc import Sequence

import pandas as pd


def table(header: Sequence[object], lines: Sequence[Sequence[object]]) -> str:
    """Header and lines; nothing without lines."""
    if not lines:
        return ""
    rows = ["| " + " | ".join(map(str, cells)) + " |" for cells in (header, *lines)]
    return "\n".join([rows[0], "|" + "---|" * len(header), *rows[1:]]) + "\n"


def share(true: pd.Series) -> str:
    """The share of true values in per cent, and the number of values."""
    return f"{100 * true.mean():.1f} % of {len(true)}" if len(true) else "none"
