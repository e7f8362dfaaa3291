"""Tables of studies that were never run: the right columns, and numbers like those of real ones."""

import numpy as np
import pandas as pd

from experiments.common.registrations import PARAMETERS

_SPREAD = np.array([50, 50, 100, 50, 100, 50, 5, 5, 5])
_DEFAULT = np.array([0, 0, 1000, 0, 0, 300, 0, 0, 0])


def simulation_rows(seeds: int, arms: dict[str, int], views: tuple[str, ...] = ("PA", "LAT")) -> pd.DataFrame:
    """A merged table; ``arms`` gives degrees of freedom by name. All PDEs differ, also between equal arms."""
    parts = []
    for number, (arm, dof) in enumerate(arms.items()):
        for view in views:
            random = np.random.default_rng(number)
            true = _DEFAULT + _SPREAD * np.random.default_rng(0).normal(size=(seeds, 9)).clip(-3, 3)
            found = true + 1e-3 * _SPREAD * random.normal(size=(seeds, 9)) * random.lognormal(size=(seeds, 1))
            if dof == 6:
                found[:, :3] = _DEFAULT[:3]
                found[:, 3:6] += 0.3 * (found - true)[:, :3] * random.normal(1, 0.05, (seeds, 3))
            pde = random.lognormal(np.log(0.007 if dof == 9 else 0.7), 0.7, seeds)
            part = pd.DataFrame({"arm": arm, "view": view, "seed": range(seeds), "dof": dof, "redrawn": 0})
            sets = {"true": true, "initial": np.tile(_DEFAULT, (seeds, 1)), "found": found, "error": found - true}
            for name, values in sets.items():
                part[[f"{name}_{key}" for key in PARAMETERS]] = values
            part["initial_pde_mm"] = 1.4 * np.hypot(*(true - _DEFAULT)[:, 3:5].T) + 1
            part["pde_mm"], part["target_error_mm"], part["expected_pde_mm"] = pde, 3 * pde, pde
            part["within_region"], part["targets"], part["similarity"] = True, 9, 0.99
            part["status"] = np.where(pde > 5, "doubtful", "ok")
            part["message"], part["evaluations"], part["seconds"] = "5 of 12 starts agree, the next is worse", 2400, 5.5
            part["threads"], part["device"], part["version"] = 1, "cpu", "0.1.0"
            part[["torch", "numba", "numpy", "processor"]] = "2.6.0", "0.61.0", "2.1.0", "some CPU"
            part[["marker_x_mm", "marker_y_mm"]] = random.normal(0, 30, (seeds, 2))
            offset = -1.4 * (true - _DEFAULT)[:, 3:5]
            for corner, (x, y) in enumerate([(-28, 28), (28, 28), (28, -28), (-28, -28)], 1):
                skew = random.normal(0, 2, (seeds, 2))
                part[[f"corner{corner}_x_mm", f"corner{corner}_y_mm"]] = offset + np.array([x, y]) + skew
            parts.append(part)
    rows = pd.concat(parts, ignore_index=True)
    return rows.astype(dict.fromkeys(rows.select_dtypes("float64"), "float32"))
