"""The paper's simulation study (section 2.3.1): random geometries registered from one default; a row for each.

    python -m experiments.simulation_study [data=ct data.path=FILE] [seeds=1000] [views=[PA]] [dof=6] [shard=0/8]
    python -m experiments.simulation_study -m dof=9,6 shard=0/2,1/2 hydra/launcher=joblib
    python -m experiments.simulation_study study=threshold

A process does one arm, or a shard of it. Rows are appended to OUT/ARM/registrations[-i].csv as they come; a second
start does those that are missing in all tables of the arm. ``experiments.merge`` gathers the arms. Columns, besides
parameters and errors:

- redrawn: how many geometries were drawn before this one that put bone behind the detector or too little into the image
- targets: how many of the targets the image shows, over which PDE is the mean
- expected_pde_mm: the PDE that the registration expects of itself at the targets, where it tells any
- within_region: whether the PDE is at most the 95 % bound that it tells, where it tells any
- marker_*, corner*: see ``experiments.geometries.misplacement``; empty where the CT has no such target
"""

from pathlib import Path
from typing import Any

import hydra
import torch
from omegaconf import DictConfig, OmegaConf
from tqdm import tqdm

from experiments.checks import CASES, component
from experiments.command import told_in_one_line, use_threads
from experiments.data import read
from experiments.geometries import Geometries, bone_voxels, centred, misplacement
from experiments.merge import KEY
from experiments.pictures import write_default
from experiments.rows import accuracy_of, cost_of, nine_parameters, verdict_of
from experiments.table import append, done, keep, locked, parse_shard, refuse_to_mix, table_name
from regtorch.geometry import KEYS, Detector
from regtorch.imaging import Radiograph
from regtorch.registration import register
from regtorch.simulation import Simulation

COLUMNS = (
    *KEY, "dof", "redrawn", *(f"{name}_{key}" for name in ("true", "initial", "found", "error") for key in KEYS),
    "initial_pde_mm", "pde_mm", "target_error_mm", "expected_pde_mm", "within_region", "targets",
    "similarity", "status", "message", "evaluations", "seconds", "threads", "device", "version",
    "marker_x_mm", "marker_y_mm", *(f"corner{number}_{axis}_mm" for number in (1, 2, 3, 4) for axis in "xy"),
)  # fmt: skip

Case = tuple[str, str, int]


@hydra.main(version_base="1.3", config_path="../conf", config_name="simulation_study")
def main(config: DictConfig) -> None:
    with told_in_one_line("simulation_study"):
        run(config)


def run(config: DictConfig) -> None:
    """Does what is missing of the shard."""
    use_threads(config.threads)
    folder = Path(config.out) / config.arm
    refuse_to_mix(config, folder, CASES)
    study = Study(config) if _missing(config, folder) else None
    table = folder / table_name(config.shard)
    with locked(table):
        missing, count = _missing(config, folder), len(cases(config))
        name = config.arm if config.shard is None else f"{config.arm} {config.shard}"
        bar = tqdm(missing, name, count, initial=count - len(missing), unit="registration", mininterval=1)
        for case in bar:
            row = study.row(case, bar.set_postfix_str)
            keep(config, folder, CASES)
            study.write_defaults()
            append(table, row)


def _missing(config: DictConfig, folder: Path) -> list[Case]:
    made = done(folder, KEY)
    return [case for case in cases(config) if tuple(map(str, case)) not in made]


def cases(config: DictConfig) -> list[Case]:
    """What this process is to do: a shard takes every n-th seed, with all views."""
    number, count = parse_shard(config.shard)
    seeds = range(config.first_seed, config.first_seed + config.seeds)
    return [(config.arm, view, seed) for seed in seeds if seed % count == number for view in config.views]


class Study:
    """The CT, read once, and what is done with it."""

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

    def row(self, case: Case, tell: Any = lambda text, refresh: None) -> dict[str, Any]:
        """Registers one case."""
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
            initial=geometries.default,
            half_range=self.config.searched_deviations * geometries.deviations,
            threshold_hu=self.config.threshold_hu,
            similarity=self.similarity,
            seed=seed,
            progress=lambda share, what: tell(f"{100 * share:.0f} % {what}", refresh=False),
        )
        row = dict.fromkeys(COLUMNS) | dict(zip(KEY, case, strict=True))
        row |= {"dof": self.config.dof, "redrawn": redrawn, "targets": len(truth.targets)}
        row |= accuracy_of(result, truth, self.ct)
        row |= verdict_of(result, truth, row["pde_mm"]) | cost_of(result, self.config.threads)
        if self.config.marker in self.targets:
            marker = self._in_ct(self.targets[self.config.marker])
            row |= misplacement(geometries.default, true, marker, view)
        return row

    def write_defaults(self) -> None:
        for view in self.config.views:
            path = Path(self.config.out) / f"background_{view}.png"
            if not path.exists():
                write_default(path, self.taken(self.geometries(view).default, view, 0)[1])

    def taken(self, parameters: torch.Tensor, view: str, seed: int) -> tuple[Simulation, Radiograph]:
        """The radiograph with these parameters, and what is true of it."""
        truth = self.radiograph(self.ct, parameters, view, detector=self.detector, targets=self.targets, seed=seed)
        return truth, Radiograph.from_image(truth.image, self.detector)

    def _in_ct(self, point_mm: tuple[float, float, float]) -> torch.Tensor:
        return torch.tensor(point_mm, dtype=torch.float64) - self.ct.origin_patient_mm


if __name__ == "__main__":
    main()
