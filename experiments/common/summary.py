"""Tables of any study's registrations: the accuracy of each group, and the worst cases."""

from collections.abc import Iterable

import numpy as np
import pandas as pd

from experiments.common.registrations import groups_of

_OVER_MM = (1, 5, 10)

Table = tuple[list[str], list[list[str]]]
"""Header and lines."""


def headline(rows: pd.DataFrame, keys: list[str]) -> Table:
    """One line per group: medians of PDE (mm), seconds and evaluations; counts of large PDEs and of statuses.

    Quantiles leave out registrations without a PDE: decoys, which fit nowhere.
    """
    header = [*keys, "n", "PDE before", "PDE", "quartiles", "95 %", "worst", f"over {_join(_OVER_MM)} mm"]
    header += ["statuses", "seconds", "evaluations"]
    lines = []
    for names, some in groups_of(rows, keys):
        pde = some.pde_mm.dropna()
        line = [*names, str(len(some)), distance(some.initial_pde_mm.median()), distance(pde.median())]
        if len(pde):
            low, high, most = np.quantile(pde, (0.25, 0.75, 0.95), method="higher")
            over = _join((pde > limit).sum() for limit in _OVER_MM)
            line += [f"{distance(low)} to {distance(high)}", distance(most), distance(pde.max()), over]
        else:
            line += [""] * 4
        line += [statuses(some.status), f"{some.seconds.median():.3g}", f"{some.evaluations.median():,.0f}"]
        lines.append(line)
    return header, lines


def worst(rows: pd.DataFrame, count: int) -> pd.DataFrame:
    """The ``count`` rows of largest PDE, largest first."""
    return rows[rows.pde_mm.notna()].nlargest(count, "pde_mm")


def statuses(status: pd.Series) -> str:
    return ", ".join(f"{count} {name}" for name, count in status.value_counts().items())


def distance(value: float) -> str:
    """Three digits; nothing where there is no number."""
    if pd.isna(value):
        return ""
    return "∞" if np.isinf(value) else f"{value:.3g}"


def _join(numbers: Iterable[int]) -> str:
    return ", ".join(map(str, numbers))
