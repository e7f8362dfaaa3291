"""Accuracy on a real CT: radiographs simulated from it, registered from a rough start; one row per registration.

    REGTORCH_DATA=... python -m experiments.accuracy [seeds=10] [views=[PA]] [out=results/accuracy]

Rows are appended as they come; a second start does those that are missing. ``experiments.accuracy_figures`` draws.
"""

import csv
import math
from pathlib import Path
from typing import Any

import hydra
import numba
import torch
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from tqdm import tqdm

from regtorch import __version__
from regtorch.errors import RegtorchError
from regtorch.evaluation import evaluate
from regtorch.geometry import Detector, parameters_to_dict, pixel_from_patient
from regtorch.imaging import Radiograph, Volume, read_volume
from regtorch.registration import initial_parameters, register
from regtorch.simulation import draw_parameters, simulate

_KEY = ("ct", "view", "dof", "radiograph_threshold_hu", "seed")
_CASES = ("views", "arms", "seeds", "first_seed", "threads", "out")


@hydra.main(version_base="1.3", config_path="../conf", config_name="accuracy")
def main(config: DictConfig) -> None:
    torch.set_num_threads(config.threads)
    numba.set_num_threads(config.threads)
    ct = read_volume(config.ct)
    table = Path(config.out) / "registrations.csv"
    _refuse_to_mix(config, table)
    cases = [
        (Path(config.ct).name, view, arm.dof, arm.radiograph_threshold_hu, seed)
        for arm in config.arms
        for seed in range(config.first_seed, config.first_seed + config.seeds)
        for view in config.views
    ]
    done = _done(table)
    with tqdm(cases, unit="registration", mininterval=1) as bar:
        for case in bar:
            if tuple("" if value is None else str(value) for value in case) not in done:
                row = dict(zip(_KEY, case, strict=True)) | _registered(ct, config, *case[1:], bar.set_postfix_str)
                _append(table, row)


def _registered(
    ct: Volume, config: DictConfig, view: str, dof: int, threshold_hu: float | None, seed: int, tell: Any
) -> dict[str, Any]:
    detector = Detector(**config.detector)
    initial = initial_parameters(ct, detector, view)
    if config.z_obj_mm is not None:
        initial[5] = config.z_obj_mm
    true = draw_parameters(initial, _half_range(config.range), torch.Generator().manual_seed(seed))
    truth = simulate(ct, true, view, detector=detector, threshold_hu=threshold_hu, seed=seed)
    result = register(
        ct,
        Radiograph.from_image(truth.image, detector),
        view,
        method=instantiate(config.registration),
        free=dof,
        initial=initial,
        half_range=_half_range(config.search),
        seed=seed,
        progress=lambda share, what: tell(f"{100 * share:.0f} % {what}", refresh=False),
    )
    found = evaluate(result.to_dict(), truth.to_dict())
    start = result.to_dict() | {
        "parameters": parameters_to_dict(initial),
        "pixel_from_patient": pixel_from_patient(initial, detector, view, ct.origin_patient_mm).tolist(),
    }
    row = {f"true_{key}": value for key, value in parameters_to_dict(true).items()}
    row |= {f"initial_{key}": value for key, value in parameters_to_dict(initial).items()}
    row |= {f"found_{key}": value for key, value in parameters_to_dict(result.parameters).items()}
    row |= {f"error_{key}": value for key, value in found["parameter_errors"].items()}
    return row | {
        "initial_pde_mm": evaluate(start, truth.to_dict())["pde_mm"],
        "pde_mm": found["pde_mm"],
        "target_error_mm": found["target_error_mm"],
        "similarity": result.similarity,
        "status": result.status,
        "evaluations": result.evaluations,
        "seconds": round(result.seconds, 2),
        "threads": config.threads,
        "device": result.device,
        "version": __version__,
    }


def _half_range(config: DictConfig) -> torch.Tensor:
    """In mm and rad, nine numbers."""
    return torch.tensor([*config.source_mm, *config.patient_mm, *[math.radians(config.rotation_deg)] * 3])


def _refuse_to_mix(config: DictConfig, table: Path) -> None:
    """Rows of one table share everything but which cases were asked for and how many threads worked on them."""
    settings = OmegaConf.to_container(config)
    own = {key: value for key, value in settings.items() if key not in _CASES}
    kept = table.with_name("settings.yaml")
    if not table.exists() or not kept.exists():
        kept.write_text(OmegaConf.to_yaml(OmegaConf.create(own)))
        return
    before = OmegaConf.to_container(OmegaConf.load(kept))
    if changed := [key for key in own if own[key] != before.get(key)]:
        raise RegtorchError(f"{table}: made with another {changed[0]!r}, expected that of {kept} or another out=")


def _done(table: Path) -> set[tuple[str, ...]]:
    if not table.exists():
        return set()
    with table.open(newline="") as file:
        return {tuple(row[key] for key in _KEY) for row in csv.DictReader(file)}


def _append(table: Path, row: dict[str, Any]) -> None:
    new = not table.exists()
    with table.open("a", newline="") as file:
        writer = csv.DictWriter(file, row)
        if new:
            writer.writeheader()
        writer.writerow(row)


if __name__ == "__main__":
    main()
