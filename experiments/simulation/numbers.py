"""The numbers of the simulation study beside the paper's, as Markdown."""

import pandas as pd

from experiments.common import markdown
from experiments.common.coupling import slopes
from experiments.common.registrations import PARAMETERS, groups_of
from experiments.common.statistics import median_interval
from experiments.common.summary import distance, headline

ARMS = ("9-DOF", "6-DOF")

_PAPER = {
    "9-DOF": {
        "n": "2000", "PDE before": "~120", "PDE": "0.007", "PDE, LAT": "0.006", "PDE, PA": "0.009",
        "worst PDE": "1.105", "over 1 mm": "1 of 2000", "over 10 mm": "0 of 2000",
        "mean seconds": "48.5", "mean evaluations": "687,701",
    },
    "6-DOF": {
        "n": "2000", "PDE before": "~120", "PDE": "0.767", "PDE, LAT": "0.566", "PDE, PA": "1.044",
        "over 1 mm": "725 of 2000", "over 10 mm": "1 of 2000", "mean seconds": "18.2", "mean evaluations": "233,851",
    },
}  # fmt: skip
"""Section 3.1."""


def table(rows: pd.DataFrame) -> str:
    """Four tables: beside the paper; by arm and view; errors of the parameters; how those of 6-DOF go together."""
    note = "Millimetres and degrees; PDE in the detector plane, the mean over the targets that the image shows, which\n"
    note += "is our declared choice. Medians, where nothing else is said; in brackets\n"
    note += "their 95 % interval by bootstrap. Paper: Otake et al., 2015, section 3.1; its seconds on a GTX TITAN.\n"
    tables = {
        "Beside the paper": _beside_the_paper(rows),
        "By arm and view": markdown.table(*headline(rows, ["arm", "view"])),
        "Errors of the parameters": _errors(rows),
        "Errors of the patient by those of the source, 6-DOF": _slopes(rows[rows.dof == 6]),
    }
    return "\n".join([*(f"## {title}\n\n{table}" for title, table in tables.items() if table), note])


def _beside_the_paper(rows: pd.DataFrame) -> str:
    arms = [arm for arm in ARMS if (rows.arm == arm).any()]
    views = sorted(rows["view"].unique())
    found = {arm: _found(rows[rows.arm == arm], views) for arm in arms}
    header = [""]
    for arm in arms:
        header += [arm, f"{arm}, paper"]
    lines = []
    for name in found[arms[0]]:
        lines.append([name])
        for arm in arms:
            lines[-1] += [found[arm][name], _PAPER[arm].get(name, "not told")]
    return markdown.table(header, lines)


def _found(rows: pd.DataFrame, views: list[str]) -> dict[str, str]:
    """Results of the study by their names; empty for a view without rows."""
    pde = rows.pde_mm
    low, high = pde.quantile([0.25, 0.75], interpolation="higher")
    found = {"n": f"{len(rows)}", "PDE before": distance(rows.initial_pde_mm.median()), "PDE": _median(pde)}
    found |= {f"PDE, {view}": _median(pde[rows["view"] == view]) for view in views}
    found |= {"quartiles of PDE": f"{distance(low)} to {distance(high)}", "worst PDE": distance(pde.max())}
    found |= {f"over {limit} mm": f"{(pde > limit).sum()} of {len(pde)}" for limit in (1, 10)}
    return found | {
        "mean seconds": distance(rows.seconds.mean()),
        "mean evaluations": f"{rows.evaluations.mean():,.0f}",
    }


def _errors(rows: pd.DataFrame) -> str:
    """Medians of absolute errors."""
    names = [*(f"error_{key}" for key in PARAMETERS), "target_error_mm"]
    header = ["arm", "view", *(key.rpartition("_")[0] for key in PARAMETERS), "3D"]
    lines = [
        [*group, *(distance(some[name].abs().median()) for name in names)]
        for group, some in groups_of(rows, ["arm", "view"])
    ]
    return markdown.table(header, lines)


def _slopes(rows: pd.DataFrame) -> str:
    lines = []
    for (view,), some in groups_of(rows, ["view"]):
        found = [slopes(some, axis) for axis in "xyz"]
        lines.append([view, f"{found[0][0]:.3f}", *(f"{slope:.3f}" for _, slope in found)])
    return markdown.table(["view", "ODD:SDD", "x", "y", "z"], lines)


def _median(values: pd.Series) -> str:
    if values.empty:
        return ""
    low, high = median_interval(values)
    return f"{distance(values.median())} [{distance(low)}, {distance(high)}]"
