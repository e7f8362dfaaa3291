"""HU to attenuation, the box of the anatomy, averaging onto coarser voxels."""

from pathlib import Path

import pytest
import torch

from regtorch.errors import RegtorchError
from regtorch.formats import read_volume
from regtorch.imaging import Volume, attenuation, bone_contrast, coarsen, crop_to_anatomy


def volume_of(data: torch.Tensor, spacing: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> Volume:
    rotation = torch.tensor([[0, 0.8, 0.6], [0, -0.6, 0.8], [1, 0, 0]], dtype=torch.float64)
    patient_from_voxel = torch.eye(4, dtype=torch.float64)
    patient_from_voxel[:3, :3] = rotation * torch.tensor(spacing, dtype=torch.float64)
    patient_from_voxel[:3, 3] = torch.tensor([5.0, -7, 11])
    return Volume.from_grid(data, patient_from_voxel, "made.nii")


def places(volume: Volume) -> torch.Tensor:
    """Patient coordinates of every voxel."""
    k, j, i = torch.meshgrid(*(torch.arange(n, dtype=torch.float64) for n in volume.data.shape), indexing="ij")
    voxels = torch.stack([i, j, k, torch.ones_like(i)], dim=-1)
    return (voxels @ volume.patient_from_voxel.mT)[..., :3]


def centre_of_mass(volume: Volume) -> torch.Tensor:
    share = volume.data.double() / volume.data.sum(dtype=torch.float64)
    return (share[..., None] * places(volume)).sum((0, 1, 2))


def mass(volume: Volume) -> float:
    return float(volume.data.double().sum() * volume.spacing_mm.prod())


def test_linear_and_clamped() -> None:
    hu = torch.tensor([-3024.0, -1024, -1000, -500, 0, 100, 1000]).reshape(1, 1, 7)
    free = attenuation(volume_of(hu), threshold_hu=None)
    assert free.unit == "per_mm"
    torch.testing.assert_close(free.data.flatten(), torch.tensor([0, 0, 0, 0.01, 0.02, 0.022, 0.04]))
    bone = attenuation(volume_of(hu), mu_water_per_mm=0.03)
    torch.testing.assert_close(bone.data.flatten(), torch.tensor([0, 0, 0, 0, 0, 0.033, 0.06]))
    assert float(hu.min()) == -3024, "the HU are left alone"


def test_nothing_over_the_threshold() -> None:
    with pytest.raises(RegtorchError, match=r"made.nii: no voxel over 100 HU \(the highest has 40 HU\)"):
        attenuation(volume_of(torch.full((2, 3, 4), 40.0)))
    for what in (attenuation, crop_to_anatomy):
        with pytest.raises(RegtorchError, match="no voxel over -1000 HU"):
            what(volume_of(torch.full((2, 3, 4), -3024.0)), threshold_hu=None)


def test_contrast_is_what_bone_adds_to_the_tissue_that_it_displaces() -> None:
    hu = torch.tensor([-1000.0, 50, 100, 600]).reshape(1, 1, 4)
    bone = attenuation(volume_of(hu))
    torch.testing.assert_close(bone_contrast(bone).data.flatten(), torch.tensor([0, 0, 0, 0.01]))
    for least in (None, -1000.0):
        everything = attenuation(volume_of(hu), threshold_hu=least)
        assert torch.equal(bone_contrast(everything, threshold_hu=least).data, everything.data)


def test_units_are_not_confused() -> None:
    volume = volume_of(torch.full((2, 3, 4), 500.0))
    with pytest.raises(RegtorchError, match="values in per_mm, expected HU"):
        attenuation(attenuation(volume))
    with pytest.raises(RegtorchError, match="values in per_mm, expected HU"):
        crop_to_anatomy(attenuation(volume))
    with pytest.raises(RegtorchError, match=r"mu_water of 0.0 per mm"):
        attenuation(volume, mu_water_per_mm=0.0)


def test_crop_keeps_place_and_origin() -> None:
    data = torch.full((9, 8, 7), -1000.0)
    data[3:5, 0, 6] = 700
    data[4, 2, 5] = 300
    ct = volume_of(data, (0.5, 0.75, 2))
    whole, part = attenuation(ct), attenuation(crop_to_anatomy(ct))
    assert part.data.shape == (4, 4, 3), "one voxel around, but not beyond the volume"
    assert mass(part) == pytest.approx(mass(whole))
    torch.testing.assert_close(centre_of_mass(part), centre_of_mass(whole))
    torch.testing.assert_close(part.origin_patient_mm, whole.origin_patient_mm)


def test_crop_leaves_out_nothing_that_attenuates() -> None:
    data = torch.full((5, 6, 7), -1000.0)
    data[2, 3, 3], data[2, 3, 5] = 100, 99
    ct = volume_of(data)
    assert crop_to_anatomy(ct).data.shape == (3, 3, 3)
    for least in (None, -1000.0, -2000.0):
        assert crop_to_anatomy(ct, threshold_hu=least).data.shape == (3, 3, 5), "air at -1000 HU is none"


@pytest.mark.parametrize("spacing_mm", [2.0, 3.2, 5.0, 100.0])
def test_coarsening_keeps_mass(spacing_mm: float) -> None:
    generator = torch.Generator().manual_seed(0)
    hu = torch.randint(-1000, 1500, (11, 14, 17), generator=generator).float()
    fine = attenuation(volume_of(hu, (0.7, 1.1, 4.25)))
    coarse = coarsen(fine, spacing_mm)
    assert coarse.spacing_mm.tolist() == pytest.approx([max(spacing_mm, s) for s in (0.7, 1.1, 4.25)])
    assert mass(coarse) == pytest.approx(mass(fine), rel=1e-5)
    torch.testing.assert_close(coarse.origin_patient_mm, fine.origin_patient_mm)


@pytest.mark.parametrize(("spacing_mm", "off"), [(2.1, 1e-6), (6.3, 1e-6), (1.5, 0.05), (3.2, 0.05)])
def test_coarsening_keeps_place(spacing_mm: float, off: float) -> None:
    """The mean of a ramp over a voxel is its value at the voxel's centre, nearly so where voxels are shared out."""
    fine = volume_of(torch.zeros(11, 18, 27), (0.7, 1.05, 6.3))
    ramp = torch.tensor([0.3, -0.2, 0.1], dtype=torch.float64)
    coarse = coarsen(fine.with_data(places(fine) @ ramp, unit="per_mm"), spacing_mm)
    difference = (coarse.data - places(coarse) @ ramp)[:, 1:-1, 1:-1]
    assert float(difference.abs().max()) < off


def test_coarsening_by_two_is_the_mean_of_eight() -> None:
    data = torch.rand(4, 6, 8, generator=torch.Generator().manual_seed(0))
    fine = volume_of(data).with_data(data, unit="per_mm")
    expected = torch.nn.functional.avg_pool3d(data[None], 2)[0]
    torch.testing.assert_close(coarsen(fine, 2.0).data, expected)
    assert coarsen(fine, 0.9).data is data, "never finer"


def test_coarsening_leaves_an_axis_that_would_hardly_shrink() -> None:
    fine = volume_of(torch.rand(8, 9, 10), (1.0, 1.9, 4.0)).with_data(torch.rand(8, 9, 10), unit="per_mm")
    assert coarsen(fine, 3.0, least_ratio=1.6).spacing_mm.tolist() == pytest.approx([3.0, 1.9, 4.0])
    assert coarsen(fine, 3.0).spacing_mm.tolist() == pytest.approx([3.0, 3.0, 4.0])


def test_coarsening_hounsfield_units_surrounds_them_with_air() -> None:
    coarse = coarsen(volume_of(torch.zeros(3, 3, 3)), 2.0)
    assert float(coarse.data[0, 0, 0]) == pytest.approx(-1000 + 1000 * 0.75**3)


def test_padding_of_a_real_ct_does_not_attenuate(data_folder: Path) -> None:
    ct = read_volume(data_folder / "ct_slices_dicom")
    everything = attenuation(ct, threshold_hu=None)
    assert float(everything.data[ct.data == -3024].max()) == 0
    bone = attenuation(crop_to_anatomy(ct))
    assert bone.data.shape == (12, 263, 431)
    assert float(bone.data[bone.data > 0].min()) == pytest.approx(0.02 * 1.1)
    assert float(bone.data.max()) == pytest.approx(0.02 * (1 + 1.254))
