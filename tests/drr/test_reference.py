"""The readable projectors: derivatives by pose and by voxel, chunks, linearity."""

import pytest
import torch

from regtorch.drr import reference, render
from regtorch.geometry import Detector

from .scenes import pose_of, random_volume

METHODS = ["siddon", "joseph", "trilinear"]
POSE = pose_of((7, -5, 120), (2, 1, 40), (8, -14, 21))


@pytest.mark.parametrize("view", ["PA", "LLAT"])
@pytest.mark.parametrize("method", METHODS)
def test_gradcheck_by_pose_and_by_voxel(method, view):
    volume, detector = random_volume(4, 5, 6, dtype=torch.float64), Detector(3, 4, 2.7)
    poses = torch.stack([POSE, pose_of((-3, 6, 110), (-1, 2, 38), (-6, 11, 17))])

    def image(data, p):
        return render(volume.with_data(data), p, detector, view, method=method)

    data = (volume.data + 0.01).requires_grad_()  # no empty voxel hides a derivative
    assert torch.autograd.gradcheck(image, (data, poses.clone().requires_grad_()), eps=1e-6, atol=1e-6)


@pytest.mark.parametrize("method", METHODS)
def test_rays_that_miss_and_rays_along_an_axis_have_finite_derivatives(method):
    volume = random_volume(4, 6, 5, dtype=torch.float64)
    pose, data = pose_of().requires_grad_(), volume.data.clone().requires_grad_()
    render(volume.with_data(data), pose, Detector(21, 21, 4.0), method=method).sum().backward()
    assert bool(pose.grad.isfinite().all())
    assert bool(data.grad.isfinite().all())
    assert bool((data.grad >= 0).all())


@pytest.mark.parametrize("method", METHODS)
def test_a_bounded_number_of_samples_at_once_and_the_same_result(method, monkeypatch):
    volume, detector = random_volume(9, 8, 7, dtype=torch.float64), Detector(6, 5, 2.0)
    poses = torch.stack([POSE, pose_of(), POSE])
    whole = render(volume, poses, detector, method=method, backend="torch")
    integrate, rays_at_once = reference._RULES[method], []

    def counted(data, source, pixel, spacing_mm):
        rays_at_once.append(len(pixel))
        return integrate(data, source, pixel, spacing_mm)

    monkeypatch.setitem(reference._RULES, method, counted)
    for samples, at_most in ((1, 1), (500, 10), (1 << 23, 30)):
        rays_at_once.clear()
        monkeypatch.setattr("regtorch.batches._NUMBERS", {"cpu": max(1, samples // 2)})
        torch.testing.assert_close(render(volume, poses, detector, method=method, backend="torch"), whole)
        assert max(rays_at_once) <= at_most
        assert sum(rays_at_once) == whole.numel()


@pytest.mark.parametrize("method", METHODS)
def test_images_are_linear_in_the_voxels(method):
    volume, detector = random_volume(9, 8, 7, dtype=torch.float64), Detector(6, 5, 2.0)
    other = random_volume(9, 8, 7, dtype=torch.float64).data.flip(0, 1, 2)
    one, two, both = (
        render(volume.with_data(d), POSE, detector, method=method, backend="torch")
        for d in (volume.data, other, 3 * volume.data - 2 * other)
    )
    torch.testing.assert_close(both, 3 * one - 2 * two)
    assert bool(one.any())


@pytest.mark.parametrize("method", METHODS)
def test_float32_is_float64_to_six_digits_of_the_brightest(method):
    volume, detector = random_volume(20, 21, 22), Detector(12, 15, 3.0)
    pose = pose_of((7, -5, 1000), (2, 1, 300), (8, -14, 21))
    single = render(volume, pose, detector, method=method, backend="torch")
    double = render(volume.with_data(volume.data.double()), pose, detector, method=method, backend="torch")
    assert single.dtype == torch.float32
    # Siddon's voxels are chosen by comparing rounded numbers, so that a hair of a ray may be in the next one.
    tolerance = 1e-3 if method == "siddon" else 1e-4
    torch.testing.assert_close(single.double(), double, atol=tolerance * float(double.max()), rtol=0)


@pytest.mark.parametrize("shape", [(1, 1, 1), (2, 1, 3), (4, 5, 6)], ids=str)
def test_trilinear_steps_are_at_most_half_a_voxel(shape, monkeypatch):
    sample, longest = reference._sample, []

    def measured(data, points):
        longest.append(float(points.diff(dim=1).norm(dim=-1).max()))
        return sample(data, points)

    monkeypatch.setattr(reference, "_sample", measured)
    along_the_diagonal = pose_of((0, 0, 300), (0, 0, 100), (35.26, 45, 0))
    volume = random_volume(*shape, spacing=(1.0, 1.0, 1.0), dtype=torch.float64)
    render(volume, along_the_diagonal, Detector(31, 31, 0.3), method="trilinear")
    assert 0 < max(longest) <= 0.5
