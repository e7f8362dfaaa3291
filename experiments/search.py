"""How often the search finds the place from far away, and whether its verdict knows: one row per registration.

    REGTORCH_DATA=... python -m experiments.search [seeds=200] [kinds=[matched]] [shard=0/2] [out=results/search]

Each seed draws a geometry and a rough start; each CT, view and kind of radiograph is registered from there. ``decoys``
adds images that fit nowhere: their rows are of the kind ``decoy_NAME`` and have no errors. Rows are appended as they
come; a second start does those that are missing in all tables of the folder, and the process of another ``shard`` may
work there at the same time. ``failures/`` shows registrations that went wrong, and those whose verdict did.
``experiments.search_figures`` draws. Columns, besides parameters and errors:

- expected_pde_mm: the PDE that the registration expects of itself at the targets, where it tells any
- within_region: whether the PDE is at most the 95 % bound that it tells, where it tells any
"""

from pathlib import Path
from typing import Any

import hydra
import torch
from hydra.utils import instantiate
from jaxtyping import Float
from omegaconf import DictConfig
from torch import Tensor
from tqdm import tqdm

from experiments.command import told_in_one_line, use_threads
from experiments.pictures import went_wrong, write_picture
from experiments.rows import accuracy_of, cost_of, nine_parameters, verdict_of
from experiments.table import append, done, keep, locked, parse_shard, refuse_to_mix, table_name
from regtorch.errors import RegtorchError
from regtorch.formats import read_points, read_volume
from regtorch.geometry import KEYS, Detector
from regtorch.imaging import Radiograph, Volume
from regtorch.registration import initial_parameters, register
from regtorch.simulation import Simulation, draw_parameters

KEY = ("ct", "view", "kind", "seed")
COLUMNS = (
    *KEY, *(f"{name}_{key}" for name in ("true", "initial", "found", "error") for key in KEYS),
    "initial_pde_mm", "pde_mm", "target_error_mm", "expected_pde_mm", "within_region",
    "similarity", "status", "message", "evaluations", "seconds", "threads", "device", "version",
)  # fmt: skip
_DECOY = "decoy_"
_CASES = ("cts", "views", "kinds", "decoys", "seeds", "first_seed", "shard", "pictures", "threads", "device", "out")
_PARTS = ("radiographs", "images")

Case = tuple[str, str, str, int]


@hydra.main(version_base="1.3", config_path="../conf", config_name="search")
def main(config: DictConfig) -> None:
    with told_in_one_line("search"):
        run(config)


def run(config: DictConfig) -> None:
    """Does what is missing of the shard."""
    use_threads(config.threads)
    table, own = table_and_cases(config)
    folder = Path(config.out)
    refuse_to_mix(config, folder, _CASES, parts=_PARTS)
    study = Study(config)
    with locked(folder / table), tqdm(own, unit="registration", mininterval=1) as bar:
        made = done(folder, KEY)
        for case in bar:
            if tuple(map(str, case)) not in made:
                row = study.row(case, bar.set_postfix_str)
                keep(config, folder, _CASES, parts=_PARTS)
                append(folder / table, row)


def table_and_cases(config: DictConfig) -> tuple[str, list[Case]]:
    """The name of this process's table, and what it is to do: a shard takes a like part of every kind."""
    for chosen, known in (("kinds", "radiographs"), ("decoys", "images")):
        if unknown := [name for name in config[chosen] if name not in config[known]]:
            raise RegtorchError(f"{chosen}=[{unknown[0]}]: expected of {', '.join(config[known])}")
    kinds = [*config.kinds, *(_DECOY + name for name in config.decoys)]
    of_seed = [(Path(ct).name, view, kind) for ct in config.cts for view in config.views for kind in kinds]
    if len(set(of_seed)) < len(of_seed):
        raise RegtorchError("CTs, views or kinds of the same name: expected each once")
    seeds = range(config.first_seed, config.first_seed + config.seeds)
    number, count = parse_shard(config.shard)
    turns = [(place, case, seed) for seed in seeds for place, case in enumerate(of_seed, seed)]
    return table_name(config.shard), [(*case, seed) for place, case, seed in turns if place % count == number]


