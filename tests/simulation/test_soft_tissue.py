"""Soft tissue moves smoothly by the requested amount; bones do not move and leave no trace in moved tissue."""

import math

import pytest
import torch

from regtorch.errors import RegtorchError
from regtorch.imaging import Volume
from regtorch.simulation import move_soft_tissue


def _volume(data: torch.Tensor, spacing_mm: tuple[float, float, float] = (4.0, 5.0, 6.0)) -> Volume:
    patient_from_voxel = torch.diag(torch.tensor([*spacing_mm, 1.0], dtype=torch.float64))
    patient_from_voxel[:3, 3] = torch.tensor([-30.0, 40, 800])
    return Volume.from_grid(data, patient_from_voxel, "made.nii")


def _moved(data: torch.Tensor, seed: int = 0, **options: float) -> torch.Tensor:
    return move_soft_tissue(_volume(data), generator=torch.Generator().manual_seed(seed), **options).data


def _field_mm(shape: tuple[int, int, int], spacing_mm: tuple[float, float, float], seed: int = 0, **options: float):
    """Displacements (x, y, z) [3, d, h, w], read off volumes whose HU are a coordinate."""
    found = []
    for axis, mm in zip((2, 1, 0), spacing_mm, strict=True):
        ramp = torch.arange(shape[axis], dtype=torch.float64) * mm / 10
        view = [1, 1, 1]
        view[axis] = -1
        ramp = ramp.reshape(view).expand(shape).contiguous()
        moved = move_soft_tissue(_volume(ramp, spacing_mm), generator=torch.Generator().manual_seed(seed), **options)
        found.append(10 * (moved.data - ramp))
    return torch.stack(found)


def _inner(field: torch.Tensor) -> torch.Tensor:
    """Voxels whose ramps were not clipped at the border."""
    return field[:, 6:-6, 6:-6, 6:-6]


@pytest.mark.parametrize("rms_mm", [2.0, 6.0])
def test_the_body_moves_by_the_rms_that_was_asked(rms_mm):
    field = _inner(_field_mm((60, 56, 64), (5.0, 5.0, 5.0), rms_mm=rms_mm))
    assert float(field.square().sum(0).mean().sqrt()) == pytest.approx(rms_mm, rel=0.15), "of the inner part alone"
    per_axis = field.square().mean((1, 2, 3)).sqrt()
    assert float(per_axis.min()) > 0.25 * rms_mm, "in all directions"


def test_the_field_is_smooth_and_folds_nowhere():
    field = _inner(_field_mm((60, 56, 64), (5.0, 5.0, 5.0), rms_mm=8.0, wavelength_mm=120.0))
    gradient = torch.stack(torch.gradient(field, spacing=5.0, dim=(3, 2, 1)), 1)
    jacobian = gradient.movedim((0, 1), (-2, -1)) + torch.eye(3, dtype=torch.float64)
    assert float(torch.linalg.det(jacobian).min()) > 0.3
    # A wave of 120 mm and amplitude a has a gradient of at most 2 pi a / 120 per mm, RMS.
    assert float(gradient.square().sum((0, 1)).mean().sqrt()) < 2 * math.pi * 8 / 120


def test_the_field_is_that_of_the_patient_whatever_the_voxels():
    coarse = _field_mm((40, 36, 44), (6.0, 6.0, 6.0), rms_mm=5.0)
    fine = _field_mm((80, 72, 88), (3.0, 3.0, 3.0), rms_mm=5.0)
    averaged = torch.nn.functional.avg_pool3d(fine, 2)
    assert float((_inner(averaged) - _inner(coarse)).abs().max()) < 0.6


def test_the_same_seed_moves_the_same_and_another_seed_another_way():
    data = 50 * torch.rand(20, 22, 24, generator=torch.Generator().manual_seed(0))
    assert torch.equal(_moved(data, 1), _moved(data, 1))
    assert not torch.equal(_moved(data, 1), _moved(data, 2))


def _bone_in_tissue() -> tuple[torch.Tensor, torch.Tensor]:
    data = torch.full((40, 36, 44), -1000.0)
    data[2:-2, 4:-4, 4:-4] = 40 + 20 * torch.rand(36, 28, 36, generator=torch.Generator().manual_seed(0))
    bone = torch.zeros(data.shape, dtype=torch.bool)
    bone[8:30, 14:22, 16:26] = True
    bone[12:14, 8:10, 6:38] = True
    data[bone] = 300 + 900 * torch.rand(int(bone.sum()), generator=torch.Generator().manual_seed(1))
    return data, bone


def test_bones_and_their_rim_keep_their_values_to_the_bit():
    data, bone = _bone_in_tissue()
    data[20, 18, 20] = 100  # marrow
    moved = _moved(data, rim_mm=6.0)
    assert torch.equal(moved[bone], data[bone])
    rim = torch.nn.functional.max_pool3d(bone[None].float(), 3, stride=1, padding=1)[0] > 0
    assert torch.equal(moved[rim], data[rim])
    assert not torch.equal(moved, data)


def test_no_bone_moves_along_and_no_hole_opens():
    data, bone = _bone_in_tissue()
    for seed in range(3):
        moved = _moved(data, seed, rms_mm=12.0, rim_mm=6.0)
        assert float(moved[~bone].max()) <= 60.01
        inside = torch.zeros_like(bone)
        inside[9:-9, 12:-12, 14:-14] = True
        assert float(moved[inside].min()) >= 39.99


def test_the_lung_beside_a_rib_makes_no_slit_of_air():
    """Tissue, a rib, then lung: between the rib and the tissue that moves into the lung there is no gap."""
    data = torch.full((30, 40, 30), 40.0)
    data[:, 20:] = -850
    data[:, 17:20, 8:22] = 700
    for seed in range(4):
        moved = move_soft_tissue(_volume(data, (2.0,) * 3), generator=torch.Generator().manual_seed(seed)).data
        air = (moved[3:-3, :, 10:20] < -400).to(torch.int8)
        assert bool((air.diff(dim=1) >= 0).all()), "once in the lung, always in the lung"


def test_nothing_moves_by_zero_and_the_volume_stays_what_it_is():
    data, _ = _bone_in_tissue()
    ct = _volume(data)
    moved = move_soft_tissue(ct, rms_mm=0.0, generator=torch.Generator())
    torch.testing.assert_close(moved.data, data, atol=0.02, rtol=0)
    assert (moved.unit, moved.name) == (ct.unit, ct.name)
    assert torch.equal(moved.patient_from_voxel, ct.patient_from_voxel)


def test_what_cannot_be_moved_is_refused():
    with pytest.raises(RegtorchError, match=r"made.nii: bone and air only"):
        _moved(torch.full((5, 6, 7), 500.0))
    with pytest.raises(RegtorchError, match="expected a positive wavelength"):
        _moved(torch.zeros(5, 6, 7), wavelength_mm=0.0)
    ct = _volume(torch.zeros(5, 6, 7))
    with pytest.raises(RegtorchError, match="expected one volume in HU"):
        move_soft_tissue(ct.with_data(ct.data, unit="per_mm"), generator=torch.Generator())
