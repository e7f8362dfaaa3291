"""Tables of registrations: what every row tells, and rows that are appended one by one to be resumed."""

import csv
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from omegaconf import DictConfig, OmegaConf
from torch import Tensor

from regtorch import __version__
from regtorch.errors import RegtorchError
from regtorch.evaluation import evaluate
from regtorch.geometry import parameters_to_dict, pixel_from_patient
from regtorch.imaging import Volume
from regtorch.registration import Registration
from regtorch.simulation import Simulation

TABLES = "registrations*.csv"
"""Names of the tables in a study's folder: one, or one of each process that works on it."""


def half_range(config: DictConfig) -> Float[Tensor, "9"]:
    """In mm and rad, of ``source_mm``, ``patient_mm`` and ``rotation_deg``."""
    return torch.tensor([*config.source_mm, *config.patient_mm, *[math.radians(config.rotation_deg)] * 3])


def accuracy_of(result: Registration, truth: Simulation, ct: Volume) -> dict[str, float]:
    """Columns: parameters true, initial and found, and errors before and after, in mm and degrees."""
    found = evaluate(result.to_dict(), truth.to_dict())
    matrix = pixel_from_patient(result.initial, result.detector, result.view, ct.origin_patient_mm)
    start = {"parameters": parameters_to_dict(result.initial), "pixel_from_patient": matrix.tolist()}
    sets = {"true": truth.parameters, "initial": result.initial, "found": result.parameters}
    row = {f"{name}_{key}": value for name, nine in sets.items() for key, value in parameters_to_dict(nine).items()}
    row |= {f"error_{key}": value for key, value in found["parameter_errors"].items()}
    return row | {
        "initial_pde_mm": evaluate(result.to_dict() | start, truth.to_dict())["pde_mm"],
        "pde_mm": found["pde_mm"],
        "target_error_mm": found["target_error_mm"],
    }


def cost_of(result: Registration, threads: int) -> dict[str, Any]:
    """Columns: what a registration took, and what made it."""
    return {
        "evaluations": result.evaluations,
        "seconds": round(result.seconds, 2),
        "threads": threads,
        "device": result.device,
        "version": __version__,
    }


def refuse_to_mix(config: DictConfig, folder: Path, cases: Iterable[str], parts: Iterable[str] = ()) -> None:
    """Rows of one folder share all settings but ``cases``, which say what was asked for; ``settings.yaml`` keeps them.

    Settings that are ``parts`` by name may get further ones. Raises ``RegtorchError`` where a setting has changed.
    """
    own = {key: value for key, value in OmegaConf.to_container(config).items() if key not in cases}
    folder.mkdir(parents=True, exist_ok=True)
    kept, before = folder / "settings.yaml", {}
    if kept.exists():
        before = OmegaConf.to_container(OmegaConf.load(kept))
        changed = [key for key in own if key not in parts and own[key] != before.get(key)]
        for key in parts:
            old = before.get(key, {})
            changed += [f"{key}.{name}" for name in old if own[key].get(name, old[name]) != old[name]]
            own[key] = old | own[key]
        if changed:
            raise RegtorchError(f"{folder}: made with another {changed[0]!r}, expected that of {kept} or another out=")
    if own != before:  # two processes may start at once, and one read while the other writes
        kept.write_text(OmegaConf.to_yaml(OmegaConf.create(own)))


def done(folder: Path, key: Iterable[str]) -> set[tuple[str, ...]]:
    """The cases, as the columns of ``key`` name them, that the folder's tables have."""
    cases = set()
    for table in folder.glob(TABLES):
        with table.open(newline="") as file:
            rows = csv.DictReader(file)
            last = (rows.fieldnames or [""])[-1]  # missing where a kill cut the row short
            cases |= {tuple(row[column] for column in key) for row in rows if row[last]}
    return cases


def append(table: Path, row: Mapping[str, Any]) -> None:
    new = not table.exists()
    if not new and not table.read_bytes().endswith(b"\n"):
        with table.open("a", newline="") as file:
            file.write("\r\n")
    with table.open("a", newline="") as file:
        writer = csv.DictWriter(file, row)
        if new:
            writer.writeheader()
        writer.writerow(row)
