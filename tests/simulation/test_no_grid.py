"""Scatter without a grid: its ratio, its conservation, and what has to change nothing."""

import pytest
import torch

from regtorch.errors import RegtorchError
from regtorch.geometry import Detector
from regtorch.simulation import add_scatter_without_grid

DETECTOR = Detector(60, 80, 5.0)


def _patient() -> torch.Tensor:
    """Thick in the middle, air at both sides."""
    across = torch.linspace(-1.2, 1.2, 80, dtype=torch.float64)
    down = torch.linspace(0.8, 1, 60, dtype=torch.float64)
    return 6 * down[:, None] * (1 - across**2).clamp(min=0).sqrt()


def _ratio(image: torch.Tensor, **settings) -> torch.Tensor:
    total, primary = torch.exp(-add_scatter_without_grid(image, DETECTOR, **settings)), torch.exp(-image)
    return (total - primary) / primary


@pytest.mark.parametrize("wanted", [1.0, 5.0])
def test_the_ratio_behind_the_thickest_part_is_the_one_given(wanted):
    ratio = _ratio(_patient(), scatter_to_primary=wanted)
    assert float(ratio[59, 38:42].mean()) == pytest.approx(wanted, rel=0.05)
    assert float(ratio.max()) < 1.1 * wanted


def test_behind_a_uniform_patient_the_ratio_is_exact_and_everywhere_the_same():
    slab = torch.full((60, 80), 5.0, dtype=torch.float64)
    torch.testing.assert_close(_ratio(slab, scatter_to_primary=4.0), torch.full_like(slab, 4.0))


def test_spreading_keeps_the_number_of_scattered_photons():
    """Air around the patient sends none, and what reaches a border is mirrored: nothing is lost."""
    image = _patient()
    spread, unspread = (
        _ratio(image, widths_mm=(mm,), shares=(1.0,), scatter_to_primary=2.0) * torch.exp(-image) for mm in (40.0, 0.0)
    )
    source = image * torch.exp(-image)
    torch.testing.assert_close(unspread / unspread.sum(), source / source.sum())
    thickest = torch.exp(-image).argmin()
    per_photon = [float(haze.flatten()[thickest] / haze.sum()) for haze in (spread, unspread)]
    assert float(spread.sum() / unspread.sum()) == pytest.approx(per_photon[1] / per_photon[0], rel=0.05)


def test_the_ratio_falls_towards_thin_parts_and_is_smooth():
    ratio = _ratio(_patient())
    assert float(ratio[30, 40]) > 2 * float(ratio[30, 10]) > 0
    haze = ratio * torch.exp(-_patient())
    assert float(haze.diff(dim=1).abs().max()) < 0.15 * float(haze.max())


def test_metal_neither_scatters_nor_counts_as_the_thickest_part():
    patient = _patient()
    metal = torch.zeros_like(patient)
    metal[20:30, 20:30] = 4
    with_metal = add_scatter_without_grid(patient + metal, DETECTOR, patient)
    haze = torch.exp(-with_metal) - torch.exp(-patient - metal)
    torch.testing.assert_close(haze, torch.exp(-add_scatter_without_grid(patient, DETECTOR)) - torch.exp(-patient))


def test_no_scatter_and_air_change_nothing():
    image = _patient()
    assert torch.equal(add_scatter_without_grid(image, DETECTOR, scatter_to_primary=0.0), image)
    air = torch.zeros(60, 80)
    assert torch.equal(add_scatter_without_grid(air, DETECTOR), air)


def test_impossible_scatter_is_refused():
    image = _patient()
    with pytest.raises(RegtorchError, match="ratio -1"):
        add_scatter_without_grid(image, DETECTOR, scatter_to_primary=-1.0)
    with pytest.raises(RegtorchError, match="a sum of 1"):
        add_scatter_without_grid(image, DETECTOR, shares=(0.5, 0.6))
    with pytest.raises(RegtorchError, match=r"patient of \(3, 4\)"):
        add_scatter_without_grid(image, DETECTOR, torch.zeros(3, 4))
