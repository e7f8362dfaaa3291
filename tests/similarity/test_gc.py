"""Gradient correlation against eqs. (2)-(3) written out, and what must not change it."""

import kornia
import numpy as np
import pytest
import torch

from regtorch.errors import RegtorchError
from regtorch.similarity import gradient_correlation, gradient_correlation_image
from regtorch.similarity.gradients import image_gradients


def _image(*shape: int, seed: int = 0, dtype: torch.dtype = torch.float64) -> torch.Tensor:
    """Smooth at several scales, as a radiograph is."""
    noise = torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    flat = noise.reshape(-1, 1, *shape[-2:])
    smooth = sum(s * kornia.filters.gaussian_blur2d(flat, (9, 9), (s, s), "replicate") for s in (0.5, 1.0, 2.0))
    return smooth.reshape(shape).to(dtype)


def _weighted_ncc(a: np.ndarray, b: np.ndarray, w: np.ndarray) -> float:
    a, b = a - (w * a).sum() / w.sum(), b - (w * b).sum() / w.sum()
    return (w * a * b).sum() / np.sqrt((w * a * a).sum() * (w * b * b).sum())


def _by_the_book(moving: torch.Tensor, fixed: torch.Tensor, weight: torch.Tensor | None) -> float:
    h, w = fixed.shape
    weights = np.ones((h, w))
    if weight is not None:
        padded = np.pad(weight.numpy(), 1, mode="edge")
        weights = np.min([padded[i : i + h, j : j + w] for i in range(3) for j in range(3)], axis=0)
    gradients = []
    for image in (moving.numpy(), fixed.numpy()):
        p = np.pad(image, 1, mode="edge")
        smooth = lambda q: q[:-2] + 2 * q[1:-1] + q[2:]  # noqa: E731
        gradients.append((smooth(p[:, 2:] - p[:, :-2]) / 8, smooth((p[2:] - p[:-2]).T).T / 8))
    return np.mean([_weighted_ncc(a, b, weights) for a, b in zip(*gradients, strict=True)])


@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("shape", [(9, 14), (3, 3), (40, 31)])
def test_is_eqs_2_and_3(shape, dtype, weighted):
    moving, fixed = _image(5, *shape, dtype=dtype), _image(*shape, seed=1, dtype=dtype)
    weight = torch.rand(shape, generator=torch.Generator().manual_seed(2), dtype=dtype) + 0.1 if weighted else None
    expected = [_by_the_book(m.double(), fixed.double(), weight) for m in moving]
    tolerance = 1e-5 if dtype == torch.float32 else 1e-12
    value = gradient_correlation(moving, fixed, weight=weight)
    assert value.dtype == dtype
    torch.testing.assert_close(value.double(), torch.tensor(expected), atol=tolerance, rtol=0)


def test_by_hand():
    # Replicated borders: d/dx of a 3x3 image whose columns are 0 1 5 is 1/2, 5/2, 2 in each row; of 0 0 4: 0, 2, 2.
    one, two = torch.tensor([0.0, 1.0, 5.0]).expand(3, 3), torch.tensor([0.0, 0.0, 4.0]).expand(3, 3)
    # Less their means 5/3 and 4/3: (-7, 5, 2)/6 and (-8, 4, 4)/6, correlation 84 / sqrt(78 * 96); d/dy of both is 0.
    expected = 84 / (78 * 96) ** 0.5 / 2
    assert float(gradient_correlation(one, two)) == pytest.approx(expected, abs=1e-6)
    assert float(gradient_correlation(one.T, two.T)) == pytest.approx(expected, abs=1e-6)
    assert float(gradient_correlation(one, two.T)) == 0


def test_gradients_are_kornias():
    images = _image(4, 12, 17, dtype=torch.float32)
    expected = kornia.filters.spatial_gradient(images[:, None])[:, 0].transpose(0, 1)
    torch.testing.assert_close(torch.stack(image_gradients(images)), expected, atol=1e-6, rtol=0)


def test_itself_its_negative_and_another():
    image = _image(50, 60, dtype=torch.float32)
    values = gradient_correlation(torch.stack([image, -image, _image(50, 60, seed=3, dtype=torch.float32)]), image)
    torch.testing.assert_close(values[:2], torch.tensor([1.0, -1.0]), atol=1e-5, rtol=0)
    assert abs(float(values[2])) < 0.2


@pytest.mark.parametrize(("gain", "offset"), [(3.0, 0.0), (1e-4, 0.0), (4095.0, 100.0), (0.5, 10.0), (1e6, -1e6)])
def test_gain_and_offset_do_not_matter_in_float32(gain, offset):
    moving, fixed = _image(3, 125, 125, dtype=torch.float32), _image(125, 125, seed=1, dtype=torch.float32)
    moving = moving + 2 * fixed
    expected = gradient_correlation(moving, fixed)
    torch.testing.assert_close(gradient_correlation(gain * moving + offset, fixed), expected, atol=1e-5, rtol=0)
    torch.testing.assert_close(gradient_correlation(moving, gain * fixed + offset), expected, atol=1e-5, rtol=0)


