"""The paper's figure 2: where the searches begin, as squares about the vertebra L3 on the detector."""

from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.collections import PolyCollection
from matplotlib.patches import Circle, Rectangle

from experiments.common.settings import read_settings
from experiments.common.style import PALETTE, YELLOW
from regtorch.errors import RegtorchError

_VIEWS = ("PA", "LAT")  # in the paper's order
_CORNERS = [f"corner{number}_{axis}_mm" for number in (1, 2, 3, 4) for axis in "xy"]
_MARKER = ["marker_x_mm", "marker_y_mm"]
_PANEL_INCHES, _MARGIN = 3.2, 0.03


def starts_of(rows: pd.DataFrame, folder: Path) -> pd.DataFrame:
    """One row for each view and seed with a marker; no row for a CT without it.

    Raises ``RegtorchError`` where ``rows``, the table of ``folder``, have no columns of markers.
    """
    places = [*_MARKER, *_CORNERS]
    if missing := [column for column in places if column not in rows]:
        raise RegtorchError(f"{folder}: no column {missing[0]!r} in its table, expected it for figure 2")
    return rows.dropna(subset=places).drop_duplicates(["view", "seed"])


def start_figure(rows: pd.DataFrame, folder: Path) -> mpl.figure.Figure:
    """A panel for each view, in mm on the detector; L3 is drawn where it truly is in the median.

    The detector's border is drawn if ``folder`` has the study's settings, with ``background_VIEW.png`` if it is there.
    Raises ``RegtorchError`` where no row has a marker.
    """
    starts = starts_of(rows, folder)
    if starts.empty:
        raise RegtorchError(f"{folder}: no row with {_MARKER[0]!r}, expected a CT that has the study's marker")
    half = _half_detector_mm(folder)
    lowest, highest = (np.zeros(2), np.zeros(2)) if half is None else (-half, half)
    drawn = []
    for view in _VIEWS:
        some = starts[starts["view"] == view]
        middle = some[_MARKER].median().to_numpy()
        squares = some[_CORNERS].to_numpy().reshape(-1, 4, 2) + middle
        lowest = np.minimum(lowest, squares.min((0, 1), initial=0))
        highest = np.maximum(highest, squares.max((0, 1), initial=0))
        drawn.append((view, middle, squares))
    margin = _MARGIN * (highest - lowest)
    (left, bottom), (right, top) = lowest - margin, highest + margin
    size = 2 * _PANEL_INCHES + 1, _PANEL_INCHES * (top - bottom) / (right - left) + 1
    figure, panels = plt.subplots(1, 2, figsize=size, sharex=True, sharey=True, layout="constrained")
    for axes, (view, middle, squares) in zip(panels, drawn, strict=True):
        background = folder / f"background_{view}.png"
        alpha = min(1, 10 / np.sqrt(len(squares) + 1))
        colour = PALETTE[0]
        if half is not None:
            frame = {"fill": False, "edgecolor": "black", "linewidth": 2}
            axes.add_patch(Rectangle(-half, *(2 * half), **frame))
            if background.is_file():
                extent = [-half[0], half[0], -half[1], half[1]]
                axes.imshow(plt.imread(background), cmap="gray", extent=extent, zorder=0.6)  # over the grid
                colour = PALETTE[1]
        lines = {"facecolors": "none", "edgecolors": colour, "linewidths": 0.5, "alpha": alpha}
        axes.add_collection(PolyCollection(squares, **lines))
        axes.add_patch(Circle(middle, 9, facecolor=YELLOW, edgecolor="black", linewidth=1.2, zorder=3))
        axes.set(title=f"{view}, n = {len(squares)}", aspect="equal", xlabel="x on the detector (mm)")
    panels[0].set(ylabel="y on the detector (mm)", xlim=(left, right), ylim=(bottom, top))
    return figure


def _half_detector_mm(folder: Path) -> np.ndarray | None:
    """Half the detector's width and height, the same for all arms."""
    for settings in read_settings(folder).values():
        if "detector.pixel_mm" in settings:
            sides = [float(settings[f"detector.{side}"]) for side in ("columns", "rows")]
            return np.array(sides) * float(settings["detector.pixel_mm"]) / 2
    return None
