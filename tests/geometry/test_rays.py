"""The twelve numbers that describe the rays of a pose, against the projection matrix."""

import pytest
import torch

from regtorch.geometry import (
    VIEWS,
    Detector,
    cone_beam_rays,
    pixel_from_patient,
    project,
    ray_jacobian,
    world_from_ct,
)
from regtorch.imaging import Volume

from .poses import random_poses

DETECTORS = [
    Detector(40, 60, 2.0),
    Detector(1, 1, 5.0),
    Detector(40, 60, 2.0).crop(3, 9, 20, 47),
    Detector(99, 30, 1.0).fit(20),
]


def _volume() -> Volume:
    """Oblique, with three spacings."""
    turn = torch.linalg.qr(torch.randn(3, 3, generator=torch.Generator().manual_seed(3), dtype=torch.float64)).Q
    patient_from_voxel = torch.eye(4, dtype=torch.float64)
    patient_from_voxel[:3, :3] = turn * torch.tensor([0.7, 1.1, 2.5], dtype=torch.float64)
    patient_from_voxel[:3, 3] = torch.tensor([5.0, -70, 11])
    return Volume.from_grid(torch.zeros(20, 30, 40), patient_from_voxel)


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("detector", DETECTORS)
def test_what_lies_on_the_ray_of_a_pixel_projects_to_it(view, detector):
    volume, poses = _volume(), random_poses(4)
    source, first, column_step, row_step = (
        cone_beam_rays(poses, detector, view, volume.voxel_from_ct).unflatten(-1, (4, 3)).unbind(-2)
    )
    matrices = pixel_from_patient(poses, detector, view, volume.origin_patient_mm)
    for column, row in ((0, 0), (detector.columns - 1, 0), (detector.columns // 2, detector.rows - 1)):
        pixel = first + column * column_step + row * row_step
        for along in (0.2, 0.7, 1.0, 1.3):
            voxel = source + along * (pixel - source)
            point = voxel @ volume.patient_from_voxel[:3, :3].mT + volume.patient_from_voxel[:3, 3]
            seen = torch.stack([project(m, p[None])[0] for m, p in zip(matrices, point, strict=True)])
            expected = torch.tensor([column, row], dtype=torch.float64).expand(4, 2)
            torch.testing.assert_close(seen, expected, atol=1e-8, rtol=0)


def test_the_source_is_where_the_parameters_put_it():
    volume, pose = _volume(), random_poses()
    source = cone_beam_rays(pose, DETECTORS[0], "AP", volume.voxel_from_ct)[:3]
    ct = torch.linalg.inv(volume.voxel_from_ct)[:3] @ torch.cat([source, torch.ones(1, dtype=torch.float64)])
    world = world_from_ct(pose, "AP")
    torch.testing.assert_close(world[:3, :3] @ ct + world[:3, 3], pose[:3])


@pytest.mark.parametrize("batch", [(), (3,), (2, 3), (0,)])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_any_batch_shape_and_type(batch, dtype):
    volume, poses = _volume(), random_poses(*batch)
    rays = cone_beam_rays(poses.to(dtype), DETECTORS[2], "PA", volume.voxel_from_ct)
    assert rays.shape == (*batch, 12)
    assert rays.dtype == dtype
    one_by_one = [cone_beam_rays(p, DETECTORS[2], "PA", volume.voxel_from_ct) for p in poses.reshape(-1, 9)]
    expected = torch.stack(one_by_one).reshape(*batch, 12) if one_by_one else rays.double()
    torch.testing.assert_close(rays.double(), expected, atol=0.01 if dtype == torch.float32 else 1e-9, rtol=0)


def test_gradcheck():
    volume, poses = _volume(), random_poses(2).requires_grad_()
    assert torch.autograd.gradcheck(lambda p: cone_beam_rays(p, DETECTORS[2], "LLAT", volume.voxel_from_ct), poses)


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("detector", DETECTORS)
def test_derivatives_are_those_of_autograd(view, detector):
    volume, poses = _volume(), random_poses(2, 3)
    poses[..., 6:] *= 20  # far from where rotations commute
    closed = ray_jacobian(poses, detector, view, volume.voxel_from_ct)
    by_pose = torch.func.jacfwd(lambda p: cone_beam_rays(p, detector, view, volume.voxel_from_ct))
    expected = torch.stack([by_pose(p) for p in poses.reshape(-1, 9)]).reshape(2, 3, 12, 9)
    torch.testing.assert_close(closed, expected, atol=1e-9, rtol=1e-9)
    assert ray_jacobian(poses[:0], detector, view, volume.voxel_from_ct).shape == (0, 3, 12, 9)
