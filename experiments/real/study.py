"""Registrations of the study of real pairs: one row for each pair, arm and start."""

from pathlib import Path
from typing import Any

import torch
from hydra.utils import instantiate
from jaxtyping import Bool, Float
from omegaconf import DictConfig
from torch import Tensor

from experiments.common.columns import REGISTRATION, nine_parameters, registration_row
from experiments.common.data import read_targets
from experiments.common.loop import Plan, Tell, register_missing, silent, telling
from experiments.common.table import parse_shard
from experiments.real.pairs import Pair, read_matrix, read_pairs
from regtorch.errors import RegtorchError
from regtorch.evaluation import projection_distances
from regtorch.formats import read_radiograph, read_volume
from regtorch.geometry import KEYS, free_indices, parameters_to_dict, pixel_from_patient, project
from regtorch.imaging import Radiograph, Volume
from regtorch.registration import Registration, initial_parameters, register
from regtorch.simulation.simulator import bone_points

KEY = ("pair", "arm", "seed")
COLUMNS = (
    *KEY, "ct", "view", "dof", "told", "half", "mirrored", *REGISTRATION,
    *(f"expected_{key}" for key in KEYS), "expected_targets_mm", "told_sdd_mm", "answer_mm", "targets_mm",
)  # fmt: skip
UNSHARED = ("pairs", "only", "starts", "first_start", "shard", "threads", "device", "out")
"""Settings in which rows of one folder may differ."""

PARTS = ("arms",)
"""Settings that may get further entries."""

FACTS = ("sdd", "side")
"""Facts that an arm may be told."""

Case = tuple[str, str, int]


def run(config: DictConfig) -> None:
    """Registers what is missing of the shard."""
    plan = Plan(config, Path(config.out), KEY, COLUMNS, cases_of(config), UNSHARED, PARTS)
    register_missing(plan, Study)


def cases_of(config: DictConfig) -> list[Case]:
    """The cases of this process: a shard takes every n-th start, with all pairs and arms.

    Raises ``RegtorchError`` for an arm, fact or shard that does not exist.
    """
    arms = [*config.arms] if config.only is None else [*config.only]
    if unknown := [arm for arm in arms if arm not in config.arms]:
        raise RegtorchError(f"only=[{unknown[0]}]: expected of {'; '.join(config.arms)}")
    if wrong := [fact for arm in config.arms.values() for fact in arm.told if fact not in FACTS]:
        raise RegtorchError(f"an arm is told {wrong[0]!r}: expected of {', '.join(FACTS)}")
    number, count = parse_shard(config.shard)
    seeds = range(config.first_start, config.first_start + config.starts)
    own = [seed for seed in seeds if seed % count == number]
    return [(pair, arm, seed) for seed in own for pair in read_pairs(config.pairs) for arm in arms]


