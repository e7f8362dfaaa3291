"""Markdown that the studies' table.md are made of."""

from collections.abc import Sequence

import pandas as pd


def table(header: Sequence[object], lines: Sequence[Sequence[object]]) -> str:
    """Header and lines; nothing without lines."""
    if not lines:
        return ""
    rows = ["| " + " | ".join(map(str, cells)) + " |" for cells in (header, *lines)]
    return "\n".join([rows[0], "|" + "---|" * len(header), *rows[1:]]) + "\n"


def share(true: pd.Series) -> str:
    """How many of all are true, in per cent."""
    return f"{100 * true.mean():.1f} % of {len(true)}" if len(true) else "none"
