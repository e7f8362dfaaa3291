"""What every row of a table of registrations tells: parameters, errors, cost."""

import hashlib
import math
from functools import cache
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from omegaconf import DictConfig
from torch import Tensor

import regtorch
from regtorch.evaluation import evaluate
from regtorch.geometry import parameters_to_dict, pixel_from_patient
from regtorch.imaging import Volume
from regtorch.registration import Registration
from regtorch.simulation import Simulation


def nine_parameters(config: DictConfig) -> Float[Tensor, "9"]:
    """In mm and rad, of ``source_mm``, ``patient_mm`` and ``rotation_deg``, which is the same for all three angles."""
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


def verdict_of(result: Registration, truth: Simulation | None, pde_mm: float | None) -> dict[str, Any]:
    """Columns: what a registration says of itself, and whether its PDE is within the 95 % bound that it tells.

    Of the truth's targets, as the PDE; of the anatomy in the image where there is no truth.
    """
    points = None if truth is None else torch.tensor(list(truth.targets.values()), dtype=torch.float64)
    expected, bound = result.expected_pde_mm(points) or (None, None)
    return {
        "expected_pde_mm": expected,
        "within_region": None if bound is None or pde_mm is None else pde_mm <= bound,
        "similarity": result.similarity,
        "status": result.status,
        "message": result.message,
    }


def cost_of(result: Registration, threads: int) -> dict[str, Any]:
    """Columns: what a registration took, and what made it."""
    return {
        "evaluations": result.evaluations,
        "seconds": round(result.seconds, 2),
        "threads": threads,
        "device": result.device,
        "version": code_version(Path(regtorch.__file__).parent),
    }


@cache
def code_version(package: Path) -> str:
    """The package's version and eight digits that change with its code: rows of one table may be of several."""
    code = hashlib.sha256()
    for file in sorted(package.rglob("*.py")):
        code.update(file.relative_to(package).as_posix().encode() + b"\0" + file.read_bytes() + b"\0")
    return f"{regtorch.__version__}+{code.hexdigest()[:8]}"
