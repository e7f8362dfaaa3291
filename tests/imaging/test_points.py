"""Points spread over the anatomy."""

import pytest
import torch

from regtorch.imaging import Volume, attenuation
from regtorch.imaging.points import spread_points


@pytest.fixture(scope="module")
def bone() -> Volume:
    """Two rods along z, 54 mm apart: the thicker one is the denser half."""
    data = torch.full((60, 30, 51), -1000.0)
    data[6:54, 9:15, 6:12] = 500
    data[6:54, 9:15, 36:45] = 900
    patient_from_voxel = torch.diag(torch.tensor([2.0, 2, 2, 1], dtype=torch.float64))
    patient_from_voxel[:3, 3] = torch.tensor([-50.0, 7, 300])
    return attenuation(Volume.from_grid(data, patient_from_voxel))


def test_points_lie_in_the_denser_half(bone):
    points = spread_points(bone, 12)
    assert points.shape == (12, 3)
    assert points.dtype == torch.float64
    voxel_from_patient = torch.linalg.inv(bone.patient_from_voxel)
    index = (points @ voxel_from_patient[:3, :3].mT + voxel_from_patient[:3, 3]).round().long()
    values = torch.stack([bone.data[k, j, i] for i, j, k in index])
    assert bool((values == bone.data.max()).all())


def test_points_are_far_from_each_other_and_more_of_them_begin_with_fewer(bone):
    few, many = spread_points(bone, 5), spread_points(bone, 20)
    assert torch.equal(many[:5], few)
    nearest = lambda p: float((torch.cdist(p, p) + 1e9 * torch.eye(len(p), dtype=torch.float64)).min())  # noqa: E731
    assert nearest(few) > 20
    assert nearest(few) >= nearest(many) > 0
    assert float(many[:, 2].max() - many[:, 2].min()) > 80, "from end to end of the rod"


def test_the_same_points_at_every_call(bone):
    assert torch.equal(spread_points(bone, 16), spread_points(bone, 16))


def test_no_more_points_than_there_are_places():
    data = torch.zeros(4, 4, 4)
    data[1, 1, 1] = 0.05
    volume = Volume(data, torch.eye(4, dtype=torch.float64) * 6, torch.zeros(3, dtype=torch.float64), "per_mm")
    assert spread_points(volume, 10).tolist() == [[6, 6, 6]]
