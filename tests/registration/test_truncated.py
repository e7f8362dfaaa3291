"""A CT that covers only part of the anatomy in the radiograph."""

import pytest

from regtorch.imaging import Radiograph, attenuation
from regtorch.registration import register
from regtorch.simulation import simulate

from .conftest import DETECTOR
from .test_search import SMALL, _pde_mm, matcher_of


@pytest.fixture(scope="module")
def part(pair):
    """Less than half of the slices, from the middle; the origin of the parameters stays."""
    slices = pair.ct.data.shape[0]
    first = round(0.29 * slices)
    patient_from_voxel = pair.ct.patient_from_voxel.clone()
    patient_from_voxel[:, 3] += first * patient_from_voxel[:, 2]
    return pair.ct.on_grid(pair.ct.data[first : slices - first], patient_from_voxel)


def _radiograph(pair, ct):
    whole = simulate(ct, pair.truth.parameters, "PA", detector=DETECTOR, targets=pair.truth.targets)
    return Radiograph.from_image(whole.image, DETECTOR)


def test_a_body_that_goes_on_is_like_a_radiograph_of_all_of_it(pair, part):
    gains = []
    for shown in (pair.ct, part):
        problem = pair.problem(list(range(9)), radiograph=_radiograph(pair, shown))
        matcher = matcher_of(problem, attenuation(part, threshold_hu=None), 100)
        truth = pair.truth.parameters[None]
        gains.append(float((matcher.continued().similarity(truth) - matcher.similarity(truth))[0]))
    assert gains[0] > 0.05
    assert gains[1] < -0.05


@pytest.mark.parametrize("shown", ["all of it", "what the CT holds"])
def test_part_of_a_patient_is_registered_whatever_the_radiograph_shows(pair, part, shown):
    radiograph = _radiograph(pair, pair.ct if shown == "all of it" else part)
    found = register(part, radiograph, "PA", method=SMALL, initial=pair.initial)
    assert _pde_mm(pair, found.parameters) < 0.1
    assert found.status == "ok"
    assert found.similarity > 0.99
