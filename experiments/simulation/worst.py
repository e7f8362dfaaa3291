"""Pictures of the worst registrations of a simulation study, made again from its rows."""

from pathlib import Path

import pandas as pd
from jaxtyping import Float
from omegaconf import OmegaConf
from torch import Tensor

from experiments.common.pictures import write_picture
from experiments.common.registrations import groups_of, read_rows
from experiments.common.settings import SETTINGS
from experiments.common.summary import worst
from experiments.simulation.study import Study
from regtorch.errors import RegtorchError
from regtorch.geometry import KEYS, parameters_from_dict


def write_pictures(folder: Path, count: int) -> list[Path]:
    """Writes ARM/failures/VIEW_SEED.png for the ``count`` worst of each arm, and returns the paths.

    Raises ``RegtorchError`` where rows or an arm's settings are missing.
    """
    rows = read_rows(folder)
    columns = ["arm", "view", "seed", *(f"{name}_{key}" for name in ("true", "found") for key in KEYS)]
    if missing := [column for column in columns if column not in rows]:
        raise RegtorchError(f"{folder}: no column {missing[0]!r}, expected rows of the simulation study")
    written = []
    for (arm,), some in groups_of(rows, ["arm"]):
        settings = folder / arm / SETTINGS
        if not settings.is_file():
            raise RegtorchError(f"{settings}: no such file, expected the settings of the arm")
        study = Study(OmegaConf.load(settings))
        for _, row in worst(some, count).iterrows():
            true, found = (_parameters(row, name) for name in ("true", "found"))
            _, radiograph = study.taken(true, row["view"], int(row["seed"]))
            path = folder / arm / "failures" / f"{row['view']}_{row['seed']:.0f}.png"
            write_picture(path, study.ct, radiograph, row["view"], found, true)
            written.append(path)
    return written


def _parameters(row: pd.Series, name: str) -> Float[Tensor, "9"]:
    return parameters_from_dict({key: row[f"{name}_{key}"] for key in KEYS})
