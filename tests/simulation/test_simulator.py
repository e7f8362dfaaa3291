"""A simulated radiograph and the truth about it."""

import json
import math

import pytest
import torch

from regtorch import __version__
from regtorch.drr import render
from regtorch.errors import RegtorchError
from regtorch.geometry import KEYS, Detector, parameters_from_dict, project, world_from_ct
from regtorch.imaging import Volume, attenuation
from regtorch.simulation import add_quantum_noise, draw_geometry, draw_parameters, simulate
from regtorch.simulation.simulator import RANGES

POSE = torch.tensor([10, -5, 1000, 3, 4, 300, 0.05, -0.03, 0.02], dtype=torch.float64)
DETECTOR = Detector(60, 80, 3.0)


@pytest.fixture(scope="module")
def ct() -> Volume:
    """A bone of 600 HU, denser at its lower end, in soft tissue of 40 HU surrounded by air."""
    data = torch.full((30, 26, 28), -1000.0)
    data[2:28, 3:23, 3:25] = 40
    data[6:24, 8:14, 9:17] = 600
    data[6:9, 8:14, 9:17] = 1200
    patient_from_voxel = torch.diag(torch.tensor([4.0, 4, 5, 1], dtype=torch.float64))
    patient_from_voxel[:3, 3] = torch.tensor([-60.0, 20, 900])
    return Volume.from_grid(data, patient_from_voxel, "made.nii")


def test_truth_is_the_contract(ct):
    truth = simulate(ct, POSE, "PA", detector=DETECTOR, seed=7).to_dict()
    assert set(truth) == {
        "parameters", "view", "mirrored", "detector", "pixel_from_patient", "targets_patient_mm", "seed", "version",
    }  # fmt: skip
    assert tuple(truth["parameters"]) == KEYS
    torch.testing.assert_close(parameters_from_dict(truth["parameters"]), POSE)
    assert truth["detector"] == {"rows": 60, "columns": 80, "pixel_mm": 3.0}
    assert (truth["view"], truth["mirrored"], truth["seed"], truth["version"]) == ("PA", False, 7, __version__)
    assert [len(row) for row in truth["pixel_from_patient"]] == [4, 4, 4]
    assert all(len(point) == 3 for point in truth["targets_patient_mm"].values())
    assert json.loads(json.dumps(truth)) == truth


def test_the_image_is_siddons_of_the_whole_ct_or_of_what_is_over_a_threshold(ct):
    for threshold_hu in (None, 100.0, 1000.0):
        image = simulate(ct, POSE, "LLAT", detector=DETECTOR, threshold_hu=threshold_hu).image
        volume = attenuation(ct, threshold_hu=threshold_hu)
        expected = render(volume.with_data(volume.data.double()), POSE, DETECTOR, "LLAT", method="siddon")
        torch.testing.assert_close(image.double(), expected, atol=1e-6, rtol=1e-5)


@pytest.mark.parametrize("view", ["PA", "AP", "LLAT", "RLAT"])
def test_the_matrix_of_the_truth_is_where_the_image_shows_things(ct, view):
    bead = torch.full_like(ct.data, -1000.0)
    bead[20, 5, 8] = 2000
    detector = Detector(200, 240, 1.0)
    simulation = simulate(ct.with_data(bead), POSE, view, detector=detector, targets={"bead": (-28.0, 40.0, 1000.0)})
    rows, columns = torch.meshgrid(*(torch.arange(n).double() for n in simulation.image.shape), indexing="ij")
    image = simulation.image.double() / simulation.image.double().sum()
    seen = torch.stack([(columns * image).sum(), (rows * image).sum()])
    point = torch.tensor([simulation.targets["bead"]], dtype=torch.float64)
    torch.testing.assert_close(seen, project(simulation.pixel_from_patient, point)[0], atol=0.4, rtol=0)


def test_the_truth_is_in_float64_whatever_the_parameters_are(ct):
    simulation = simulate(ct, POSE.float(), detector=DETECTOR)
    assert simulation.parameters.dtype == simulation.pixel_from_patient.dtype == torch.float64
    exact = simulate(ct, POSE.float().double(), detector=DETECTOR)
    assert torch.equal(simulation.pixel_from_patient, exact.pixel_from_patient)


def test_the_same_seed_gives_the_same_noise_and_another_seed_another(ct):
    images = [simulate(ct, POSE, detector=DETECTOR, photons=1e4, seed=seed).image for seed in (1, 1, 2)]
    assert torch.equal(images[0], images[1])
    assert not torch.equal(images[0], images[2])


def test_without_photons_there_is_no_noise(ct):
    images = [simulate(ct, POSE, detector=DETECTOR, seed=seed).image for seed in (1, 2)]
    assert torch.equal(*images)


@pytest.mark.parametrize("line_integral", [0.0, 2.0, 5.0])
@pytest.mark.parametrize("photons", [1e4, 1e6])
def test_noise_has_the_variance_of_one_over_the_counts(photons, line_integral):
    image = torch.full((400, 500), line_integral)
    noisy = add_quantum_noise(image, photons, torch.Generator().manual_seed(0)).double()
    counts = photons * math.exp(-line_integral)
    assert float(noisy.mean()) == pytest.approx(line_integral, abs=4 / counts + 5 / math.sqrt(counts * image.numel()))
    # To first order; the next term is 3 / (2 counts) of it.
    assert float(noisy.var()) == pytest.approx(1 / counts, rel=0.02 + 2 / counts)


