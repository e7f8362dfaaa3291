"""The GPU kernels against the float64 reference and its autograd; small, since without a GPU they are interpreted."""

import os
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
import torch
from interpreted import DEVICE, needs_triton

from regtorch.drr import reference, triton
from regtorch.drr.triton.slices import prepared
from regtorch.geometry import Detector, cone_beam_rays

from .scenes import pose_of, random_volume, relative

pytestmark = needs_triton

METHODS = ["joseph", "siddon", "trilinear"]
PARITY, DERIVATIVE_PARITY = 1e-5, 1e-4
DETECTOR = Detector(7, 13, 2.1)
VOLUME = random_volume(6, 7, 5, spacing=(2.0, 2.5, 1.4))
VOLUME = VOLUME.with_data(VOLUME.data + 0.002)

# Turns of the PA view that send the beam along j, i and k.
TURNS = {"-j": (0, 0, 0), "+i": (0, -90, 0), "-k": (90, 0, 0)}

# Trilinear knows no main axis, and is slow to interpret.
CASES = [(method, turn) for method in METHODS for turn in TURNS if method != "trilinear" or turn == "+i"]

BEAMS = {
    "almost straight": ((0.3, -0.7, 1000), (2, 1, 300), (1, 2, 3)),
    "oblique": ((3, -2, 900), (-2, 1, 280), (12, -17, 25)),
    "main axes mixed": ((1, 2, 60), (0, 0, 25), (35, 45, 10)),
    "source in the volume": ((3, -2, 300), (1, 2, 297), (10, 20, 30)),
    "detector in the volume": ((3, -2, 300), (1, 2, 1.3), (10, 20, 30)),
    "volume behind the source": ((3, -2, 300), (1, 2, 400), (10, 20, 30)),
    "volume behind the detector": ((3, -2, 300), (1, 2, -60), (10, 20, 30)),
    "far to the side": ((3, -2, 1000), (400, 0, 300), (0, 0, 0)),
}


def _poses(turn: str) -> torch.Tensor:
    turned = [(s, p, tuple(a + b for a, b in zip(d, TURNS[turn], strict=True))) for s, p, d in BEAMS.values()]
    return torch.stack([pose_of(*beam) for beam in turned])


def _rays(poses: torch.Tensor, detector: Detector = DETECTOR) -> torch.Tensor:
    return cone_beam_rays(poses, detector, "PA", VOLUME.voxel_from_ct)


def _classes() -> torch.Tensor:
    return torch.stack([VOLUME.data, VOLUME.data.flip(0, 1) * 0.3])


def _weights(*shape: int) -> torch.Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(0))


