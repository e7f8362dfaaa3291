"""Derivatives of every method: central differences, autograd of the float64 reference, adjoints."""

import math

import numba
import pytest
import torch

from regtorch.drr import render, render_with_jacobian
from regtorch.geometry import Detector
from regtorch.imaging import Volume

from .scenes import pose_of, random_volume, relative, smooth_volume
from .test_cpu import BEAMS, TURNS

METHODS = ["joseph", "siddon", "trilinear"]
DETECTOR = Detector(13, 20, 3.5)
STEPS = torch.tensor([1e-6] * 6 + [1e-8] * 3, dtype=torch.float64)
OBLIQUE = pose_of((12, -20, 1000), (5, -3, 300), (4, -7, 3))


def _in_float64(volume: Volume) -> Volume:
    return volume.with_data(volume.data.double())


def _pose(beam: str, turn: str) -> torch.Tensor:
    source, patient, degrees = BEAMS[beam]
    return pose_of(source, patient, tuple(a + b for a, b in zip(degrees, TURNS[turn], strict=True)))


@pytest.mark.parametrize("method", ["joseph", "trilinear"])
@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("beam", ["almost straight", "oblique", "exactly 45 degrees"])
def test_jacobian_is_that_of_central_differences(beam, turn, method):
    """In float64, by norm and by cosine; Siddon's images jump in their derivative at every voxel, see below."""
    # Away from rays along a plane of voxel centres, where the derivative jumps.
    volume, pose = smooth_volume(), _pose(beam, turn) + 0.0137 * STEPS / STEPS[0]
    _, jacobian = render_with_jacobian(volume.with_data(volume.data.float()), pose, DETECTOR, method=method)
    for p in range(9):
        step = STEPS[p] * torch.eye(9, dtype=torch.float64)[p]
        after, before = (render(volume, pose + s, DETECTOR, method=method, backend="torch") for s in (step, -step))
        expected = ((after - before) / (2 * STEPS[p])).flatten()
        found = jacobian[p].double().flatten()
        assert relative(found, expected) < 1e-4
        assert 1 - float(found @ expected / (found.norm() * expected.norm())) < 1e-8


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("turn", ["-j", "+i", "-k"])
@pytest.mark.parametrize("beam", BEAMS)
def test_jacobian_and_backward_are_those_of_the_reference(beam, turn, method):
    volume, pose = random_volume(16, 18, 21), _pose(beam, turn)
    images, jacobian = render_with_jacobian(volume, pose, DETECTOR, method=method, backend="cpu")
    expected = render_with_jacobian(_in_float64(volume), pose, DETECTOR, method=method, backend="torch")
    assert images.dtype == jacobian.dtype == torch.float32
    assert relative(images, expected[0]) < 1e-5
    assert relative(jacobian, expected[1]) < 1e-4
    weights = torch.randn(13, 20, generator=torch.Generator().manual_seed(1))
    found, exact = (
        _gradients(v, pose, weights, method, b) for v, b in ((volume, "cpu"), (_in_float64(volume), "torch"))
    )
    scale = expected[1].norm(dim=(1, 2)) * weights.norm()
    torch.testing.assert_close(found[0] / scale.clamp_min(1e-30), exact[0] / scale.clamp_min(1e-30), atol=1e-5, rtol=0)
    assert relative(found[1], exact[1]) < 1e-5


def _gradients(volume: Volume, pose: torch.Tensor, weights: torch.Tensor, method: str, backend: str):
    pose, data = pose.clone().requires_grad_(), volume.data.clone().requires_grad_()
    images = render(volume.with_data(data), pose, DETECTOR, method=method, backend=backend)
    return torch.autograd.grad((images * weights).sum(), (pose, data))


@pytest.mark.parametrize("method", METHODS)
def test_the_reference_s_jacobian_is_its_autograd(method):
    volume = random_volume(9, 8, 7, dtype=torch.float64)
    _, jacobian = render_with_jacobian(volume, OBLIQUE, Detector(4, 5, 5.0), method=method, backend="torch")
    expected = torch.autograd.functional.jacobian(
        lambda pose: render(volume, pose, Detector(4, 5, 5.0), method=method, backend="torch"), OBLIQUE
    )
    torch.testing.assert_close(jacobian, expected.movedim(-1, 0))


