"""Registrations of the simulation study: one row for each arm, view and seed."""

from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig, OmegaConf

from experiments.common.columns import REGISTRATION, nine_parameters, registration_row
from experiments.common.data import read
from experiments.common.loop import Plan, Tell, register_missing, silent, telling
from experiments.common.pictures import write_default
from experiments.common.table import parse_shard
from experiments.simulation.checks import UNSHARED, component
from experiments.simulation.geometries import Geometries, bone_voxels, centred, misplacement
from experiments.simulation.merge import KEY
from regtorch.geometry import Detector
from regtorch.imaging import Radiograph
from regtorch.registration import COORDINATES, register
from regtorch.simulation import Simulation

COLUMNS = (
    *KEY, "dof", "redrawn", "targets", *REGISTRATION,
    "marker_x_mm", "marker_y_mm", *(f"corner{number}_{axis}_mm" for number in (1, 2, 3, 4) for axis in "xy"),
)  # fmt: skip

Case = tuple[str, str, int]


def run(config: DictConfig) -> None:
    """Registers what is missing of the shard."""
    register_missing(Plan(config, Path(config.out, config.arm), KEY, COLUMNS, cases_of(config), UNSHARED), Study)


def cases_of(config: DictConfig) -> list[Case]:
    """The cases of this process: a shard takes every n-th seed, with all views."""
    number, count = parse_shard(config.shard)
    seeds = range(config.first_seed, config.first_seed + config.seeds)
    return [(config.arm, view, seed) for seed in seeds if seed % count == number for view in config.views]


class Study:
    """The CT, read once, and its registrations."""

    def __init__(self, config: DictConfig) -> None:
        self.config = config
        self.detector = Detector(**config.detector)
        self.ct, self.targets = read(OmegaConf.to_yaml(config.data))
        self.searched = self.ct.to(config.get("device", "cpu"))  # an arm's settings do not tell
        self.bone = bone_voxels(self.ct)
        self.radiograph = component(config.radiograph)
        self.method = component(config.registration)
        self.similarity = component(config.similarity)

    def geometries(self, view: str) -> Geometries:
        default = nine_parameters(self.config.default).double()
        if self.config.marker in self.targets:
            default = centred(default, self._in_ct(self.targets[self.config.marker]), view)
        return Geometries(
            default=default,
            deviations=nine_parameters(self.config.deviations).double(),
            detector=self.detector,
            view=view,
            bone=self.bone,
            targets=torch.tensor(list(self.targets.values()), dtype=torch.float64),
            origin_patient_mm=self.ct.origin_patient_mm,
            least_targets=self.config.least_targets,
        )

    def row(self, case: Case, tell: Tell = silent) -> dict[str, Any]:
        """Registers one case, and leaves the background of figure 2 where it is missing."""
        _, view, seed = case
        geometries = self.geometries(view)
        true, redrawn = geometries.draw(seed)
        truth, radiograph = self.taken(true, view, seed)
        result = register(
            self.searched,
            radiograph,
            view,
            method=self.method,
            free=self.config.dof,
            coordinates=COORDINATES[self.config.coordinates],
            initial=geometries.default,
            half_range=self.config.searched_deviations * geometries.deviations,
            threshold_hu=self.config.threshold_hu,
            similarity=self.similarity,
            seed=seed,
            progress=telling(tell),
        )
        row = {"dof": self.config.dof, "redrawn": redrawn, "targets": len(truth.targets)}
        row |= registration_row(result, truth, self.ct, self.config.threads)
        if self.config.marker in self.targets:
            marker = self._in_ct(self.targets[self.config.marker])
            row |= misplacement(geometries.default, true, marker, view)
        self._write_default(view)
        return row

    def taken(self, parameters: torch.Tensor, view: str, seed: int) -> tuple[Simulation, Radiograph]:
        """The radiograph with these parameters, and the truth about it."""
        truth = self.radiograph(self.ct, parameters, view, detector=self.detector, targets=self.targets, seed=seed)
        return truth, Radiograph.from_image(truth.image, self.detector)

    def _write_default(self, view: str) -> None:
        path = Path(self.config.out) / f"background_{view}.png"
        if not path.exists():
            write_default(path, self.taken(self.geometries(view).default, view, 0)[1])

    def _in_ct(self, point_mm: tuple[float, float, float]) -> torch.Tensor:
        return torch.tensor(point_mm, dtype=torch.float64) - self.ct.origin_patient_mm
