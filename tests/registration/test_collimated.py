"""A radiograph whose edges are collimated, with scatter beyond them, is registered by what the field shows."""

from dataclasses import replace
from functools import partial

import numpy as np
import torch
from kornia.filters import gaussian_blur2d
from PIL import Image

from regtorch.evaluation import projection_distances
from regtorch.formats import read_radiograph
from regtorch.geometry import Detector
from regtorch.imaging import attenuation
from regtorch.plotting import write_overlay
from regtorch.registration import Settings, Stage, hybrid, register
from regtorch.simulation import simulate

_DETECTOR = Detector(200, 160, 1.75)
_FIELD = (24, 180, 20, 152)
_LEVELS = (Stage(40, 12, 12), Stage(80, 4, 12), Stage(120, 2, 10))
_SMALL = partial(hybrid, settings=Settings(poses=100, levels=_LEVELS, finest_pixels=160))


def test_collimated_radiograph(pair, tmp_path):
    truth = simulate(pair.ct, pair.truth.parameters, "PA", detector=_DETECTOR)
    r0, r1, c0, c1 = _FIELD
    beam = torch.full_like(truth.image, 0.01)
    beam[r0:r1, c0:c1] = 1
    light = (-truth.image).exp() * gaussian_blur2d(beam[None, None], (5, 5), (0.8, 0.8))[0, 0]
    light += 0.5 * gaussian_blur2d(light[None, None], (121, 121), (30.0, 30.0), "constant")[0, 0]
    counts = (40000 * light / light.max()).round().to(torch.int32)
    Image.fromarray(counts.numpy().astype("uint16")).save(tmp_path / "radiograph.png")
    radiograph = read_radiograph(tmp_path / "radiograph.png", view="PA", pixel_mm=1.75, intensity="counts")

    seen = radiograph.weight.nonzero()
    least, most = seen.amin(0), seen.amax(0) + 1
    for found, at in zip((least[0], -most[0], least[1], -most[1]), (r0, -r1, c0, -c1), strict=True):
        assert 0 <= int(found) - at <= 8
    result = register(pair.ct, radiograph, "PA", method=_SMALL)
    points = torch.tensor(list(truth.targets.values()), dtype=torch.float64)
    matrices = result.pixel_from_patient, truth.pixel_from_patient
    assert float(projection_distances(*matrices, points, 1.75).nanmean()) < 0.5
    assert result.status == "ok"

    pictures = []
    for weight in (radiograph.weight, torch.ones_like(radiograph.weight)):
        path = tmp_path / f"{len(pictures)}.png"
        write_overlay(path, attenuation(pair.ct), replace(radiograph, weight=weight), result, {})
        pictures.append(np.asarray(Image.open(path).convert("L"), dtype=float))
    collimated, whole = pictures
    middle = tuple(slice(2 * size // 5, 3 * size // 5) for size in whole.shape)
    assert np.array_equal(collimated[middle], whole[middle])
    beyond = slice(-whole.shape[0] // 12, -whole.shape[0] // 18), middle[1]
    assert collimated[beyond].mean() < 0.5 * whole[beyond].mean()
