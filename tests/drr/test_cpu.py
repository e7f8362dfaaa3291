"""The fused kernels against the float64 reference: beams of every kind, volumes and detectors of every shape."""

import gc

import numba
import pytest
import torch

from regtorch.drr import render
from regtorch.geometry import VIEWS, Detector
from regtorch.imaging import Volume

from .scenes import pose_of, random_volume, relative, volume_of

METHODS = ["joseph", "siddon", "trilinear"]
PARITY = 1e-5
OBLIQUE = pose_of((12, -20, 1000), (5, -3, 300), (4, -7, 3))

# Turns of the PA view that send the beam along +-j, +-i and +-k.
TURNS = {
    "-j": (0, 0, 0), "+j": (0, 180, 0),
    "-i": (0, 90, 0), "+i": (0, -90, 0),
    "-k": (90, 0, 0), "+k": (-90, 0, 0),
}  # fmt: skip

BEAMS = {
    "almost straight": ((0.3, -0.7, 1000), (2, 1, 300), (1, 2, 3)),
    "oblique": ((30, -20, 900), (-8, 5, 280), (12, -17, 25)),
    "exactly 45 degrees": ((1.3, -2.1, 1000), (0, 0, 300), (0, 45, 0)),
    "main axes mixed": ((1, 2, 700), (0, 0, 200), (35, 45, 10)),
    "wide fan": ((5, -3, 50), (2, 1, 25), (3, 40, 0)),
    "source in the volume": ((3, -2, 300), (1, 2, 292), (10, 20, 30)),
    "detector in the volume": ((3, -2, 300), (1, 2, 5), (10, 20, 30)),
    "both in the volume": ((0.5, 0.2, 14), (1, -2, 7), (10, 20, 30)),
    "volume behind the source": ((3, -2, 300), (1, 2, 400), (10, 20, 30)),
    "volume behind the detector": ((3, -2, 300), (1, 2, -60), (10, 20, 30)),
    "far to the side": ((3, -2, 1000), (400, 0, 300), (0, 0, 0)),
}


def _parity(volume: Volume, pose: torch.Tensor, detector: Detector, view: str, method: str) -> float:
    fused = render(volume, pose, detector, view, method=method, backend="cpu")
    exact = render(volume.with_data(volume.data.double()), pose, detector, view, method=method, backend="torch")
    assert fused.dtype == torch.float32
    assert fused.shape == exact.shape
    return relative(fused, exact)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("beam", BEAMS)
def test_parity_for_beams_of_every_kind(beam, turn, method):
    source, patient, degrees = BEAMS[beam]
    pose = pose_of(source, patient, tuple(a + b for a, b in zip(degrees, TURNS[turn], strict=True)))
    volume, detector = random_volume(16, 18, 21), Detector(13, 20, 3.5)
    assert _parity(volume, pose, detector, "PA", method) < PARITY
    empty = beam in ("volume behind the source", "volume behind the detector", "far to the side")
    assert bool(render(volume, pose, detector, "PA", method=method).any()) != empty


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("view", ["PA", "LAT"])
def test_parity_at_the_size_of_a_ct(view, method):
    volume = random_volume(150, 130, 170, spacing=(2.0, 2.0, 2.0))
    pose = pose_of((12, -20, 1050), (15, -13, 310), (4, -5, 3))
    assert _parity(volume, pose, Detector(32, 40, 12.0), view, method) < PARITY


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (0.5, 0.5, 5.0), (3.0, 0.7, 1.2)])
def test_parity_for_anisotropic_voxels(spacing, view, method):
    volume = random_volume(20, 33, 27, spacing=spacing)
    assert _parity(volume, OBLIQUE, Detector(30, 41, 1.7), view, method) < PARITY


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    "detector",
    [
        Detector(1, 1, 1.0),
        Detector(1, 40, 1.5),
        Detector(40, 1, 1.5),
        Detector(8, 16, 3.0),
        Detector(9, 17, 3.0),
        Detector(33, 70, 0.6).crop(2, 21, 40, 63),
    ],
    ids=str,
)
def test_parity_for_detectors_of_any_shape(detector, method):
    volume = random_volume(30, 30, 30, spacing=(1.0, 1.0, 1.0))
    assert _parity(volume, OBLIQUE, detector, "PA", method) < PARITY


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("shape", [(1, 12, 14), (12, 1, 14), (12, 14, 1), (1, 1, 9), (1, 1, 1), (2, 2, 2)], ids=str)
@pytest.mark.parametrize("turn", ["-j", "+i", "+k"])
def test_parity_for_volumes_of_one_slice(turn, shape, method):
    volume = volume_of(torch.rand(shape, generator=torch.Generator().manual_seed(0)) + 0.1, (1.5, 2.0, 3.0))
    pose = pose_of((3, -2, 300), (1, 2, 100), tuple(a + 5.0 for a in TURNS[turn]))
    assert _parity(volume, pose, Detector(31, 41, 1.1), "PA", method) < PARITY