@pytest.mark.parametrize("backend", ["cpu", "torch"])
@pytest.mark.parametrize("method", METHODS)
def test_classes_in_one_pass_are_those_rendered_alone(method, backend):
    one, two = random_volume(12, 14, 16), random_volume(12, 14, 16).data.flip(0, 2)
    both = Volume(torch.stack([one.data, two]), one.patient_from_voxel, one.origin_patient_mm, "per_mm")
    poses = torch.stack([OBLIQUE, pose_of(degrees=(0, 45, 0))])
    images, jacobian = render_with_jacobian(both, poses, DETECTOR, method=method, backend=backend)
    assert images.shape == (2, 2, 13, 20)
    assert jacobian.shape == (2, 2, 9, 13, 20)
    for c, volume in enumerate((one, one.with_data(two))):
        alone = render_with_jacobian(volume, poses, DETECTOR, method=method, backend=backend)
        torch.testing.assert_close(images[:, c], alone[0])
        assert relative(jacobian[:, c], alone[1]) < 1e-5
        torch.testing.assert_close(render(both, poses, DETECTOR, method=method, backend=backend)[:, c], alone[0])


@pytest.mark.parametrize("method", METHODS)
def test_adjoint_of_classes(method):
    data = torch.stack([random_volume(8, 9, 10).data, random_volume(8, 9, 10).data.flip(0)]).requires_grad_()
    base = random_volume(8, 9, 10)
    volume = Volume(data, base.patient_from_voxel, base.origin_patient_mm, "per_mm")
    images = render(volume, OBLIQUE, DETECTOR, method=method, backend="cpu")
    weights = torch.randn(images.shape, generator=torch.Generator().manual_seed(2))
    (adjoint,) = torch.autograd.grad((images * weights).sum(), data)
    assert float((adjoint * data).sum().detach()) == pytest.approx(float((images * weights).sum().detach()), rel=1e-4)


@pytest.mark.parametrize("method", METHODS)
def test_derivatives_have_the_same_bits_with_any_number_of_threads(method):
    volume, poses = random_volume(20, 21, 22), torch.stack([OBLIQUE, pose_of(degrees=(0, 45, 0))])
    weights = torch.randn(2, 13, 20, generator=torch.Generator().manual_seed(1))

    def all_of_it():
        pose, data = poses.clone().requires_grad_(), volume.data.clone().requires_grad_()
        images = render(volume.with_data(data), pose, DETECTOR, method=method, backend="cpu")
        by = torch.autograd.grad((images * weights).sum(), (pose, data))
        return *by, render_with_jacobian(volume, poses, DETECTOR, method=method, backend="cpu")[1]

    threads = numba.get_num_threads()
    first = all_of_it()
    try:
        numba.set_num_threads(1)
        assert all(torch.equal(a, b) for a, b in zip(all_of_it(), first, strict=True))
    finally:
        numba.set_num_threads(threads)


def test_a_volume_that_changes_before_the_backward_pass_is_complained_of():
    volume, pose = random_volume(8, 9, 10), OBLIQUE.clone().requires_grad_()
    images = render(volume, pose, DETECTOR)
    volume.data.mul_(2)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        images.sum().backward()


def test_gradient_descent_finds_the_way_back():
    volume = random_volume(20, 22, 24)
    with torch.no_grad():
        target = render(volume, OBLIQUE, Detector(30, 40, 2.0))
    pose = (
        OBLIQUE + torch.tensor([0, 0, 0, 2.0, -1.5, 0, 0, 0, math.radians(2)], dtype=torch.float64)
    ).requires_grad_()
    scale = torch.tensor([0, 0, 0, 1, 1, 0, 0, 0, 0.02], dtype=torch.float64)
    before = float((render(volume, pose.detach(), Detector(30, 40, 2.0)) - target).square().sum())
    for _ in range(40):
        cost = (render(volume, pose, Detector(30, 40, 2.0)) - target).square().sum()
        (slope,) = torch.autograd.grad(cost, pose)
        slope = slope * scale.square()
        with torch.no_grad():
            pose -= 0.1 * slope / (slope / scale.clamp_min(1e-9)).norm() * scale.sign()
    assert float(cost.detach()) < before / 5
