"""A body that goes on beyond its CT."""

import pytest
import torch

from regtorch.imaging import Volume, continued
from regtorch.imaging.hounsfield import BONE_HU, MU_WATER_PER_MM

WATER = MU_WATER_PER_MM
SPACING = (2.0, 3.0, 4.0)


def _body(slices: int, *, ends: bool = False) -> torch.Tensor:
    """Water [k, j, i] that is the same on all slices, or that ends within them."""
    body = torch.zeros(slices, 10, 12)
    body[:, 2:8, 3:9] = WATER
    if ends:
        body[0] = body[-1] = 0
        body[[1, -2]] *= 0.01
    return body


def _stored(data: torch.Tensor, order: tuple[int, int, int], flipped: bool) -> Volume:
    """Values along the patient's z, y, x, stored with other axes first, or backwards."""
    patient_from_voxel = torch.diag(torch.tensor([*SPACING, 1.0], dtype=torch.float64))
    if flipped:
        data = data.flip(0)
        patient_from_voxel[2, 2] *= -1
        patient_from_voxel[2, 3] = SPACING[2] * (data.shape[0] - 1)
    columns = [2 - axis for axis in reversed(order)]
    turned = patient_from_voxel.clone()
    turned[:, :3] = patient_from_voxel[:, columns]
    return Volume.from_grid(data.permute(order).contiguous(), turned)


def _in_patient(volume: Volume) -> torch.Tensor:
    """Position and value of every voxel that attenuates, sorted."""
    k, j, i = volume.data.nonzero().T
    places = torch.stack([i, j, k, torch.ones_like(i)]).double()
    found = torch.cat([(volume.patient_from_voxel @ places)[:3], volume.data[k, j, i].double()[None]]).T
    return torch.tensor(sorted(found.tolist()), dtype=torch.float64)


@pytest.mark.parametrize("flipped", [False, True])
@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1), (1, 2, 0)], ids=str)
def test_a_cylinder_cut_by_its_ct_is_whole_again(order, flipped):
    whole = _stored(_body(30), order, flipped)
    cut = _stored(_body(10), order, flipped)
    shift = torch.tensor([0, 0, 10 * SPACING[2], 0], dtype=torch.float64)
    again = continued(cut, 14.5 * SPACING[2])  # of which the CT has 4.5 slices to either side of its origin
    assert torch.allclose(_in_patient(again) + shift, _in_patient(whole))
    assert torch.equal(again.origin_patient_mm, cut.origin_patient_mm)


def test_a_body_that_ends_in_its_ct_stays_as_it_is():
    volume = _stored(_body(10, ends=True), (0, 1, 2), False)
    assert continued(volume, 40.0) is volume


def test_a_ct_that_reaches_far_enough_stays_as_it_is():
    cut = _stored(_body(10), (0, 1, 2), False)
    assert continued(cut, 4.5 * SPACING[2]) is cut
    assert continued(cut, 4.6 * SPACING[2]).data.shape[0] == 12


@pytest.mark.parametrize("slices", [1, 2])
def test_a_few_slices_are_a_ct_too(slices):
    again = continued(_stored(_body(slices), (0, 1, 2), False), 20.0)
    assert bool((again.data == _body(len(again.data))).all())
    assert again.data.shape[0] > slices


def test_only_the_end_that_is_cut_goes_on():
    body = _body(10)
    body[0] = 0
    body[1] *= 0.01
    again = continued(_stored(body, (0, 1, 2), False), 7.5 * SPACING[2])
    assert again.data.shape[0] == 13
    assert torch.equal(again.data[:10], body)
    assert torch.equal(again.data[10:], body[-1:].expand(3, -1, -1))


def test_bone_ends_and_there_is_no_gap_of_air():
    body = _body(10)
    body[:, 4, 5] = 3 * WATER
    body[-1] *= 0  # a slice of air that a crop left, or part of a coarser voxel
    again = continued(_stored(body, (0, 1, 2), False), 5.5 * SPACING[2])
    assert torch.equal(again.data[1:-2], body[:-1])
    for end in (0, -2, -1):
        assert float(again.data[end, 4, 5]) == pytest.approx(WATER * (1 + BONE_HU / 1000))
        assert float(again.data[end, 3, 3]) == pytest.approx(WATER)


def test_thick_slices_that_are_tilted_are_still_slices():
    volume = _stored(_body(10), (0, 1, 2), False)
    tilt = torch.tensor(0.6, dtype=torch.float64)
    turned = torch.eye(4, dtype=torch.float64)
    turned[1:3, 1:3] = torch.tensor([[tilt.cos(), -tilt.sin()], [tilt.sin(), tilt.cos()]])
    thick = torch.diag(torch.tensor([1.0, 8.0, 2.0, 1.0], dtype=torch.float64))
    assert volume.on_grid(volume.data, turned @ thick).along_body == 2
