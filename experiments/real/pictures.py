"""Pictures of a pair's modal answer: the overlay, and where image and DRR correlate (figure 7)."""

from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from omegaconf import OmegaConf

mpl.use("agg")

from experiments.common.settings import SETTINGS
from experiments.common.style import DPI
from experiments.real import spread
from experiments.real.study import Case, Study
from regtorch.drr import render
from regtorch.errors import RegtorchError
from regtorch.imaging import attenuation, level
from regtorch.plotting import write_overlay
from regtorch.similarity import gradient_correlation_image

_PIXELS = 500


def draw(folder: Path, pairs: Path) -> list[Path]:
    """Registers each modal answer again, and writes FOLDER/pictures/PAIR_*.png.

    Raises ``RegtorchError`` for a folder without settings, and for a pair that the file lacks.
    """
    if not (folder / SETTINGS).is_file():
        raise RegtorchError(f"{folder}: no {SETTINGS}, expected a folder of the study of real pairs")
    kept = {"pairs": str(pairs), "threads": 1, "device": "cpu"}
    study = Study(OmegaConf.merge(OmegaConf.load(folder / SETTINGS), kept))
    rows = spread.read(folder)
    rows = rows[rows.half.isna()]
    written = []
    for name, some in rows.groupby("pair"):
        if name not in study.pairs:
            raise RegtorchError(f"{pairs}: no pair {name!r}, expected those of {folder}")
        best = some.loc[some.modal_mm.idxmin()]
        written += _pictures(folder / "pictures", study, (str(name), str(best.arm), int(best.seed)))
    return written


def _pictures(folder: Path, study: Study, case: Case) -> list[Path]:
    name = case[0]
    folder.mkdir(parents=True, exist_ok=True)
    overlay, correlation = (folder / f"{name}_{what}.png" for what in ("overlay", "correlation"))
    result, radiograph = study.registration(case), study.radiograph(case)
    bone = attenuation(study.cts[name], threshold_hu=study.config.threshold_hu)
    write_overlay(overlay, bone, radiograph, result, study.targets[name])
    small = level(radiograph, _PIXELS)
    moving = render(bone, result.parameters[None], small.detector, result.view)
    values = gradient_correlation_image(moving, small.image, weight=small.weight)[0].numpy()
    most = np.quantile(np.abs(values), 0.995)
    figure, panels = plt.subplots(1, 3, figsize=(12, 4), layout="constrained")
    titles = f"{name}, seen from the source", "bone as found", "gradient correlation of each pixel"
    for axes, image, title in zip(panels, (small.image.numpy(), moving[0].numpy(), values), titles, strict=True):
        signed = {"cmap": "RdBu_r", "vmin": -most, "vmax": most} if image is values else {"cmap": "gray"}
        axes.imshow(image, **signed)
        axes.set(title=title, xticks=[], yticks=[])
        axes.grid(visible=False)
    figure.savefig(correlation, dpi=DPI)
    plt.close(figure)
    return [overlay, correlation]
