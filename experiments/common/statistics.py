"""Intervals of medians and shares, and tests of arms on the same cases."""

import numpy as np
import pandas as pd
from scipy.stats import wilcoxon

from experiments.common.registrations import natural

_RESAMPLES, _SEED = 2000, 0
_QUANTILES = (0.025, 0.975)
_Z = 1.959964  # of the normal distribution at 0.975


def median_interval(values: pd.Series) -> tuple[float, float]:
    """95 % of the medians of samples drawn anew from ``values``, with replacement: percentile bootstrap.

    Infinite values count; NaN where there are no values.
    """
    if not len(values):
        return np.nan, np.nan
    drawn = np.random.default_rng(_SEED).choice(values.to_numpy(float), (_RESAMPLES, len(values)))
    low, high = np.quantile(np.median(drawn, axis=1), _QUANTILES, method="inverted_cdf")
    return float(low), float(high)


def share_interval(count: int, n: int) -> tuple[float, float]:
    """95 % interval of a share of which ``count`` of ``n`` were seen, by Wilson (1927): not empty at none or all."""
    middle = (count + _Z**2 / 2) / (n + _Z**2)
    half = _Z / (n + _Z**2) * np.sqrt(count * (n - count) / n + _Z**2 / 4)
    return middle - half, middle + half


def paired(rows: pd.DataFrame, reference: str, keys: list[str], value: str) -> pd.DataFrame:
    """Each arm against the arm ``reference``, over the cases (``keys``) that both have; columns by arm:

    - pairs: how many cases both have
    - ratio: the median ratio of ``value`` to the reference's
    - p: of the Wilcoxon signed-rank test that the logarithm of that ratio is symmetric about 0, two-sided
    - p_holm: p, corrected by Holm (1979) for the number of arms that were tested

    All but ``pairs`` are NaN for an arm that shares no case.
    """
    wide = rows.pivot(index=keys, columns="arm", values=value)
    found = []
    for arm in sorted(wide.columns.drop(reference), key=natural):
        both = wide[[reference, arm]].dropna()
        difference = np.log(both[arm]) - np.log(both[reference])
        alike = 1.0 if len(both) else np.nan
        p = wilcoxon(difference).pvalue if difference.any() else alike
        found.append({"arm": arm, "pairs": len(both), "ratio": float(np.exp(difference.median())), "p": float(p)})
    table = pd.DataFrame(found, columns=["arm", "pairs", "ratio", "p"]).set_index("arm")
    tested = table.p.dropna()
    return table.assign(p_holm=pd.Series(holm(tested.to_numpy()), tested.index))


def holm(p: np.ndarray) -> np.ndarray:
    """Holm (1979): the smallest times their number, the next times one less, and so on, none less than the last."""
    order = np.argsort(p)
    corrected = np.empty(len(p))
    corrected[order] = np.minimum(1, np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1)))
    return corrected