class Study:
    """The CTs, read once, and what is done with them."""

    def __init__(self, config: DictConfig) -> None:
        self.config = config
        self.detector = Detector(**config.detector)
        self.targets = _targets(config)
        self.cts = {Path(path).name: read_volume(path) for path in config.cts}
        self.given = {name: _middle(ct, config.given).to(config.device) for name, ct in self.cts.items()}

    def row(self, case: Case, tell: Any = lambda text, refresh: None) -> dict[str, Any]:
        """Registers one case, and takes a picture of it where that is worth one."""
        ct, view, kind, seed = case
        decoy = kind.startswith(_DECOY)
        truth = self.radiograph(ct, view, self.config.decoy_of if decoy else kind, seed)
        image = self.decoy(kind.removeprefix(_DECOY), truth, case) if decoy else truth.image
        radiograph = Radiograph.from_image(image, self.detector)
        result = register(
            self.given[ct],
            radiograph,
            view,
            method=instantiate(self.config.registration, _convert_="all"),
            free=self.config.dof,
            initial=self.drawn(ct, view, seed)[1],
            half_range=self.config.searched_deviations * nine_parameters(self.config.start),
            threshold_hu=self.config.threshold_hu,
            seed=seed,
            progress=lambda share, what: tell(f"{100 * share:.0f} % {what}", refresh=False),
        )
        row = dict.fromkeys(COLUMNS) | dict(zip(KEY, case, strict=True))
        if not decoy:
            row |= accuracy_of(result, truth, self.cts[ct])
        row |= verdict_of(result, None if decoy else truth, row["pde_mm"]) | cost_of(result, self.config.threads)
        if not decoy:
            pictures = Path(self.config.out) / "failures"
            if went_wrong(row) and len(list(pictures.glob("*.png"))) < self.config.pictures:
                name = "_".join([ct.partition(".")[0], view, kind, str(seed)])
                path = pictures / f"{name}.png"
                write_picture(path, self.cts[ct], radiograph, view, result.parameters, truth.parameters)
        return row

    def drawn(self, ct: str, view: str, seed: int) -> tuple[Float[Tensor, "9"], Float[Tensor, "9"]]:
        """The true parameters and where the search starts (mm, rad), the same offsets for any CT."""
        generator = torch.Generator().manual_seed(seed)
        errors = torch.randn(9, generator=generator, dtype=torch.float64).clamp(-3, 3) * nine_parameters(
            self.config.start
        )
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
    """A share of the slices of a CT; the origin of its parameters stays."""
    axis = ct.along_body
    slices = ct.data.shape[2 - axis]
    first = round(slices * (1 - share) / 2)
    if not 0 < slices - 2 * first <= slices:
        raise RegtorchError(f"given={share}: expected a share of the CT's {slices} slices, at most 1")
    patient_from_voxel = ct.patient_from_voxel.clone()
    patient_from_voxel[:, 3] += first * patient_from_voxel[:, axis]
    return ct.on_grid(ct.data.narrow(2 - axis, first, slices - 2 * first), patient_from_voxel)


def _targets(config: DictConfig) -> dict[str, dict[str, tuple[float, float, float]]]:
    """Named points (LPS mm) of each CT that has a file of them."""
    if config.targets is None:
        return {}
    folder = Path(config.targets)
    if not folder.is_dir():
        raise RegtorchError(f"targets={folder}: no such folder, expected one with NAME.csv for a CT NAME, or null")
    names = [Path(path).name for path in config.cts]
    files = {name: folder / f"{name.partition('.')[0]}.csv" for name in names}
    return {name: read_points(file) for name, file in files.items() if file.exists()}


if __name__ == "__main__":
    main()
