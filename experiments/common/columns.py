"""The columns that every study writes of a registration: parameters, errors, verdict, cost."""

import hashlib
import math
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from omegaconf import DictConfig
from torch import Tensor

import regtorch
from experiments.common.machine import MACHINE, machine
from regtorch.evaluation import evaluate
from regtorch.geometry import KEYS, parameters_to_dict, pixel_from_patient
from regtorch.imaging import Volume
from regtorch.registration import Evidence, Registration
from regtorch.simulation import Simulation

ACCURACY = (
    *(f"{name}_{key}" for name in ("true", "initial", "found", "error") for key in KEYS),
    "initial_pde_mm", "pde_mm", "target_error_mm",
)  # fmt: skip
EVIDENCE = tuple(f"evidence_{field.name}" for field in fields(Evidence))
VERDICT = ("expected_pde_mm", "within_region", "similarity", "status", "message", "reasons", *EVIDENCE)
COST = ("evaluations", "seconds", "threads", "device", "version", *MACHINE)

REGISTRATION = (*ACCURACY, *VERDICT, *COST)
"""The columns of ``registration_row``."""


def registration_row(result: Registration, truth: Simulation | None, ct: Volume, threads: int) -> dict[str, Any]:
    """All columns that any study writes of a registration; without a truth the errors are None."""
    row = dict.fromkeys(REGISTRATION)
    if truth is not None:
        row |= accuracy_of(result, truth, ct)
    return row | verdict_of(result, truth, row["pde_mm"]) | cost_of(result, threads)


def accuracy_of(result: Registration, truth: Simulation, ct: Volume) -> dict[str, float]:
    """The columns ``ACCURACY``: parameters true, initial and found, and errors before and after (mm, degrees)."""
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


def verdict_of(result: Registration, truth: Simulation | None, pde_mm: float | None) -> dict[str, Any]:
    """The columns ``VERDICT``: how the registration judges itself, and whether the judgement holds.

    ``expected_pde_mm`` is the PDE that the registration expects at the truth's targets. Without a truth it is expected
    over the anatomy in the image. ``reasons`` are the codes of the broken rules. ``within_region``
    says whether the PDE is at most the 95 % bound of the registration.
    """
    points = None if truth is None else torch.tensor(list(truth.targets.values()), dtype=torch.float64)
    expected, bound = result.expected_pde_mm(points) or (None, None)
    return {
        "expected_pde_mm": expected,
        "within_region": None if bound is None or pde_mm is None else pde_mm <= bound,
        "similarity": result.similarity,
        "status": result.status,
        "message": result.message,
        "reasons": " ".join(reason.code for reason in result.reasons),
        **{f"evidence_{name}": _cell(value) for name, value in result.evidence.to_dict().items()},
    }


def _cell(value: Any) -> Any:
    """Lists of names as one text."""
    return " ".join(value) if isinstance(value, list) else value


def cost_of(result: Registration, threads: int) -> dict[str, Any]:
    """The columns ``COST``: the effort of the registration, and the code and machine that made it."""
    return {
        "evaluations": result.evaluations,
        "seconds": round(result.seconds, 2),
        "threads": threads,
        "device": result.device,
        "version": code_version(Path(regtorch.__file__).parent),
        **machine(),
    }


def nine_parameters(config: DictConfig) -> Float[Tensor, "9"]:
    """Nine numbers (mm, rad) from ``source_mm``, ``patient_mm`` and ``rotation_deg``, one angle for all three."""
    return torch.tensor([*config.source_mm, *config.patient_mm, *[math.radians(config.rotation_deg)] * 3])


@cache
def code_version(package: Path) -> str:
    """The package's version, and eight digits that change with its code: one table may hold rows of several."""
    code = hashlib.sha256()
    for file in sorted(package.rglob("*.py")):
        code.update(file.relative_to(package).as_posix().encode() + b"\0" + file.read_bytes() + b"\0")
    return f"{regtorch.__version__}+{code.hexdigest()[:8]}"
