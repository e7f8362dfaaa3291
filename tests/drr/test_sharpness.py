"""Voxels with sharp edges: the same as finer voxels of the same values, on every backend, with exact derivatives."""

from dataclasses import replace

import pytest
import torch

from regtorch.drr import cpu, reference, render, render_with_jacobian, triton
from regtorch.errors import RegtorchError
from regtorch.geometry import Detector, cone_beam_rays
from regtorch.imaging import Volume, coarsen

from .scenes import pose_of, random_volume, relative

DETECTOR = Detector(17, 20, 2.3)
OBLIQUE = pose_of((12, -20, 1000), (5, -3, 300), (4, -7, 3))
SHARP = replace(random_volume(12, 10, 14, spacing=(1.0, 1.5, 4.0)), sharpness=(2.0, 1.0, 5.0))


def _in_float64(volume: Volume) -> Volume:
    return volume.with_data(volume.data.double())


def _repeated(volume: Volume, i: int, k: int) -> Volume:
    """Each voxel split into i x k voxels of the same value; the main axis of the beam, j, is not split."""
    data = volume.data.repeat_interleave(i, dim=2).repeat_interleave(k, dim=0)
    voxel_from_part = torch.diag(torch.tensor([1 / i, 1, 1 / k, 1], dtype=torch.float64))
    voxel_from_part[0, 3], voxel_from_part[2, 3] = (1 / i - 1) / 2, (1 / k - 1) / 2
    return replace(volume.on_grid(data, volume.patient_from_voxel @ voxel_from_part), sharpness=(1.0, 1.0, 1.0))


def test_a_sharp_voxel_is_many_small_ones_of_its_value():
    sharp, linear = _in_float64(SHARP), _repeated(_in_float64(SHARP), 2, 5)
    image = render(sharp, OBLIQUE, DETECTOR, backend="torch")
    torch.testing.assert_close(image, render(linear, OBLIQUE, DETECTOR, backend="torch"))
    assert relative(render(replace(sharp, sharpness=(1.0,) * 3), OBLIQUE, DETECTOR, backend="torch"), image) > 0.01


def test_the_sharper_the_nearer_to_siddon():
    volume = _in_float64(SHARP)
    exact = render(volume, OBLIQUE, DETECTOR, method="siddon")
    off = [relative(render(volume.with_edges(mm), OBLIQUE, DETECTOR), exact) for mm in (torch.inf, 1.0, 0.2)]
    assert off[0] > 2 * off[2]
    assert off[0] > off[1] > off[2]


def test_rays_through_the_centres_of_voxels_have_their_slopes_along_an_axis_that_is_not_sharp():
    volume = replace(random_volume(8, 8, 8, spacing=(1.0, 1.0, 1.0)), sharpness=(1.0, 1.0, 3.0))
    straight = pose_of((0, 0, 1e7), (0, 0, 300))
    detector = Detector(9, 9, 0.5)
    _, found = render_with_jacobian(volume, straight, detector, backend="cpu")
    _, expected = render_with_jacobian(_in_float64(volume), straight + 1e-9, detector, backend="torch")
    assert relative(found[3], expected[3]) < 0.2


def test_coarse_voxels_are_linear_where_they_were_averaged():
    assert coarsen(SHARP, 2.0).sharpness == (1.0, 1.0, 5.0)


def test_edges_as_wide_as_asked_for():
    assert SHARP.with_edges(1.2).sharpness == pytest.approx((1.0, 1.25, 4.0 / 1.2))
    assert SHARP.with_edges(torch.inf).sharpness == (1.0, 1.0, 1.0)
    with pytest.raises(RegtorchError, match=r"edges of 0\.0 mm"):
        SHARP.with_edges(0.0)


@pytest.mark.parametrize("degrees", [(0, 0, 0), (0, 90, 0), (90, 0, 0), (35, 45, 10)])
def test_kernels_give_what_the_reference_gives(degrees, monkeypatch):
    monkeypatch.setenv("TRITON_INTERPRET", "1")
    pose = pose_of((12, -20, 1000), (5, -3, 300), degrees)
    images, jacobian = render_with_jacobian(_in_float64(SHARP), pose, DETECTOR, backend="torch")
    found = render_with_jacobian(SHARP, pose, DETECTOR, backend="cpu")
    assert relative(found[0], images) < 1e-5
    assert relative(found[1], jacobian) < 1e-4
    rays = cone_beam_rays(pose[None], DETECTOR, "PA", SHARP.voxel_from_ct)
    weights = torch.randn(1, 1, 17, 20, generator=torch.Generator().manual_seed(0))
    data = SHARP.data.double().requires_grad_()
    torch_images = reference.project(data, rays, SHARP.grid, 17, 20, "joseph")
    (expected,) = torch.autograd.grad((torch_images * weights).sum(), data)
    backends = [cpu] if triton.why_not(SHARP.data, "joseph") else [cpu, triton]
    for backend in backends:
        assert relative(backend.project(SHARP.data, rays, SHARP.grid, 17, 20, "joseph")[0, 0], images) < 1e-5
        by_data = backend.pull_back_data(SHARP.data, rays, SHARP.grid, weights, "joseph")
        assert relative(by_data, expected) < 1e-5


def test_the_jacobian_is_that_of_central_differences():
    volume = _in_float64(SHARP)
    _, jacobian = render_with_jacobian(SHARP, OBLIQUE, DETECTOR)
    step = 1e-7
    for p in range(9):
        moved = [OBLIQUE + sign * step * torch.eye(9, dtype=torch.float64)[p] for sign in (1, -1)]
        after, before = (render(volume, pose, DETECTOR, backend="torch") for pose in moved)
        assert relative(jacobian[p], (after - before) / (2 * step)) < 1e-4
