"""The look of all figures: colours for colour-blind readers, letters legible in print and in a README."""

import pandas as pd
import seaborn as sns
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from experiments.common.registrations import natural

PALETTE = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#000000")
"""The palette of Okabe and Ito, without the yellow, which white paper swallows."""

YELLOW = "#f0e442"
"""The yellow of Okabe and Ito, for dark pictures."""

SHOWN_MM = (1e-4, 1e3)
"""The range of a logarithmic axis of distances."""

DPI = 150

_NARROWEST = 6
"""The least ratio of a logarithmic axis's ends: a smaller one may leave a single tick."""

_TICKS = {(1, 2, 5): 10, (1, 3): 100}
"""Ticks, times a power of ten, by the largest ratio of the axis's ends."""


def use_style() -> None:
    """Sets matplotlib's defaults; ``matplotlib.rc_context()`` restores them."""
    sns.set_theme(style="whitegrid", context="paper", font_scale=1.1)


def clipped(distance: pd.Series) -> pd.Series:
    """Distances cut to the range of an axis; a target behind the source is infinitely far off."""
    return distance.clip(*SHOWN_MM)


def palette(count: int) -> list[str]:
    """``count`` colours; after the last the first comes again."""
    return [PALETTE[number % len(PALETTE)] for number in range(count)]


def legend_above(figure: Figure, columns: int) -> None:
    """One legend of all panels' labels, in natural order and full colours."""
    handles = {handle.get_label(): handle for axes in figure.axes for handle in axes.get_legend_handles_labels()[0]}
    labels = sorted(handles, key=natural)
    place = {"loc": "outside upper center", "ncols": columns, "frameon": False, "markerscale": 1.5}
    legend = figure.legend([handles[label] for label in labels], labels, **place)
    for handle in legend.legend_handles:
        handle.set_alpha(1)


def plain_logarithmic(axes: Axes, which: str = "y") -> None:
    """A logarithmic axis with ticks written out, 0.01 instead of 10 to the -2; to be called after drawing."""
    axis = axes.yaxis if which == "y" else axes.xaxis
    axes.set(**{f"{which}scale": "log"})
    low, high = axis.get_view_interval()
    if high < _NARROWEST * low:
        beyond = (_NARROWEST * low / high) ** 0.5
        low, high = low / beyond, high * beyond
        axes.set(**{f"{which}lim": (low, high)})
    subs = next((subs for subs, span in _TICKS.items() if high < span * low), (1,))
    axis.set_major_locator(LogLocator(subs=subs, numticks=12))
    axis.set_major_formatter(FuncFormatter(_written_out))
    axis.set_minor_formatter(NullFormatter())


def _written_out(value: float, _: int) -> str:
    return f"{value:,.0f}" if value >= 1 else f"{value:.9f}".rstrip("0")