@pytest.mark.parametrize("method", METHODS)
def test_parity_on_a_grid_that_is_turned_in_the_patient(method):
    volume = random_volume(20, 22, 24)
    turn = torch.linalg.qr(torch.randn(3, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)).Q
    patient_from_voxel = torch.block_diag(turn, torch.ones(1, 1, dtype=torch.float64)) @ volume.patient_from_voxel
    assert (
        _parity(volume.on_grid(volume.data, patient_from_voxel), OBLIQUE, Detector(40, 40, 1.5), "AP", method) < PARITY
    )


@pytest.mark.parametrize("method", METHODS)
def test_parity_for_a_batch_whose_main_axes_differ(method):
    volume, detector = random_volume(20, 22, 24), Detector(20, 30, 2.0)
    poses = torch.stack([pose_of((2, 1, 800), (3, 2, 250), turn) for turn in [*TURNS.values(), (0, 45, 0)]])
    assert _parity(volume, poses, detector, "PA", method) < PARITY
    one_by_one = [render(volume, pose, detector, method=method, backend="cpu") for pose in poses]
    assert torch.equal(render(volume, poses, detector, method=method, backend="cpu"), torch.stack(one_by_one))


@pytest.mark.parametrize("method", METHODS)
def test_the_same_bits_at_every_call_and_with_any_number_of_threads(method):
    volume, detector = random_volume(30, 31, 32), Detector(50, 45, 1.2)
    poses = torch.stack([OBLIQUE, pose_of(degrees=(0, 45, 0))])
    first = render(volume, poses, detector, method=method, backend="cpu")
    assert torch.equal(render(volume, poses, detector, method=method, backend="cpu"), first)
    threads = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        assert torch.equal(render(volume, poses, detector, method=method, backend="cpu"), first)
    finally:
        numba.set_num_threads(threads)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    "arrange",
    [
        lambda d: d.permute(2, 1, 0).contiguous().permute(2, 1, 0),
        lambda d: d.permute(1, 0, 2).contiguous().permute(1, 0, 2),
        lambda d: torch.stack([d, -d], dim=-1)[..., 0],
        lambda d: torch.cat([d, -d])[: len(d)],
    ],
    ids=["Fortran order", "rows first", "every other number", "part of a larger tensor"],
)
def test_voxels_may_lie_in_memory_as_they_like(arrange, method):
    volume = random_volume(20, 22, 24)
    expected = render(volume, OBLIQUE, Detector(20, 30, 2.0), method=method, backend="cpu")
    rearranged = volume.with_data(arrange(volume.data))
    assert torch.equal(rearranged.data, volume.data)
    assert torch.equal(render(rearranged, OBLIQUE, Detector(20, 30, 2.0), method=method, backend="cpu"), expected)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    "change",
    [
        lambda d: d.mul_(2),
        lambda d: d[4:9, :, 3:].zero_(),
        lambda d: d.view(-1)[1000:].fill_(0.02),
        lambda d: d.transpose(0, 2).copy_(d.transpose(0, 2).flip(0)),
    ],
    ids=["the whole", "a part", "through a view", "through a transposed view"],
)
def test_voxels_changed_in_place_are_seen(change, method):
    volume, detector = random_volume(20, 22, 24), Detector(20, 30, 2.0)
    before = render(volume, OBLIQUE, detector, method=method, backend="cpu")
    change(volume.data)
    after = render(volume, OBLIQUE, detector, method=method, backend="cpu")
    assert not torch.equal(after, before)
    fresh = volume.with_data(volume.data.clone())
    assert torch.equal(after, render(fresh, OBLIQUE, detector, method=method, backend="cpu"))


def test_a_volume_made_where_another_was_is_not_taken_for_it():
    detector, images = Detector(20, 30, 2.0), []
    for value in (0.01, 0.02, 0.03):
        volume = volume_of(torch.full((20, 22, 24), value))
        images.append(render(volume, OBLIQUE, detector, backend="cpu") / value)
        del volume
        gc.collect()
    torch.testing.assert_close(images[1], images[0])
    torch.testing.assert_close(images[2], images[0])


@pytest.mark.parametrize("method", METHODS)
def test_a_volume_made_in_inference_mode_is_rendered_and_its_changes_are_seen(method):
    detector = Detector(20, 30, 2.0)
    with torch.inference_mode():
        volume = random_volume(20, 22, 24)
        before = render(volume, OBLIQUE, detector, method=method)
        volume.data.mul_(2)
        after = render(volume, OBLIQUE, detector, method=method)
    torch.testing.assert_close(after, 2 * before)


@pytest.mark.parametrize("method", METHODS)
def test_an_empty_volume_gives_an_empty_image(method):
    volume = volume_of(torch.zeros(6, 7, 8))
    assert not bool(render(volume, OBLIQUE, Detector(20, 30, 2.0), method=method, backend="cpu").any())
