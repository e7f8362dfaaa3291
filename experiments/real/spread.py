"""How far registrations of one pair lie apart, from their rows alone; needs no torch."""

from pathlib import Path

import numpy as np
import pandas as pd

from experiments.common.registrations import GOOD_MM, PARAMETERS, natural, read_rows
from regtorch.errors import RegtorchError

_NEEDED = ("pair", "arm", "half", "told_sdd_mm", "targets_mm", "expected_targets_mm")
FIRST, OTHER = "first", "other"
"""Halves of a radiograph."""


def read(folder: Path) -> pd.DataFrame:
    """The rows, with ``modal_mm``, the distance from the modal answer; raises ``RegtorchError`` for another study."""
    rows = read_rows(folder)
    if missing := [column for column in _NEEDED if column not in rows]:
        raise RegtorchError(f"{folder}: no column {missing[0]!r}, expected rows of the study of real pairs")
    rows["modal_mm"] = np.nan
    for _, some in rows.groupby("pair"):
        rows.loc[some.index, "modal_mm"] = from_modal(some)
    return rows


def targets(rows: pd.DataFrame) -> np.ndarray:
    """Where each row's image shows the targets, mm: rows x targets x 2."""
    return np.stack([np.array([point.split() for point in text.split(";")], float) for text in rows.targets_mm])


def from_modal(rows: pd.DataFrame) -> np.ndarray:
    """PDE of each row against the modal answer, mm.

    It is an answer of the arm with the highest median similarity, of those that saw the whole image. Most others of
    that arm are within 2 mm of it, and the mean distance from them is the least.
    """
    whole = rows[rows.half.isna()] if rows.half.isna().any() else rows
    best = whole[whole.arm == whole.groupby("arm").similarity.median().idxmax()]
    own = targets(best)
    distance = apart(own, own)
    near = distance < GOOD_MM
    mean = np.where(near, distance, 0).sum(1) / near.sum(1)
    modal = np.lexsort((mean, -near.sum(1)))[0]
    return apart(targets(rows), own[modal : modal + 1])[:, 0]


def apart(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """PDE of each answer of ``one`` against each of ``other``, mm."""
    return np.stack([np.hypot(*np.moveaxis(one - each, -1, 0)).mean(1) for each in other], axis=1)


def between(rows: pd.DataFrame) -> np.ndarray:
    """PDE of each two answers, mm."""
    seen = targets(rows)
    return apart(seen, seen)[np.triu_indices(len(rows), 1)]


def over_starts(rows: pd.DataFrame) -> dict[str, float]:
    """Standard deviation of each parameter over the runs, as a share of the expected one; NaN where it is frozen."""
    near = rows[rows.modal_mm < GOOD_MM]
    ratios = {}
    for key in PARAMETERS:
        expected = np.sqrt((near[f"expected_{key}"].astype(float) ** 2).mean())
        ratios[key] = near[f"found_{key}"].std() / expected if expected > 0 else np.nan
    return ratios


def over_halves(rows: pd.DataFrame) -> tuple[dict[str, float], int]:
    """Root mean square of (first half less other half) over its expected deviation, and the number of such pairs.

    The expected variance of the difference is the sum of both. Pairs with a half elsewhere or at a limit do not count.
    ``targets`` is the ratio of distances of the targets.
    """
    usable = rows[(rows.modal_mm < GOOD_MM) & rows.evidence_at_limit.isna()]
    first, other = (usable[usable.half == half].set_index("seed") for half in (FIRST, OTHER))
    seeds = first.index.intersection(other.index)
    first, other = first.loc[seeds], other.loc[seeds]
    if not len(seeds):
        return {}, 0
    ratios = {}
    for key in PARAMETERS:
        variance = first[f"expected_{key}"] ** 2 + other[f"expected_{key}"] ** 2
        ratios[key] = float(np.sqrt(((first[f"found_{key}"] - other[f"found_{key}"]) ** 2 / variance).mean()))
    squares = ((targets(first) - targets(other)) ** 2).sum(2).mean(1)
    expected = first.expected_targets_mm**2 + other.expected_targets_mm**2
    ratios["targets"] = float(np.sqrt((squares / expected).mean()))
    return ratios, len(seeds)


def by_arm(rows: pd.DataFrame) -> list[tuple[str, str, pd.DataFrame]]:
    """Pair, arm and rows, in natural order."""
    groups = [(str(pair), str(arm), some) for (pair, arm), some in rows.groupby(["pair", "arm"])]
    return sorted(groups, key=lambda group: (natural(group[0]), natural(group[1])))