def test_no_count_stands_for_one():
    noisy = add_quantum_noise(torch.full((50, 50), 30.0), 1000.0, torch.Generator().manual_seed(0))
    torch.testing.assert_close(noisy, torch.full((50, 50), math.log(1000)))


@pytest.mark.parametrize("photons", [0.0, -5.0, 0.5, math.inf, math.nan])
def test_photons_that_cannot_be_counted_are_refused(photons):
    with pytest.raises(RegtorchError, match="photons per pixel: expected at least 1"):
        add_quantum_noise(torch.zeros(3, 3), photons, torch.Generator())


def test_parameters_are_drawn_from_all_of_their_ranges_and_no_further():
    generator, half_range = torch.Generator().manual_seed(0), torch.tensor(RANGES, dtype=torch.float64)
    drawn = torch.stack([draw_parameters(POSE, half_range, generator) for _ in range(400)])
    share = (drawn - POSE) / half_range
    assert bool((share.abs() <= 1).all())
    assert bool((share.amax(0) > 0.95).all())
    assert bool((share.amin(0) < -0.95).all())
    assert bool((share.mean(0).abs() < 0.12).all())
    between = torch.corrcoef(share.T) - torch.eye(9, dtype=torch.float64)
    assert float(between.abs().max()) < 0.2, "each on its own"


def test_parameters_are_drawn_by_seed_and_a_range_of_zero_is_kept():
    half_range = torch.tensor([0, 0, 0, *RANGES[3:]], dtype=torch.float64)
    one, same, other = (draw_parameters(POSE, half_range, torch.Generator().manual_seed(s)) for s in (3, 3, 4))
    assert torch.equal(one, same)
    assert torch.equal(one[:3], POSE[:3])
    assert not bool((one[3:] == other[3:]).any())


def _z_mm(ct: Volume, above_hu: float, parameters: torch.Tensor, view: str) -> torch.Tensor:
    """Distance from the detector of all voxels above a threshold."""
    voxels = (ct.data > above_hu).nonzero().flip(1).double()
    in_patient = voxels @ ct.patient_from_voxel[:3, :3].mT + ct.patient_from_voxel[:3, 3]
    row = world_from_ct(parameters, view)[2]
    return (in_patient - ct.origin_patient_mm) @ row[:3] + row[3]


@pytest.mark.parametrize("view", ["PA", "AP", "LLAT", "RLAT"])
def test_a_geometry_is_the_first_drawn_with_bone_before_the_detector_and_the_patient_before_the_source(ct, view):
    middle = torch.tensor([0, 0, 200, 0, 0, 40, 0, 0, 0], dtype=torch.float64)
    half_range, redrawn = torch.tensor(RANGES, dtype=torch.float64), 0
    for seed in range(40):
        geometry = draw_geometry(ct, middle, half_range, view, torch.Generator().manual_seed(seed))
        assert float(_z_mm(ct, 100, geometry, view).min()) >= 0
        assert float(_z_mm(ct, -300, geometry, view).max()) < float(geometry[2])
        generator = torch.Generator().manual_seed(seed)
        while not torch.equal(drawn := draw_parameters(middle, half_range, generator), geometry):
            bone, body = (_z_mm(ct, above_hu, drawn, view) for above_hu in (100, -300))
            assert float(bone.min()) < 10 or float(body.max()) > float(drawn[2]) - 10, "but for the box's corners"
            redrawn += 1
    assert redrawn > 4


@pytest.mark.parametrize(("sdd_mm", "odd_mm"), [(1000, -200), (1000, 990), (70, 40)])
def test_where_no_geometry_will_do_drawing_ends(ct, sdd_mm, odd_mm):
    middle = torch.tensor([0, 0, sdd_mm, 0, 0, odd_mm, 0, 0, 0], dtype=torch.float64)
    with pytest.raises(RegtorchError, match=r"made.nii: in all of 100 geometries .* PA view .*, expected smaller"):
        draw_geometry(ct, middle, torch.zeros(9, dtype=torch.float64), "PA", torch.Generator().manual_seed(0))


def test_targets_outside_the_image_are_dropped(ct):
    x, y, z = ct.origin_patient_mm.tolist()
    targets = {"middle": (x, y, z), "too high": (x, y, z + 400), "behind the source": (x, y + 2000, z)}
    assert list(simulate(ct, POSE, detector=DETECTOR, targets=targets).targets) == ["middle"]


def test_no_target_in_the_image_is_an_error(ct):
    x, y, z = ct.origin_patient_mm.tolist()
    with pytest.raises(RegtorchError, match=r"made.nii: none of 1 targets is in the image"):
        simulate(ct, POSE, detector=DETECTOR, targets={"too high": (x, y, z + 400)})


def test_targets_that_nobody_named_lie_on_bone(ct):
    simulation = simulate(ct, POSE, detector=DETECTOR)
    assert len(simulation.targets) == 16
    voxel_from_patient = torch.linalg.inv(ct.patient_from_voxel)
    for point in simulation.targets.values():
        i, j, k = (voxel_from_patient[:3] @ torch.tensor([*point, 1.0], dtype=torch.float64)).round().long().tolist()
        assert float(ct.data[k, j, i]) > 100


def test_a_ct_without_bone_says_so(ct):
    with pytest.raises(RegtorchError, match=r"made.nii: no voxel over 100 HU"):
        simulate(ct.with_data(ct.data.clamp(max=40)), POSE, detector=DETECTOR)