class Study:
    """The pairs, whose CTs are read once, and their registrations."""

    def __init__(self, config: DictConfig) -> None:
        self.config = config
        self.pairs = read_pairs(config.pairs)
        self.cts = {name: read_volume(pair.ct) for name, pair in self.pairs.items()}
        self.targets = {name: _targets(pair, self.cts[name]) for name, pair in self.pairs.items()}

    def row(self, case: Case, tell: Tell = silent) -> dict[str, Any]:
        """Registers one case."""
        name, arm, _ = case
        pair, settings = self.pairs[name], self.config.arms[arm]
        result = self.registration(case, tell)
        points = torch.tensor(list(self.targets[name].values()), dtype=torch.float64)
        row = registration_row(result, None, self.cts[name], self.config.threads)
        row |= {"ct": pair.ct.name, "view": pair.view, "dof": settings.dof, "told": " ".join(settings.told)}
        row |= {"half": settings.half, "mirrored": result.mirrored, "told_sdd_mm": pair.sdd_mm}
        for kind, nine in (("initial", result.initial), ("found", result.parameters)):
            row |= {f"{kind}_{key}": value for key, value in parameters_to_dict(nine).items()}
        return row | _expected(result, points) | _distances(result, pair, points)

    def registration(self, case: Case, tell: Tell = silent) -> Registration:
        """The registration of a case, from its start; the same case gives the same result."""
        name, arm, seed = case
        radiograph = self.radiograph(case)
        return register(
            self.cts[name].to(self.config.device),
            radiograph,
            self.pairs[name].view,
            method=instantiate(self.config.registration, _convert_="all"),
            free=self.config.arms[arm].dof,
            initial=self.start(case, radiograph),
            threshold_hu=self.config.threshold_hu,
            seed=seed,
            progress=telling(tell),
        )

    def radiograph(self, case: Case) -> Radiograph:
        """The radiograph as the arm is told of it; a half of it has the weight of its blocks."""
        name, arm, seed = case
        pair, settings = self.pairs[name], self.config.arms[arm]
        told = {"view": pair.view, "pixel_mm": pair.pixel_mm, "intensity": pair.intensity}
        told["mirrored"] = pair.mirrored if "side" in settings.told else None
        radiograph = read_radiograph(pair.radiograph, **told)
        if settings.half is None:
            return radiograph
        first = _half(radiograph, self.config.blocks, seed)
        return read_radiograph(pair.radiograph, **told, mask=first if settings.half == "first" else ~first)

    def start(self, case: Case, radiograph: Radiograph) -> Float[Tensor, "9"]:
        """What view and protocol tell, with random errors. Those of free parameters depend on the seed alone."""
        name, arm, seed = case
        pair, settings = self.pairs[name], self.config.arms[arm]
        sdd_mm = (pair.sdd_mm or radiograph.sdd_mm) if "sdd" in settings.told else None
        middle = initial_parameters(self.cts[name], radiograph.detector, pair.view, sdd_mm=sdd_mm)
        drawn = torch.randn(9, generator=torch.Generator().manual_seed(seed), dtype=torch.float64).clamp(-3, 3)
        free = torch.zeros(9, dtype=torch.float64)
        free[free_indices(settings.dof)] = 1
        return middle + free * drawn / 3 * nine_parameters(self.config.start)


def _targets(pair: Pair, ct: Volume) -> dict[str, tuple[float, float, float]]:
    return bone_points(ct) if pair.targets is None else read_targets(pair.targets, ct)


def _half(radiograph: Radiograph, blocks: int, seed: int) -> Bool[Tensor, "rows columns"]:
    """A random half of the image's blocks, of which ``blocks`` lie along its longer side; oriented as in the file."""
    columns, rows = radiograph.stored_size
    side = -(-max(rows, columns) // blocks)
    down, across = -(-rows // side), -(-columns // side)
    order = torch.randperm(down * across, generator=torch.Generator().manual_seed(seed))
    chosen = (order < down * across // 2).view(down, across)
    return chosen.repeat_interleave(side, 0)[:rows].repeat_interleave(side, 1)[:, :columns]


def _expected(result: Registration, points: Float[Tensor, "n 3"]) -> dict[str, float]:
    """Standard deviations of the parameters, and the root mean square error expected at the targets."""
    if result.covariance is None:
        return {}
    deviations = parameters_to_dict(result.covariance.diagonal().sqrt())
    row = {f"expected_{key}": value for key, value in deviations.items()}
    return row | {"expected_targets_mm": float(result.expected_errors_mm(points).square().mean().sqrt())}


def _distances(result: Registration, pair: Pair, points: Float[Tensor, "n 3"]) -> dict[str, Any]:
    """Where the file's image shows the targets (mm), and how far that is from the truth and from another answer."""
    pixel_mm = result.detector.pixel_mm
    seen = (project(result.pixel_from_patient, points) * pixel_mm).tolist()
    row: dict[str, Any] = {"targets_mm": ";".join(f"{x:.4f} {y:.4f}" for x, y in seen)}
    start = result.stored_from_pixel @ pixel_from_patient(
        result.initial, result.detector, result.view, result.origin_patient_mm
    )
    compared = {
        "answer_mm": (pair.answer, result.pixel_from_patient),
        "pde_mm": (pair.truth, result.pixel_from_patient),
    }
    for column, (file, matrix) in (compared | {"initial_pde_mm": (pair.truth, start)}).items():
        if file is not None:
            row[column] = float(projection_distances(matrix, read_matrix(file), points, pixel_mm).mean())
    return row
