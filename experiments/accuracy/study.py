"""Registrations of the accuracy study: one row for each arm, view and seed."""

from pathlib import Path
from typing import Any

import torch
from hydra.utils import instantiate
from omegaconf import DictConfig

from experiments.common.columns import REGISTRATION, nine_parameters, registration_row
from experiments.common.loop import Plan, Tell, register_missing, silent, telling
from regtorch.formats import read_volume
from regtorch.geometry import Detector
from regtorch.imaging import Radiograph
from regtorch.registration import initial_parameters, register
from regtorch.simulation import draw_parameters, simulate

KEY = ("ct", "view", "dof", "radiograph_threshold_hu", "seed")
COLUMNS = (*KEY, *REGISTRATION)
UNSHARED = ("views", "arms", "seeds", "first_seed", "threads", "out")
"""Settings in which rows of one folder may differ."""

Case = tuple[str, str, int, float | None, int]


def run(config: DictConfig) -> None:
    """Registers what is missing."""
    register_missing(Plan(config, Path(config.out), KEY, COLUMNS, cases_of(config), UNSHARED), Study)


def cases_of(config: DictConfig) -> list[Case]:
    return [
        (Path(config.ct).name, view, arm.dof, arm.radiograph_threshold_hu, seed)
        for arm in config.arms
        for seed in range(config.first_seed, config.first_seed + config.seeds)
        for view in config.views
    ]


class Study:
    """The CT, read once, and its registrations."""

    def __init__(self, config: DictConfig) -> None:
        self.config = config
        self.ct = read_volume(config.ct)
        self.detector = Detector(**config.detector)

    def row(self, case: Case, tell: Tell = silent) -> dict[str, Any]:
        """Registers one case."""
        _, view, dof, threshold_hu, seed = case
        initial = initial_parameters(self.ct, self.detector, view)
        if self.config.z_obj_mm is not None:
            initial[5] = self.config.z_obj_mm
        generator = torch.Generator().manual_seed(seed)
        true = draw_parameters(initial, nine_parameters(self.config.range), generator)
        truth = simulate(self.ct, true, view, detector=self.detector, threshold_hu=threshold_hu, seed=seed)
        result = register(
            self.ct,
            Radiograph.from_image(truth.image, self.detector),
            view,
            method=instantiate(self.config.registration),
            free=dof,
            initial=initial,
            half_range=nine_parameters(self.config.search),
            seed=seed,
            progress=telling(tell),
        )
        return registration_row(result, truth, self.ct, self.config.threads)
