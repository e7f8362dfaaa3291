"""A realistic radiograph: different from the plain one, with the same geometry, and reproducible by its seed."""

import pytest
import torch

from regtorch.errors import RegtorchError
from regtorch.geometry import Detector
from regtorch.imaging import Volume
from regtorch.phantom import make_phantom
from regtorch.registration import initial_parameters
from regtorch.simulation import Simulation, realistic, simulate

DETECTOR = Detector(100, 80, 3.5)
OFF = {
    "soft_tissue_mm": 0.0, "devices": 0, "spot_mm": 0.0, "scatter_to_primary": 0.0, "scatter_without_grid": 0.0,
    "photons": None, "fwhm_mm": 0.0, "gain_rms": 0.0, "bits": None, "text": "", "processing": None,
}  # fmt: skip


@pytest.fixture(scope="module")
def ct() -> Volume:
    return make_phantom(6.0)[0]


@pytest.fixture(scope="module")
def parameters(ct) -> torch.Tensor:
    return initial_parameters(ct, DETECTOR, "PA")


@pytest.fixture(scope="module")
def plain(ct, parameters) -> Simulation:
    return simulate(ct, parameters, detector=DETECTOR, seed=3)


def test_the_truth_is_that_of_the_plain_radiograph(ct, parameters, plain):
    made = realistic(ct, parameters, "PA", DETECTOR, seed=3)
    assert made.to_dict() == plain.to_dict()
    assert not torch.equal(made.image, plain.image)
    both = torch.stack([made.image.flatten(), plain.image.flatten()])
    assert 0.7 < float(torch.corrcoef(both)[0, 1]) < 0.999
    assert bool(made.image.isfinite().all())


def test_without_effects_it_is_the_plain_radiograph(ct, parameters, plain):
    assert torch.equal(realistic(ct, parameters, "PA", DETECTOR, seed=3, **OFF).image, plain.image)


@pytest.mark.parametrize("effect", OFF)
def test_each_effect_changes_the_image_and_has_its_own_switch(ct, parameters, plain, effect):
    chosen = OFF | {"scatter_without_grid": 5.0, "processing": "soft"}
    only = {k: v for k, v in OFF.items() if k != effect} | {k: v for k, v in chosen.items() if k == effect and v}
    made = realistic(ct, parameters, "PA", DETECTOR, seed=3, **only)
    assert not torch.equal(made.image, plain.image)


def test_the_same_seed_makes_the_same_image_and_another_seed_another(ct, parameters):
    one, same, other = (realistic(ct, parameters, "PA", DETECTOR, seed=seed).image for seed in (1, 1, 2))
    assert torch.equal(one, same)
    assert not torch.equal(one, other)


def test_leaving_one_effect_out_leaves_the_random_numbers_of_the_others(ct, parameters, plain):
    """The devices are the same whether or not the soft tissue moves."""
    only = {key: value for key, value in OFF.items() if key != "devices"}
    still = realistic(ct, parameters, "PA", DETECTOR, seed=5, **only).image - plain.image
    without = realistic(ct, parameters, "PA", DETECTOR, seed=5, **(OFF | {"soft_tissue_mm": 8.0})).image
    moving = realistic(ct, parameters, "PA", DETECTOR, seed=5, **(only | {"soft_tissue_mm": 8.0})).image - without
    torch.testing.assert_close(still, moving, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("kind", [{"scatter_to_primary": 0.0, "scatter_without_grid": 5.0}, {"processing": "hard"}])
def test_mobile_radiographs_are_reproducible_and_keep_the_truth(ct, parameters, plain, kind):
    one, same, other = (realistic(ct, parameters, "PA", DETECTOR, seed=seed, **kind) for seed in (3, 3, 4))
    assert torch.equal(one.image, same.image)
    assert not torch.equal(one.image, other.image)
    assert one.to_dict() == plain.to_dict()


def test_unknown_processing_is_refused(ct, parameters):
    with pytest.raises(RegtorchError, match="processing 'loud': expected one of soft, hard"):
        realistic(ct, parameters, "PA", DETECTOR, processing="loud")


def test_named_targets_are_kept(ct, parameters):
    x, y, z = ct.origin_patient_mm.tolist()
    made = realistic(ct, parameters, "PA", DETECTOR, targets={"middle": (x, y, z), "far": (x, y, z + 900)})
    assert list(made.targets) == ["middle"]
