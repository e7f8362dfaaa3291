"""Normalised cross-correlation, gradient information, normalised mutual information against numpy."""

import numpy as np
import pytest
import torch

from regtorch.errors import RegtorchError
from regtorch.similarity import (
    gradient_correlation,
    gradient_information,
    normalized_cross_correlation,
    normalized_mutual_information,
)
from regtorch.similarity.batches import over_images

ALL = [gradient_correlation, gradient_information, normalized_cross_correlation, normalized_mutual_information]


def _random(*shape: int, seed: int = 0, dtype: torch.dtype = torch.float64) -> torch.Tensor:
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64).to(dtype)


@pytest.mark.parametrize("similarity", ALL)
def test_is_highest_for_the_image_itself(similarity):
    fixed = _random(20, 25)
    moving = torch.stack([_random(20, 25, seed=2), fixed + 0.3 * _random(20, 25, seed=3), fixed])
    values = similarity(moving, fixed)
    assert values.tolist() == sorted(values.tolist())
    assert values[1] < values[2]


@pytest.mark.parametrize("similarity", ALL)
def test_shapes_dtypes_and_arguments_untouched(similarity):
    moving, fixed, weight = (_random(*s, dtype=torch.float32) for s in ((2, 3, 9, 8), (9, 8), (9, 8)))
    before = moving.clone()
    for w in (None, weight):
        values = similarity(moving, fixed, weight=w)
        assert values.shape == (2, 3)
        assert values.dtype == torch.float32
        torch.testing.assert_close(values[1, 2], similarity(moving[1, 2], fixed, weight=w))
    assert torch.equal(moving, before)


@pytest.mark.parametrize("similarity", ALL)
def test_where_the_weight_is_zero_nothing_counts(similarity):
    moving, fixed, weight = _random(3, 15, 16), _random(15, 16, seed=1), torch.ones(15, 16, dtype=torch.float64)
    weight[4:9, :10] = 0
    spoiled_fixed, spoiled = torch.where(weight > 0, fixed, -50), torch.where(weight > 0, moving, 70)
    torch.testing.assert_close(
        similarity(spoiled, spoiled_fixed, weight=weight), similarity(moving, fixed, weight=weight)
    )


@pytest.mark.parametrize("similarity", ALL)
def test_a_uniform_weight_is_no_weight(similarity):
    moving, fixed = _random(3, 15, 16), _random(15, 16, seed=1)
    one = torch.ones(15, 16, dtype=torch.float64)
    torch.testing.assert_close(similarity(moving, fixed, weight=one), similarity(moving, fixed))


@pytest.mark.parametrize("similarity", ALL)
def test_images_that_do_not_vary_give_a_number(similarity):
    flat, image = torch.full((9, 9), 0.1), _random(9, 9, dtype=torch.float32)
    for a, b in ((flat, image), (image, flat), (flat, flat)):
        expected = 1 if similarity is normalized_mutual_information else 0
        assert float(similarity(a, b)) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("weighted", [False, True])
def test_ncc_is_numpys(weighted):
    moving, fixed = _random(4, 12, 9), _random(12, 9, seed=1)
    weight = _random(12, 9, seed=2) if weighted else torch.ones(12, 9, dtype=torch.float64)
    expected = []
    for m in moving:
        c = np.cov(np.stack([m.numpy().ravel(), fixed.numpy().ravel()]), aweights=weight.numpy().ravel())
        expected.append(c[0, 1] / np.sqrt(c[0, 0] * c[1, 1]))
    values = normalized_cross_correlation(moving, fixed, weight=weight if weighted else None)
    torch.testing.assert_close(values, torch.tensor(expected))


def test_ncc_of_gain_and_offset_in_float32():
    moving, fixed = _random(2, 125, 125, dtype=torch.float32), _random(125, 125, seed=1, dtype=torch.float32)
    moving = moving + fixed
    expected = normalized_cross_correlation(moving, fixed)
    for gain, offset in ((1e-3, 0.0), (4095.0, 500.0), (1.0, 30.0)):
        values = normalized_cross_correlation(gain * moving + offset, fixed)
        torch.testing.assert_close(values, expected, atol=1e-5, rtol=0)
    torch.testing.assert_close(normalized_cross_correlation(-fixed, fixed), torch.tensor(-1.0))


@pytest.mark.parametrize("weighted", [False, True])
def test_ncc_gradcheck(weighted):
    moving, fixed = _random(2, 5, 4).requires_grad_(), _random(5, 4, seed=1).requires_grad_()
    weight = _random(5, 4, seed=2) if weighted else None
    assert torch.autograd.gradcheck(lambda m, f: normalized_cross_correlation(m, f, weight=weight), (moving, fixed))


