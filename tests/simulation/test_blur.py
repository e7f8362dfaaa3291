"""Blurs in mm of the detector plane, of the intensity, with nothing lost."""

import math

import pytest
import torch

from regtorch.errors import RegtorchError
from regtorch.geometry import Detector
from regtorch.simulation import add_scatter, blur_detector, blur_focal_spot

DETECTOR = Detector(60, 80, 0.5)
FWHM = math.sqrt(8 * math.log(2))
POSE = torch.tensor([0, 0, 1000, 0, 0, 200, 0, 0, 0], dtype=torch.float64)


def _points(detector: Detector) -> torch.Tensor:
    """One pixel that transmits more than the others."""
    image = torch.full((detector.rows, detector.columns), 2.0, dtype=torch.float64)
    image[detector.rows // 2, detector.columns // 3] = 1
    return image


def _spread_mm(before: torch.Tensor, after: torch.Tensor, detector: Detector) -> tuple[float, float]:
    """Standard deviations, down and across, of the light of that pixel."""
    spot = torch.exp(-after) - torch.exp(-before).min()
    spot = spot / spot.sum()
    spreads = []
    for axis in (0, 1):
        profile, at = spot.sum(1 - axis), torch.arange(spot.shape[axis]).double() * detector.pixel_mm
        mean = (profile * at).sum()
        spreads.append(float((profile * (at - mean) ** 2).sum().sqrt()))
    return spreads[0], spreads[1]


@pytest.mark.parametrize("fwhm_mm", [0.1, 0.5, 3.0])
@pytest.mark.parametrize("pixel_mm", [0.2, 0.5])
def test_the_detector_blurs_by_its_millimetres_whatever_its_pixels(fwhm_mm, pixel_mm):
    detector = Detector(round(40 / pixel_mm), round(44 / pixel_mm), pixel_mm)
    sharp = _points(detector)
    blurred = blur_detector(sharp, detector, fwhm_mm=fwhm_mm)
    assert _spread_mm(sharp, blurred, detector) == pytest.approx((fwhm_mm / FWHM,) * 2, rel=1e-3)


def test_a_wide_blur_is_a_gaussian():
    sharp = _points(DETECTOR)
    sigma_mm = 2.0
    spot = torch.exp(-blur_detector(sharp, DETECTOR, fwhm_mm=sigma_mm * FWHM)) - math.exp(-2)
    row, column = (torch.arange(n).double() * 0.5 for n in sharp.shape)
    squared = (row[:, None] - row[30]) ** 2 + (column - column[26]) ** 2
    expected = torch.exp(-squared / (2 * sigma_mm**2)) * 0.25 / (2 * math.pi * sigma_mm**2)
    torch.testing.assert_close(
        spot / (math.exp(-1) - math.exp(-2)), expected, atol=0.02 * float(expected.max()), rtol=0
    )


def test_no_photon_is_lost_even_at_the_border():
    image = 5 * torch.rand(2, 60, 80, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    blurred = blur_detector(image, DETECTOR, fwhm_mm=20.0)
    torch.testing.assert_close(torch.exp(-blurred).sum((1, 2)), torch.exp(-image).sum((1, 2)))
    assert blurred.dtype == torch.float64
    assert blur_detector(image.float(), DETECTOR).dtype == torch.float32


def test_a_uniform_image_stays_as_it_is():
    image = torch.full((60, 80), 3.0)
    torch.testing.assert_close(blur_detector(image, DETECTOR, fwhm_mm=5.0), image)
    torch.testing.assert_close(blur_focal_spot(image, DETECTOR, POSE), image)


def test_it_is_the_intensity_that_is_blurred():
    """An edge between 0 and 8 is half way at half the light, p = log 2."""
    image = torch.zeros(60, 80, dtype=torch.float64)
    image[:, 40:] = 8
    blurred = blur_detector(image, DETECTOR, fwhm_mm=4.0)
    assert float(torch.exp(-blurred[30, 39:41]).mean()) == pytest.approx((1 + math.exp(-8)) / 2)


def test_the_focal_spot_is_seen_as_large_as_the_patient_is_far_from_the_detector():
    sharp = _points(DETECTOR)
    blurred = blur_focal_spot(sharp, DETECTOR, POSE, spot_mm=4.0)
    assert _spread_mm(sharp, blurred, DETECTOR)[0] == pytest.approx(4 * 200 / 800 / FWHM, rel=1e-3)
    on_detector = POSE.clone()
    on_detector[5] = 0
    torch.testing.assert_close(blur_focal_spot(sharp, DETECTOR, on_detector, spot_mm=4.0), sharp)


@pytest.mark.parametrize("line_integral", [1.0, 4.0, 6.0])
def test_behind_a_uniform_patient_the_ratio_of_scatter_grows_with_its_thickness(line_integral):
    hazy = add_scatter(torch.full((60, 80), line_integral), DETECTOR, scatter_to_primary=0.5)
    expected = line_integral - math.log(1 + 0.5 * line_integral / 4)
    torch.testing.assert_close(hazy, torch.full((60, 80), expected))


def test_scatter_is_p_exp_minus_p_spread_by_its_width_in_mm():
    image = torch.zeros(60, 80, dtype=torch.float64)
    image[30, 26] = 2
    haze = torch.exp(-add_scatter(image, DETECTOR, scatter_to_primary=0.3, width_mm=2.0)) - torch.exp(-image)
    assert float(haze.sum()) == pytest.approx(0.3 * 2 / 4 * math.exp(-2))
    assert _spread_mm(torch.full_like(image, math.inf), -haze.log(), DETECTOR)[0] == pytest.approx(2, rel=0.01)


def test_scatter_hides_most_where_least_gets_through_and_air_sends_none():
    image = torch.zeros(60, 80, dtype=torch.float64)
    assert torch.equal(add_scatter(image, DETECTOR), image)
    image[:, 40:] = 1
    image[20:40, 50:60] = 7
    lost = image - add_scatter(image, DETECTOR, width_mm=10.0)
    assert float(lost[30, 55]) > 1 > 0.1 > float(lost[30, 45]) > float(lost[30, 10]) > 0


@pytest.mark.parametrize("value", [-1.0, math.nan, math.inf])
def test_impossible_sizes_are_refused(value):
    image = torch.zeros(60, 80)
    with pytest.raises(RegtorchError, match=r"point spread of .* mm: expected 0 or more"):
        blur_detector(image, DETECTOR, fwhm_mm=value)
    with pytest.raises(RegtorchError, match=r"focal spot of .* mm"):
        blur_focal_spot(image, DETECTOR, POSE, spot_mm=value)
    with pytest.raises(RegtorchError, match="scatter-to-primary ratio"):
        add_scatter(image, DETECTOR, scatter_to_primary=value)


def test_a_patient_beyond_the_source_is_refused():
    pose = POSE.clone()
    pose[5] = 1000
    with pytest.raises(RegtorchError, match="CT at 1000 mm, source at 1000 mm"):
        blur_focal_spot(torch.zeros(60, 80), DETECTOR, pose)