def test_a_ramp_under_the_image_costs_no_digits_in_float32():
    # The gradients' means are then a hundred times their deviations.
    ramp = 20 * (torch.arange(125.0)[:, None] + torch.arange(125.0)).double()
    moving, fixed = _image(3, 125, 125), _image(125, 125, seed=1)
    exact = gradient_correlation(moving + ramp + fixed, fixed)
    rounded = gradient_correlation((moving + ramp + fixed).float(), fixed.float())
    torch.testing.assert_close(rounded.double(), exact, atol=1e-3, rtol=0)


@pytest.mark.parametrize("value", [0.0, 0.1, -3024.0])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_an_image_that_does_not_vary_gives_zero(value, dtype):
    flat, image = torch.full((20, 30), value, dtype=dtype), _image(20, 30, dtype=dtype)
    for a, b in ((flat, image), (image, flat), (flat, flat)):
        assert float(gradient_correlation(a, b)) == 0
        assert not bool(gradient_correlation_image(a, b).any())
    no_weight = torch.zeros(20, 30, dtype=dtype)
    assert float(gradient_correlation(image, image, weight=no_weight)) == 0


def test_the_derivative_of_an_image_that_does_not_vary_is_finite():
    flat = torch.full((8, 9), 0.1, requires_grad=True)
    gradient_correlation(flat, _image(8, 9, dtype=torch.float32)).backward()
    assert bool(flat.grad.isfinite().all())


def test_an_image_that_is_not_a_number_says_so():
    image = _image(2, 8, 9, dtype=torch.float32)
    image[1, 3, 3] = torch.nan
    assert gradient_correlation(image, image[0]).isnan().tolist() == [False, True]


@pytest.mark.parametrize("weighted", [False, True])
def test_pixels_of_the_image_sum_to_the_value(weighted):
    moving, fixed = _image(2, 3, 16, 11), _image(16, 11, seed=1)
    weight = torch.rand(16, 11, dtype=torch.float64) if weighted else None
    image = gradient_correlation_image(moving, fixed, weight=weight)
    assert image.shape == moving.shape
    torch.testing.assert_close(image.sum((-2, -1)), gradient_correlation(moving, fixed, weight=weight))


def test_where_the_weight_is_zero_nothing_counts():
    moving, fixed = _image(4, 30, 30, dtype=torch.float32), _image(30, 30, seed=1, dtype=torch.float32)
    weight = torch.ones(30, 30)
    weight[10:17, 5:25] = 0
    spoiled = torch.where(weight > 0, fixed, 1e3)
    expected = gradient_correlation(moving, fixed, weight=weight)
    torch.testing.assert_close(gradient_correlation(moving, spoiled, weight=weight), expected, atol=1e-5, rtol=0)
    image = gradient_correlation_image(moving, spoiled, weight=weight)
    assert not bool(image[:, 9:18, 4:26].any())
    assert bool(image[:, :9].any())


def test_any_batch_shape_and_chunks_alike(monkeypatch):
    moving, fixed = _image(2, 5, 12, 13, dtype=torch.float32), _image(12, 13, seed=1, dtype=torch.float32)
    whole = gradient_correlation(moving, fixed)
    assert whole.shape == (2, 5)
    assert gradient_correlation(moving[0, 0], fixed).shape == ()
    monkeypatch.setattr("regtorch.batches._NUMBERS", {"cpu": 3 * 12 * 13})
    torch.testing.assert_close(gradient_correlation(moving, fixed), whole)
    assert gradient_correlation_image(moving, fixed).shape == moving.shape


def test_float32_with_and_without_a_graph_agree():
    moving, fixed = _image(6, 64, 50, dtype=torch.float32), _image(64, 50, seed=1, dtype=torch.float32)
    weight = torch.rand(64, 50)
    for w in (None, weight):
        plain = gradient_correlation(moving, fixed, weight=w)
        graph = gradient_correlation(moving.clone().requires_grad_(), fixed, weight=w)
        torch.testing.assert_close(plain, graph.detach(), atol=2e-6, rtol=0)


@pytest.mark.parametrize("weighted", [False, True])
def test_gradcheck(weighted):
    moving, fixed = _image(2, 6, 7).requires_grad_(), _image(6, 7, seed=1).requires_grad_()
    weight = torch.rand(6, 7, dtype=torch.float64) + 0.1 if weighted else None
    assert torch.autograd.gradcheck(lambda m, f: gradient_correlation(m, f, weight=weight), (moving, fixed))
    assert torch.autograd.gradcheck(lambda m, f: gradient_correlation_image(m, f, weight=weight), (moving, fixed))


def test_arguments_are_left_as_they_were():
    moving, fixed, weight = _image(2, 9, 9), _image(9, 9, seed=1), torch.rand(9, 9, dtype=torch.float64)
    before = [t.clone() for t in (moving, fixed, weight)]
    gradient_correlation(moving, fixed, weight=weight)
    gradient_correlation_image(moving, fixed, weight=weight)
    assert all(torch.equal(a, b) for a, b in zip(before, (moving, fixed, weight), strict=True))


def test_a_weight_of_another_shape_is_refused():
    with pytest.raises((RegtorchError, TypeError)):
        gradient_correlation(_image(2, 9, 9), _image(9, 9), weight=torch.ones(9, 8, dtype=torch.float64))
