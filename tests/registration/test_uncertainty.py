"""Predicted spread against the spread over many noisy radiographs, and against the known effect of a shift."""

from dataclasses import replace

import pytest
import torch

from regtorch.drr import render
from regtorch.imaging import Radiograph, attenuation
from regtorch.registration import detector_frame
from regtorch.registration.search.matcher import Matcher
from regtorch.registration.trust.uncertainty import INFLATION, projection_covariance

from .conftest import DETECTOR
from .test_search import matcher_of


def _noisy(pair, seed: int, sigma: float) -> Radiograph:
    noise = torch.randn(pair.truth.image.shape, generator=torch.Generator().manual_seed(seed))
    image = render(
        attenuation(pair.ct), pair.truth.parameters, DETECTOR
    )  # as the search does: noise is all that differs
    return Radiograph.from_image(image + sigma * noise, DETECTOR)


def _matcher(pair, free: list[int], seed: int = 0, sigma: float = 0.05) -> Matcher:
    problem = pair.problem(free, radiograph=_noisy(pair, seed, sigma), initial=pair.truth.parameters)
    return matcher_of(problem, problem.attenuating, 100)


def test_the_spread_is_that_of_many_noisy_radiographs(pair):
    free = [3, 4, 5, 6, 7, 8]
    found, predicted = [], []
    for seed in range(24):
        matcher = _matcher(pair, free, seed)
        climbed = matcher.climb(pair.truth.parameters[None], 20, 1e-5)
        found.append(climbed.parameters[0])
        predicted.append(matcher.covariance(climbed.parameters[0]).diagonal().sqrt())
    actual, predicted = torch.stack(found).std(0)[free], torch.stack(predicted).mean(0)[free]
    assert float((predicted / INFLATION / actual).log().abs().max()) < 0.7  # a factor of two


def test_more_noise_means_less_certainty(pair):
    free = list(range(9))
    little, much = (
        _matcher(pair, free, sigma=s).covariance(pair.truth.parameters).diagonal().sqrt() for s in (0.02, 0.08)
    )
    assert bool((much > 2 * little).all())


def test_the_spread_is_the_same_in_other_coordinates(pair):
    """P maps the covariance of the unknowns to the nine parameters."""
    matcher = _matcher(pair, list(range(9)))
    other = replace(matcher, problem=replace(matcher.problem, coordinates=detector_frame))
    one, same = (m.covariance(pair.truth.parameters) for m in (matcher, other))
    scale = one.diagonal().rsqrt()
    torch.testing.assert_close(scale[:, None] * same * scale, scale[:, None] * one * scale, atol=1e-3, rtol=1e-3)


def test_what_is_frozen_has_no_spread(pair):
    spread = _matcher(pair, [3, 7]).covariance(pair.truth.parameters)
    rest = [0, 1, 2, 4, 5, 6, 8]
    assert not bool(spread[rest].any())
    assert not bool(spread[:, rest].any())
    torch.testing.assert_close(spread, spread.mT)
    assert bool((spread.diagonal()[[3, 7]] > 0).all())


def test_a_shift_of_the_patient_shifts_projections_by_the_magnification(pair):
    parameters = pair.truth.parameters.clone()
    parameters[:2] = 0
    parameters[6:] = 0
    spread = torch.zeros(9, 9, dtype=torch.float64)
    spread[3, 3], spread[4, 4] = 0.04, 0.09
    points = pair.ct.origin_patient_mm + torch.tensor([[0.0, 0, 0], [30, 0, -20], [10, -40, 5]], dtype=torch.float64)
    found = projection_covariance(parameters, spread, points, DETECTOR, "PA", pair.ct.origin_patient_mm)
    height = parameters[5] + points[:, 1] - pair.ct.origin_patient_mm[1]  # PA: Z of the world is posterior
    magnification = parameters[2] / (parameters[2] - height)
    assert found[:, 0, 0].sqrt().tolist() == pytest.approx((0.2 * magnification).tolist())
    assert found[:, 1, 1].sqrt().tolist() == pytest.approx((0.3 * magnification).tolist())
    assert found[:, 0, 1].tolist() == pytest.approx([0, 0, 0], abs=1e-12)


def test_what_the_image_does_not_show_is_not_certain(pair):
    matcher = _matcher(pair, [3, 7])
    away = pair.truth.parameters.clone()
    away[3] = 3000
    spread = matcher.covariance(away)
    assert bool(spread.diagonal()[[3, 7]].isinf().all())
    assert not bool(spread.isnan().any())
