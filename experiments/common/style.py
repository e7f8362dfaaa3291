"""How figures look: colours that colour-blind readers tell apart, letters legible in print and in a README."""

import pandas as pd
import seaborn as sns
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from experiments.common.registrations import natural

PALETTE = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#000000")
"""Okabe and Ito's, without the yellow that white paper swallows."""

YELLOW = "#f0e442"
"""Theirs, for dark pictures."""

SHOWN_MM = (1e-4, 1e3)
"""What a logarithmic axis of distances shows."""

DPI = 150

_NARROWEST = 6
"""Times its beginning that a logarithmic axis spans at least: less may hold but one of 1, 2 and 5."""

_TICKS = {(1, 2, 5): 10, (1, 3): 100}
"""Times a power of ten, on axes that span less than so many times their beginning."""


def use_style() -> None:
    """Sets matplotlib's defaults; within ``matplotlib.rc_context()`` for as long as that lasts."""
    sns.set_theme(style="whitegrid", context="paper", font_scale=1.1)


def clipped(distance: pd.Series) -> pd.Series:
    """What a logarithmic axis can show; a target behind the source is infinitely far off."""
    return distance.clip(*SHOWN_MM)


def palette(count: int) -> list[str]:
    """As many colours, again from the first where there are more than colours."""
    return [PALETTE[number % len(PALETTE)] for number in range(count)]


def legend_above(figure: Figure, columns: int) -> None:
    """What the panels' labels say, in natural order and full colours."""
    handles = {handle.get_label(): handle for axes in figure.axes for handle in axes.get_legend_handles_labels()[0]}
    labels = sorted(handles, key=natural)
    place = {"loc": "outside upper center", "ncols": columns, "frameon": False, "markerscale": 1.5}
    legend = figure.legend([handles[label] for label in labels], labels, **place)
    for handle in legend.legend_handles:
        handle.set_alpha(1)


def plain_logarithmic(axes: Axes, which: str = "y") -> None:
    """Ticks written out, 0.01 instead of 10 to the -2; to be called when all is drawn, for what it spans."""
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
