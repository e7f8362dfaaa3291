"""Registrations of the search study: one row for each CT, view, kind of radiograph and seed."""

import sys
from itertools import product
from pathlib import Path
from typing import Any

import torch
from hydra.utils import instantiate
from jaxtyping import Float
from omegaconf import DictConfig
from torch import Tensor

from experiments.common.columns import REGISTRATION, nine_parameters, registration_row
from experiments.common.data import read_targets
from experiments.common.loop import Plan, Tell, register_missing, silent, telling
from experiments.common.pictures import went_wrong, write_picture
from experiments.common.registrations import DECOY
from experiments.common.table import parse_shard
from regtorch.errors import RegtorchError
from regtorch.formats import read_volume
from regtorch.geometry import Detector
from regtorch.imaging import Radiograph, Volume
from regtorch.registration import COORDINATES, initial_parameters, register
from regtorch.simulation import Simulation, draw_parameters

KEY = ("ct", "view", "kind", "seed")
COLUMNS = (*KEY, *REGISTRATION)
UNSHARED = ("cts", "views", "kinds", "decoys", "seeds", "first_seed", "shard", "pictures", "threads", "device", "out")
"""Settings in which rows of one folder may differ."""

PARTS = ("radiographs", "images")
"""Settings that may get further entries."""

Case = tuple[str, str, str, int]


def run(config: DictConfig) -> None:
    """Registers what is missing of the shard."""
    plan = Plan(config, Path(config.out), KEY, COLUMNS, cases_of(config), UNSHARED, PARTS)
    register_missing(plan, Study)


def cases_of(config: DictConfig) -> list[Case]:
    """The cases of this process: a shard takes an equal part of every kind.

    Raises ``RegtorchError`` for a kind, decoy or shard that does not exist, and for a name given twice.
    """
    for chosen, known in (("kinds", "radiographs"), ("decoys", "images")):
        if unknown := sorted({*config[chosen]} - {*config[known]}):
            raise RegtorchError(f"{chosen}=[{unknown[0]}]: expected of {', '.join(config[known])}")
    kinds = [*config.kinds, *(DECOY + name for name in config.decoys)]
    of_seed = list(product([Path(ct).name for ct in config.cts], config.views, kinds))
    if len(set(of_seed)) < len(of_seed):
        raise RegtorchError("CTs, views or kinds of the same name: expected each once")
    seeds = range(config.first_seed, config.first_seed + config.seeds)
    number, count = parse_shard(config.shard)
    turns = [(place, case, seed) for seed in seeds for place, case in enumerate(of_seed, seed)]
    return [(*case, seed) for place, case, seed in turns if place % count == number]


class Study:
    """The CTs, read once, and their registrations."""

    def __init__(self, config: DictConfig) -> None:
        self.config = config
        self.detector = Detector(**config.detector)
        files = _target_files(config)
        self.cts = {Path(path).name: read_volume(path) for path in config.cts}
        self.targets = {name: read_targets(file, self.cts[name]) for name, file in files.items()}
        self.given = {name: _middle(ct, config.given).to(config.device) for name, ct in self.cts.items()}

    def row(self, case: Case, tell: Tell = silent) -> dict[str, Any]:
        """Registers one case, and leaves a picture where the registration or its verdict went wrong."""
        ct, view, kind, seed = case
        decoy = kind.startswith(DECOY)
        truth = self.radiograph(ct, view, self.config.decoy_of if decoy else kind, seed)
        image = self.decoy(kind.removeprefix(DECOY), truth, case) if decoy else truth.image
        radiograph = Radiograph.from_image(image, self.detector)
        result = register(
            self.given[ct],
            radiograph,
            view,
            method=instantiate(self.config.registration, _convert_="all"),
            free=self.config.dof,
            coordinates=COORDINATES[self.config.coordinates],
            initial=self.drawn(ct, view, seed)[1],
            half_range=self.config.searched_deviations * nine_parameters(self.config.start),
            threshold_hu=self.config.threshold_hu,
            seed=seed,
            progress=telling(tell),
        )
        row = registration_row(result, None if decoy else truth, self.cts[ct], self.config.threads)
        pictures = Path(self.config.out) / "failures"
        if not decoy and went_wrong(row) and len(list(pictures.glob("*.png"))) < self.config.pictures:
            path = pictures / f"{ct.partition('.')[0]}_{view}_{kind}_{seed}.png"
            write_picture(path, self.cts[ct], radiograph, view, result.parameters, truth.parameters)
        return row

    def drawn(self, ct: str, view: str, seed: int) -> tuple[Float[Tensor, "9"], Float[Tensor, "9"]]:
        """True and initial parameters (mm, rad); their difference depends on the seed alone."""
        generator = torch.Generator().manual_seed(seed)
        drawn = torch.randn(9, generator=generator, dtype=torch.float64).clamp(-3, 3)
        errors = drawn * nine_parameters(self.config.start)
        middle = initial_parameters(self.cts[ct], self.detector, view)
        middle[5] += self.config.towards_source_mm
        true = draw_parameters(middle, nine_parameters(self.config.range), generator)
        return true, true - errors

    def radiograph(self, ct: str, view: str, kind: str, seed: int) -> Simulation:
        make = instantiate(self.config.radiographs[kind])
        place = self.cts[ct], self.drawn(ct, view, seed)[0], view
        return make(*place, detector=self.detector, targets=self.targets.get(ct), seed=seed)

    def decoy(self, name: str, right: Simulation, case: Case) -> Float[Tensor, "h w"]:
        ct, view, _, seed = case

        def other() -> Float[Tensor, "h w"]:
            names = list(self.cts)
            if len(names) < 2:
                raise RegtorchError(f"decoy of another patient than {ct}: expected a second CT in cts=")
            following = names[(names.index(ct) + 1) % len(names)]
            return self.radiograph(following, view, self.config.decoy_of, seed).image

        return instantiate(self.config.images[name])(right.image, other, torch.Generator().manual_seed(seed))


def _middle(ct: Volume, share: float) -> Volume:
    """The middle slices of a CT, a share of all; the origin of the parameters stays."""
    axis = ct.along_body
    slices = ct.data.shape[2 - axis]
    first = round(slices * (1 - share) / 2)
    if not 0 < slices - 2 * first <= slices:
        raise RegtorchError(f"given={share}: expected a share of the CT's {slices} slices, at most 1")
    patient_from_voxel = ct.patient_from_voxel.clone()
    patient_from_voxel[:, 3] += first * patient_from_voxel[:, axis]
    return ct.on_grid(ct.data.narrow(2 - axis, first, slices - 2 * first), patient_from_voxel)


def _target_files(config: DictConfig) -> dict[str, Path]:
    """The file of points of each CT that has one; a line on stderr tells which have none."""
    if config.targets is None:
        return {}
    folder = Path(config.targets)
    if not folder.is_dir():
        raise RegtorchError(f"targets={folder}: no such folder, expected one with NAME.csv for a CT NAME, or null")
    names = [Path(path).name for path in config.cts]
    files = {name: folder / f"{name.partition('.')[0]}.csv" for name in names}
    for name, file in files.items():
        if not file.exists():
            print(f"{name}: no {file}, so the targets are points spread over its bones", file=sys.stderr)
    return {name: file for name, file in files.items() if file.exists()}