@cache
def _expected(method: str, turn: str) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Images, and the derivatives of their sum weighted by ``_weights``, by rays and by voxels, all in float64."""
    data, rays = _classes().double().requires_grad_(), _rays(_poses(turn)).requires_grad_()
    images = reference.project(data, rays, VOLUME.grid, DETECTOR.rows, DETECTOR.columns, method)
    by_rays, by_data = torch.autograd.grad((images * _weights(*images.shape)).sum(), (rays, data))
    return images.detach(), by_rays, by_data


def _given(turn: str) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    return _classes().to(DEVICE), _rays(_poses(turn)).to(DEVICE), VOLUME.grid.to(DEVICE)


def _assert_poses_agree(found: torch.Tensor, expected: torch.Tensor, parity: float) -> None:
    assert found.shape == expected.shape
    for beam, one, other in zip(BEAMS, found.cpu(), expected, strict=True):
        assert relative(one, other) < parity, beam


@pytest.mark.parametrize(("method", "turn"), CASES)
def test_values_of_beams_of_every_kind(method, turn):
    images = triton.project(*_given(turn), DETECTOR.rows, DETECTOR.columns, method)
    assert images.dtype == torch.float32
    _assert_poses_agree(images, _expected(method, turn)[0], PARITY)
    empty = [not bool(image.any()) for image in images]
    assert empty == [beam in list(BEAMS)[-3:] for beam in BEAMS]


@pytest.mark.parametrize(("method", "turn"), CASES)
def test_the_derivative_by_the_rays_is_that_of_the_reference(method, turn):
    expected = _expected(method, turn)
    weights = _weights(*expected[0].shape).to(DEVICE)
    by_rays = triton.pull_back_rays(*_given(turn), weights, method)
    assert by_rays.dtype == torch.float64
    _assert_poses_agree(by_rays, expected[1], DERIVATIVE_PARITY)


@pytest.mark.parametrize(("method", "turn"), CASES)
def test_the_derivative_by_the_voxels_is_that_of_the_reference(method, turn):
    expected = _expected(method, turn)
    weights = _weights(*expected[0].shape).to(DEVICE)
    by_data = triton.pull_back_data(*_given(turn), weights, method)
    assert by_data.dtype == torch.float32
    assert relative(by_data.cpu(), expected[2]) < PARITY


@pytest.mark.parametrize("method", METHODS)
def test_the_jacobian_is_that_of_the_reference(method):
    poses = _poses("-j")[1:4]
    detector = Detector(5, 17, 1.9)  # more than one tile

    def exact(pose: torch.Tensor) -> torch.Tensor:
        rays = _rays(pose[None], detector)
        return reference.project(_classes().double(), rays, VOLUME.grid, 5, 17, method)[0]

    by_parameters = torch.stack([torch.autograd.functional.jacobian(lambda p: _rays(p, detector), p) for p in poses])
    expected = torch.stack([torch.autograd.functional.jacobian(exact, pose, vectorize=True) for pose in poses])
    given = [t.to(DEVICE) for t in (_classes(), _rays(poses, detector), by_parameters, VOLUME.grid)]
    images, jacobian = triton.project_with_jacobian(*given, 5, 17, method)
    assert relative(images, triton.project(given[0], given[1], given[3], 5, 17, method)) < PARITY
    both = triton.project_as_one(*given, 5, 17, method)
    assert torch.equal(both, torch.cat([images[:, :, None], jacobian], dim=2))
    for found, right in zip(jacobian.cpu(), expected.movedim(-1, 2), strict=True):
        for parameter in range(9):
            assert relative(found[:, parameter], right[:, parameter]) < DERIVATIVE_PARITY


@pytest.mark.parametrize("method", METHODS)
def test_the_same_bits_at_every_call(method):
    data, rays, spacing = _given("-j")
    rays, weights = rays[1:2], _weights(1, 2, 8, 15).to(DEVICE)
    by_parameters = torch.eye(12, 2, dtype=rays.dtype, device=DEVICE)[None]
    for work in (
        lambda: triton.project_with_jacobian(data, rays, by_parameters, spacing, 8, 15, method)[1],
        lambda: triton.pull_back_rays(data, rays, spacing, weights, method),
        lambda: triton.pull_back_data(data, rays, spacing, weights, method),
    ):
        assert torch.equal(work(), work())


def test_one_pose_mixes_main_axes():
    rays = _rays(_poses("-j"))[list(BEAMS).index("main axes mixed")]
    source, first, column_step, row_step = rays.unflatten(-1, (4, 3))
    corners = [first + c * column_step + r * row_step - source for r in (0, 6) for c in (0, 12)]
    assert len({int(corner.abs().argmax()) for corner in corners}) > 1


@pytest.mark.parametrize("method", METHODS)
def test_a_detector_of_several_tiles(method):
    rays = _rays(_poses("-j")[1:2], Detector(9, 17, 1.3))
    found = triton.project(VOLUME.data.to(DEVICE), rays.to(DEVICE), VOLUME.grid, 9, 17, method)
    exact = reference.project(VOLUME.data.double(), rays, VOLUME.grid, 9, 17, method)
    assert found.shape == (1, 1, 9, 17)
    assert relative(found.cpu(), exact) < PARITY


@pytest.mark.parametrize("shape", [(1, 5, 4), (5, 1, 4), (5, 4, 1), (1, 1, 1)], ids=str)
@pytest.mark.parametrize("method", METHODS)
def test_volumes_of_one_slice(method, shape):
    volume = random_volume(*shape)
    rays = cone_beam_rays(_poses("+i")[:1], Detector(3, 4, 1.7), "PA", volume.voxel_from_ct)
    exact = reference.project(volume.data.double(), rays, volume.grid, 3, 4, method)
    found = triton.project(volume.data.to(DEVICE), rays.to(DEVICE), volume.grid, 3, 4, method)
    assert bool(exact.any())
    assert relative(found.cpu(), exact) < PARITY


@pytest.mark.parametrize("method", METHODS)
def test_voxels_may_lie_in_memory_as_they_like(method):
    data, rays, spacing = _given("-j")
    expected = triton.project(data, rays[:1], spacing, 3, 4, method)
    strided = data.permute(3, 1, 0, 2).contiguous().permute(2, 1, 3, 0)
    assert torch.equal(strided, data)
    assert torch.equal(triton.project(strided, rays[:1], spacing, 3, 4, method), expected)


@pytest.mark.parametrize("method", METHODS)
def test_nothing_gives_nothing(method):
    data, rays, spacing = _given("-j")
    assert triton.project(data, rays[:0], spacing, 3, 4, method).shape == (0, 2, 3, 4)
    assert triton.pull_back_rays(data, rays[:0], spacing, data.new_zeros(0, 2, 3, 4), method).shape == (0, 12)
    by_data = triton.pull_back_data(data, rays[:1], spacing, data.new_zeros(1, 2, 3, 4), method)
    assert by_data.shape == data.shape
    assert not bool(by_data.any())


@pytest.mark.filterwarnings("ignore:invalid value encountered:RuntimeWarning")
def test_what_is_not_finite_stays_so_on_the_way_back():
    data, rays, spacing = _given("-j")
    for value in (float("nan"), float("inf")):
        gradients = data.new_full((1, 2, 3, 4), value)
        assert not bool(triton.pull_back_data(data, rays[:1], spacing, gradients, "joseph").isfinite().any())


@pytest.mark.parametrize("size", [1e-30, 1e30])
def test_gradients_of_any_size_come_back(size):
    data, rays, spacing = _given("-j")
    gradients = _weights(1, 2, 3, 4).to(DEVICE)
    expected = triton.pull_back_data(data, rays[:1], spacing, gradients, "joseph")
    found = triton.pull_back_data(data, rays[:1], spacing, gradients * size, "joseph")
    assert relative(found / size, expected) < PARITY


def test_why_not(monkeypatch):
    data = torch.zeros(2, 3, 4, device=DEVICE)
    assert triton.why_not(data, "joseph") == ""
    assert "'siddon'" in triton.why_not(data, "ray march")
    assert "torch.float32" in triton.why_not(data.double(), "joseph")
    monkeypatch.delenv("TRITON_INTERPRET", raising=False)
    assert "CUDA" in triton.why_not(data.cpu(), "joseph")


def test_every_kernel_compiles_for_a_gpu(tmp_path):
    environment = {name: value for name, value in os.environ.items() if name != "TRITON_INTERPRET"}
    program = Path(__file__).parent.parent / "compiled.py"
    subprocess.run([sys.executable, program], check=True, env=environment | {"TRITON_CACHE_DIR": str(tmp_path)})


OCCUPIED = {
    "none": (11, ()),
    "one": (11, (5,)),
    "four": (11, (0, 3, 4, 9)),
    "all": (11, range(11)),
    "beyond those looked at together": (140, (0, 127, 128, 139)),
}


@pytest.mark.parametrize("occupied", OCCUPIED)
@pytest.mark.parametrize("degrees", [(0, 0, 0), (12, -17, 25)], ids=["within", "out sideways"])
def test_slices_that_are_empty_are_skipped_and_no_others(occupied, degrees):
    slices, filled = OCCUPIED[occupied]
    volume = random_volume(14, slices, 16, spacing=(1.5, 0.3, 1.5))
    data = torch.zeros_like(volume.data)
    data[:, list(filled)] = volume.data[:, list(filled)] + 0.01
    poses = pose_of((3, -2, 900), (1, 1, 300), degrees)[None]
    detector = Detector(9, 10, 1.1)
    rays = cone_beam_rays(poses, detector, "PA", volume.voxel_from_ct)
    by_parameters = torch.randn(1, 12, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    place = volume.grid, 9, 10, "joseph"
    expected = reference.project_with_jacobian(data.double(), rays, by_parameters, *place)
    found = triton.project_with_jacobian(data.to(DEVICE), rays.to(DEVICE), by_parameters.to(DEVICE), *place)
    assert relative(triton.project(data.to(DEVICE), rays.to(DEVICE), *place).cpu(), expected[0]) < PARITY
    assert relative(found[0].cpu(), expected[0]) < PARITY
    assert relative(found[1].cpu(), expected[1]) < DERIVATIVE_PARITY
    assert bool(found[0].any()) == bool(filled)


def test_what_is_kept_of_a_volume_goes_when_it_changes():
    data = VOLUME.data.clone().to(DEVICE)
    rays = _rays(_poses("-j")[1:2]).to(DEVICE)
    place = VOLUME.grid, 3, 4, "joseph"
    before = triton.project(data, rays, *place)
    assert prepared(data)[0] is prepared(data)[0]
    data *= 2
    assert relative(triton.project(data, rays, *place), 2 * before) < PARITY
    with torch.inference_mode():
        free = VOLUME.data.clone().to(DEVICE)
        free *= 2
        assert torch.equal(triton.project(free, rays, *place), triton.project(data, rays, *place))


def test_a_batch_of_poses_of_all_main_axes():
    poses = torch.cat([_poses(turn)[1:3] for turn in TURNS])
    rays = _rays(poses).to(DEVICE)
    together = triton.project(VOLUME.data.to(DEVICE), rays, VOLUME.grid, 7, 13, "joseph")
    for image, ray in zip(together, rays, strict=True):
        assert torch.equal(image, triton.project(VOLUME.data.to(DEVICE), ray[None], VOLUME.grid, 7, 13, "joseph")[0])


def test_the_derivative_by_rays_of_several_tiles_and_classes():
    rays = _rays(_poses("-j")[1:3], Detector(9, 17, 1.3))
    weights = _weights(2, 2, 9, 17)
    followed = rays.clone().requires_grad_()
    images = reference.project(_classes().double(), followed, VOLUME.grid, 9, 17, "joseph")
    (expected,) = torch.autograd.grad((images * weights).sum(), followed)
    given = _classes().to(DEVICE), rays.to(DEVICE), VOLUME.grid, weights.to(DEVICE)
    assert relative(triton.pull_back_rays(*given, "joseph").cpu(), expected) < DERIVATIVE_PARITY
