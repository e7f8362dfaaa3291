"""Gain, offset, and counts of limited range."""

import math

import pytest
import torch

from regtorch.errors import RegtorchError
from regtorch.simulation import add_gain_and_offset, digitise


def _generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def test_gain_shifts_and_offset_adds_to_the_signal():
    image = 6 * torch.rand(40, 50, generator=_generator(), dtype=torch.float64)
    brighter = add_gain_and_offset(image, gain=2.0, gain_rms=0.0, generator=_generator())
    torch.testing.assert_close(brighter, image - math.log(2))
    veiled = add_gain_and_offset(image, offset=0.01, gain_rms=0.0, generator=_generator())
    torch.testing.assert_close(torch.exp(-veiled), torch.exp(-image) + 0.01)


def test_pixels_differ_in_gain_by_its_share_at_every_exposure():
    for line_integral in (0.0, 6.0):
        image = torch.full((300, 400), line_integral, dtype=torch.float64)
        uneven = add_gain_and_offset(image, gain_rms=0.02, generator=_generator())
        assert float(uneven.std()) == pytest.approx(0.02, rel=0.01)
        assert float(uneven.mean()) == pytest.approx(line_integral, abs=4e-4)


def test_gains_are_those_of_the_seed_and_the_same_in_all_images():
    image = torch.ones(3, 20, 30)
    one, same, other = (add_gain_and_offset(image, generator=_generator(seed)) for seed in (1, 1, 2))
    assert torch.equal(one, same)
    assert not torch.equal(one, other)
    assert torch.equal(one[0], one[2])


@pytest.mark.parametrize("bits", [8, 12, 16])
def test_counts_are_linear_in_the_intensity_and_read_to_half_a_count(bits):
    image = torch.linspace(0, 5, 2000, dtype=torch.float64).reshape(40, 50)
    counts, read = digitise(image, bits=bits)
    highest = 2**bits - 1
    assert (int(counts[0, 0]), counts.dtype) == (highest, torch.int32)
    assert float((counts - highest * torch.exp(-image)).abs().max()) <= 0.5
    assert float((torch.exp(-read) - torch.exp(-image)).abs().max()) <= 0.5 / highest + 1e-12


def test_what_is_over_full_scale_is_clipped_and_what_leaves_no_count_is_half_a_one():
    image = torch.tensor([[0.0, 0.5, 30.0]], dtype=torch.float64)
    counts, read = digitise(image, full_scale=0.5)
    assert counts.tolist() == [[4095, 4095, 0]]
    expected = torch.tensor([[math.log(2), math.log(2), math.log(2 * 4095 * 2)]], dtype=torch.float64)
    torch.testing.assert_close(read, expected)


def test_reading_twice_changes_nothing():
    image = 7 * torch.rand(40, 50, generator=_generator(), dtype=torch.float64)
    counts, read = digitise(image, full_scale=0.3)
    again, read_again = digitise(read, full_scale=0.3)
    assert torch.equal(counts[counts > 0], again[counts > 0])
    torch.testing.assert_close(read_again[counts > 0], read[counts > 0])


def test_impossible_electronics_are_refused():
    image = torch.zeros(3, 4)
    with pytest.raises(RegtorchError, match="0 bits: expected 1 to 16"):
        digitise(image, bits=0)
    with pytest.raises(RegtorchError, match="full scale of -1"):
        digitise(image, full_scale=-1.0)
    for values in ({"gain": 0.0}, {"offset": -0.1}, {"gain_rms": math.nan}):
        with pytest.raises(RegtorchError, match="expected a positive gain"):
            add_gain_and_offset(image, **values, generator=_generator())