def test_gradient_information_of_two_ramps():
    # Inside, gradients (3, 0) and (2, 2): angle 45 degrees, cos(90) = 0, so half of the smaller magnitude sqrt(8).
    rows, columns = torch.meshgrid(torch.arange(7.0), torch.arange(7.0), indexing="ij")
    weight = torch.zeros(7, 7)
    weight[2:5, 2:5] = 1  # of which the one in the middle is left: the others touch pixels that do not count
    value = gradient_information(3 * columns, 2 * columns + 2 * rows, weight=weight)
    assert float(value) == pytest.approx(8**0.5 / 2, abs=1e-5)
    assert float(gradient_information(columns, rows, weight=weight)) == pytest.approx(0, abs=1e-6)


def test_gradient_information_is_its_formula():
    moving, fixed = _random(10, 11), _random(10, 11, seed=1)
    pads = [np.pad(i.numpy(), 1, mode="edge") for i in (moving, fixed)]
    smooth = lambda q: (q[:-2] + 2 * q[1:-1] + q[2:]) / 8  # noqa: E731
    (ax, ay), (bx, by) = ((smooth(p[:, 2:] - p[:, :-2]), smooth((p[2:] - p[:-2]).T).T) for p in pads)
    a, b = np.hypot(ax, ay), np.hypot(bx, by)
    alpha = np.arccos(np.clip((ax * bx + ay * by) / (a * b), -1, 1))
    expected = ((np.cos(2 * alpha) + 1) / 2 * np.minimum(a, b)).sum()
    assert float(gradient_information(moving, fixed)) == pytest.approx(expected)


@pytest.mark.parametrize("weighted", [False, True])
def test_nmi_is_its_formula(weighted):
    moving, fixed, bins = _random(10, 11), _random(10, 11, seed=1), 6
    weight = _random(10, 11, seed=2) if weighted else torch.ones(10, 11, dtype=torch.float64)

    def share(image):  # of each pixel to each bin: a triangle about the bin's centre
        place = (image - image.min()) / (image.max() - image.min()) * (bins - 1)
        return np.clip(1 - abs(place.ravel()[:, None] - np.arange(bins)), 0, None)

    joint = share(moving.numpy()).T @ (share(fixed.numpy()) * weight.numpy().ravel()[:, None]) / weight.numpy().sum()
    entropy = lambda p: -(p[p > 0] * np.log(p[p > 0])).sum()  # noqa: E731
    expected = (entropy(joint.sum(0)) + entropy(joint.sum(1))) / entropy(joint)
    value = normalized_mutual_information(moving, fixed, weight=weight if weighted else None, bins=bins)
    assert float(value) == pytest.approx(expected)


def test_nmi_of_a_relabelled_image_is_2_and_of_independent_ones_near_1():
    labels = torch.arange(4.0).repeat(100, 25)
    relabelled = torch.tensor([3.0, 0.0, 2.0, 1.0])[labels.long()]
    assert float(normalized_mutual_information(relabelled, labels, bins=4)) == pytest.approx(2, abs=1e-5)
    assert float(normalized_mutual_information(_random(300, 300), _random(300, 300, seed=1), bins=8)) < 1.001
    with pytest.raises(RegtorchError, match="bins"):
        normalized_mutual_information(labels, labels, bins=1)


def test_nmi_has_a_derivative():
    moving, fixed = _random(8, 8).requires_grad_(), _random(8, 8, seed=1)
    normalized_mutual_information(moving, fixed, bins=8).backward()
    step = 1e-7 * _random(8, 8, seed=5)
    step.flatten()[[int(moving.argmin()), int(moving.argmax())]] = 0
    with torch.no_grad():
        change = normalized_mutual_information(moving + step, fixed, bins=8) - normalized_mutual_information(
            moving - step, fixed, bins=8
        )
    assert float((moving.grad * 2 * step).sum()) == pytest.approx(float(change), rel=1e-4)


def test_images_of_another_shape_are_refused():
    moving = torch.ones(2, 4, 6)
    with pytest.raises(RegtorchError, match="fixed image"):
        over_images(lambda images: images.sum((1, 2)), moving, torch.ones(6, 4), None)
    with pytest.raises(RegtorchError, match="weight"):
        over_images(lambda images: images.sum((1, 2)), moving, torch.ones(4, 6), torch.ones(4, 5))
