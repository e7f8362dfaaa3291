"""Accuracy on a real CT: radiographs simulated from it, registered from a rough start; one row per registration.

    REGTORCH_DATA=... python -m experiments.accuracy [seeds=10] [views=[PA]] [out=results/accuracy]

Rows are appended as they come; a second start does those that are missing. ``experiments.accuracy_figures`` draws.
"""

from pathlib import Path
from typing import Any

import hydra
import torch
from hydra.utils import instantiate
from omegaconf import DictConfig
from tqdm import tqdm

from experiments.command import told_in_one_line, use_threads
from experiments.rows import accuracy_of, cost_of, nine_parameters
from experiments.table import append, done, keep, locked, refuse_to_mix
from regtorch.formats import read_volume
from regtorch.geometry import Detector
from regtorch.imaging import Radiograph, Volume
from regtorch.registration import initial_parameters, register
from regtorch.simulation import draw_parameters, simulate

_KEY = ("ct", "view", "dof", "radiograph_threshold_hu", "seed")
_CASES = ("views", "arms", "seeds", "first_seed", "threads", "out")


@hydra.main(version_base="1.3", config_path="../conf", config_name="accuracy")
def main(config: DictConfig) -> None:
    with told_in_one_line("accuracy"):
        run(config)


def run(config: DictConfig) -> None:
    """Does what is missing."""
    use_threads(config.threads)
    ct = read_volume(config.ct)
    folder = Path(config.out)
    table = folder / "registrations.csv"
    refuse_to_mix(config, folder, _CASES)
    cases = [
        (Path(config.ct).name, view, arm.dof, arm.radiograph_threshold_hu, seed)
        for arm in config.arms
        for seed in range(config.first_seed, config.first_seed + config.seeds)
        for view in config.views
    ]
    with locked(table), tqdm(cases, unit="registration", mininterval=1) as bar:
        made = done(folder, _KEY)
        for case in bar:
            if tuple("" if value is None else str(value) for value in case) not in made:
                row = dict(zip(_KEY, case, strict=True)) | _registered(ct, config, *case[1:], bar.set_postfix_str)
                keep(config, folder, _CASES)
                append(table, row)


def _registered(
    ct: Volume, config: DictConfig, view: str, dof: int, threshold_hu: float | None, seed: int, tell: Any
) -> dict[str, Any]:
    detector = Detector(**config.detector)
    initial = initial_parameters(ct, detector, view)
    if config.z_obj_mm is not None:
        initial[5] = config.z_obj_mm
    true = draw_parameters(initial, nine_parameters(config.range), torch.Generator().manual_seed(seed))
    truth = simulate(ct, true, view, detector=detector, threshold_hu=threshold_hu, seed=seed)
    result = register(
        ct,
        Radiograph.from_image(truth.image, detector),
        view,
        method=instantiate(config.registration),
        free=dof,
        initial=initial,
        half_range=nine_parameters(config.search),
        seed=seed,
        progress=lambda share, what: tell(f"{100 * share:.0f} % {what}", refresh=False),
    )
    verdict = {"similarity": result.similarity, "status": result.status}
    return accuracy_of(result, truth, ct) | verdict | cost_of(result, config.threads)


if __name__ == "__main__":
    main()
