"""A phantom on coarse voxels, a small detector, and a radiograph of both that bone alone explains."""

from dataclasses import dataclass

import pytest
import torch
from torch import Tensor

from regtorch.geometry import Detector
from regtorch.imaging import BONE_HU, Radiograph, Volume, attenuation, crop_to_anatomy
from regtorch.imaging.points import spread_points
from regtorch.phantom import make_phantom
from regtorch.registration import initial_parameters
from regtorch.registration.problem import Problem
from regtorch.registration.unknowns import Range
from regtorch.similarity import gradient_correlation
from regtorch.simulation import Simulation, simulate

DETECTOR = Detector(100, 80, 3.5)
OFF = (15.0, -10.0, 30.0, 10.0, -12.0, 20.0, 0.04, -0.05, 0.03)
HALF_RANGE = (30.0, 30.0, 60.0, 30.0, 30.0, 60.0, 0.1, 0.1, 0.1)


def searched(free: list[int], initial: Tensor, half_range: Tensor | None = None) -> Range:
    given = torch.tensor(HALF_RANGE, dtype=torch.float64) if half_range is None else half_range
    half_range = torch.zeros(9, dtype=torch.float64)
    half_range[free] = given[free]
    return Range(initial, half_range)


@dataclass(frozen=True)
class Pair:
    ct: Volume
    initial: Tensor
    truth: Simulation
    radiograph: Radiograph

    def problem(
        self, free: list[int], *, initial: Tensor | None = None, half_range: Tensor | None = None, **changes: object
    ) -> Problem:
        initial = self.initial if initial is None else initial
        attenuating = attenuation(crop_to_anatomy(self.ct))
        settings = {
            "attenuating": attenuating,
            "threshold_hu": BONE_HU,
            "whole": attenuation(crop_to_anatomy(self.ct, threshold_hu=None), threshold_hu=None),
            "radiograph": self.radiograph,
            "view": "PA",
            "similarity": gradient_correlation,
            "searched": searched(free, initial, half_range),
            "points": spread_points(attenuating, 24),
            "seed": 0,
            "progress": lambda share, what: None,
        }
        return Problem(**(settings | changes))


@pytest.fixture(scope="session")
def pair() -> Pair:
    ct, targets = make_phantom(6.0)
    initial = initial_parameters(ct, DETECTOR, "PA")
    true = initial + torch.tensor(OFF, dtype=torch.float64)
    truth = simulate(ct, true, "PA", detector=DETECTOR, threshold_hu=100.0, targets=targets)
    return Pair(ct, initial, truth, Radiograph.from_image(truth.image, DETECTOR))
