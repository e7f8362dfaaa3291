"""Pictures of a simulation study's worst registrations, from its rows: python -m experiments.worst_pictures FOLDER

Each arm's radiograph of what its settings and the true parameters tell, with the edges of the bones in blue where they
are, in orange where they were found: ARM/failures/VIEW_SEED.png, which ``regtorch report`` shows.
"""

import argparse
from pathlib import Path

import pandas as pd
from jaxtyping import Float
from omegaconf import OmegaConf
from torch import Tensor

from experiments.command import told_in_one_line
from experiments.pictures import write_picture
from experiments.simulation_study import Study
from experiments.table import SETTINGS
from regtorch.errors import RegtorchError
from regtorch.geometry import KEYS, parameters_from_dict
from regtorch.report.rows import groups_of, read_rows
from regtorch.report.summary import worst


def main(folder: Path, count: int) -> None:
    """The ``count`` worst of each arm. Raises ``RegtorchError`` where rows or an arm's settings are missing."""
    rows = read_rows(folder)
    columns = ["arm", "view", "seed", *(f"{name}_{key}" for name in ("true", "found") for key in KEYS)]
    if missing := [column for column in columns if column not in rows]:
        raise RegtorchError(f"{folder}: no column {missing[0]!r}, expected rows of the simulation study")
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


def _parameters(row: pd.Series, name: str) -> Float[Tensor, "9"]:
    return parameters_from_dict({key: row[f"{name}_{key}"] for key in KEYS})


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, nargs="?", default=Path("results/simulation"))
    parser.add_argument("--count", type=int, default=10, help="of each arm, default 10")
    options = parser.parse_args()
    with told_in_one_line("worst_pictures"):
        main(options.folder, options.count)
