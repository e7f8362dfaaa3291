"""Predicted spread against the spread over many noisy radiographs, and against the known effect of a shift."""

import math
from dataclasses import replace

import pytest
import torch

from regtorch.drr import render
from regtorch.geometry import project
from regtorch.imaging import Radiograph, attenuation
from regtorch.registration import detector_frame
from regtorch.registration.search.matcher import Matcher
from regtorch.registration.trust.uncertainty import (
    INFLATION,
    PATCHES,
    clustered_covariance,
    projection_covariance,
    root_mean_square_mm,
)
from regtorch.similarity.gradients import image_gradients
from regtorch.similarity.gram import fixed_gradients

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


def _explained(side: int = 40) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """A smooth image, its derivatives by three unknowns, another image like it, and weights; float64."""
    y, x = torch.meshgrid(*[torch.linspace(-1, 1, n, dtype=torch.float64) for n in (side, side - 7)], indexing="ij")
    image = (-3 * (x**2 + (y - 0.2) ** 2)).exp() + 0.3 * (4 * x + y).sin()
    slopes = torch.stack([(2 * x).cos() * y, image**2, (3 * y + x).sin()])
    noise = torch.randn(image.shape, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    weight = torch.rand(image.shape, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    return image, slopes, image + 0.02 * noise + 0.2 * (5 * y).sin(), weight


def _sandwich(image, slopes, fixed):
    """White's covariance from autograd: H = sum rho J^T J, and s = J^T (rho M - F) of each patch, patch by patch."""

    def moving(unknowns):
        raw = torch.cat(list(image_gradients((image + torch.tensordot(unknowns, slopes, 1))[None])))
        weight = fixed.root**2
        centred = (raw - (raw * weight).sum((1, 2), keepdim=True) / weight.sum()) * fixed.root
        return centred / centred.flatten(1).norm(dim=1)[:, None, None]

    zero = torch.zeros(len(slopes), dtype=torch.float64)
    here, jacobian = moving(zero), torch.autograd.functional.jacobian(moving, zero)
    rho = (here * fixed.unit).sum((1, 2))
    curvature = sum(r * j.flatten(0, 1).mT @ j.flatten(0, 1) for r, j in zip(rho, jacobian, strict=True))
    side = math.ceil(max(image.shape) / PATCHES)
    meat = torch.zeros_like(curvature)
    for row in range(0, image.shape[0], side):
        for column in range(0, image.shape[1], side):
            part = slice(None), slice(row, row + side), slice(column, column + side)
            residual = (rho[:, None, None] * here - fixed.unit)[part]
            score = (jacobian[part] * residual[..., None]).sum((0, 1, 2))
            meat += score.outer(score)
    return INFLATION**2 * torch.linalg.inv(curvature) @ meat @ torch.linalg.inv(curvature)


@pytest.mark.parametrize("weighted", [False, True], ids=["all pixels", "weighted"])
def test_the_covariance_is_whites_with_rho_in_curvature_and_scores(weighted):
    image, slopes, other, weight = _explained()
    fixed = fixed_gradients(other, weight if weighted else None)
    rho = (fixed_gradients(image, weight if weighted else None).unit * fixed.unit).sum((1, 2))
    assert bool((rho < 0.9).any()), "where rho is 1, leaving it out changes nothing"
    torch.testing.assert_close(clustered_covariance(image, slopes, fixed), _sandwich(image, slopes, fixed))


def test_images_of_opposite_contrast_are_not_certain():
    image, slopes, other, _ = _explained()
    assert bool(clustered_covariance(-image, -slopes, fixed_gradients(other, None)).diagonal().isinf().all())


def test_errors_that_all_patches_share_only_add():
    """Patches alone give the spread by noise, as the spread over many radiographs shows; the rest comes on top."""
    assert INFLATION > 1


def test_the_expected_error_is_the_root_of_the_mean_variance_of_points(pair):
    problem = pair.problem(list(range(9)))
    spread = torch.diag(torch.tensor([4.0, 1, 9, 0.25, 0.5, 2, 1e-4, 2e-4, 3e-4], dtype=torch.float64))
    draws = torch.randn(4000, 9, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    poses = pair.initial + draws @ spread.sqrt()
    off = [
        (project(problem.pixel_from_patient(p), problem.points) - there).square().sum(1).mean()
        for there in [project(problem.pixel_from_patient(pair.initial), problem.points)]
        for p in poses
    ]
    actual = float(torch.stack(off).mean().sqrt()) * DETECTOR.pixel_mm
    assert root_mean_square_mm(problem, pair.initial, spread) == pytest.approx(actual, rel=0.04)
