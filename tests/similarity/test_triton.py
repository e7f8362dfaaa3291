"""The GPU's sums behind gradient correlation against those of plain torch."""

import pytest
import torch
from interpreted import DEVICE, needs_triton

from regtorch.similarity import triton
from regtorch.similarity.gram import FixedGradients, gradient_gram

pytestmark = needs_triton


def _images(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed))


def _found(*given: torch.Tensor) -> list[torch.Tensor]:
    return [result.cpu() for result in triton.gradient_gram(*(t.to(DEVICE) for t in given))]


@pytest.mark.parametrize("shape", [(40, 31), (9, 14), (3, 3), (1, 7), (7, 1), (1, 1)], ids=str)
def test_sums_are_those_of_plain_torch(shape):
    given = _images(3, *shape), _images(2, *shape, seed=1) - 0.5, _images(*shape, seed=2)
    expected = gradient_gram(given[0][:, None], FixedGradients(*given[1:]))
    for found, right in zip(_found(*given), expected, strict=True):
        assert found.dtype == torch.float64
        torch.testing.assert_close(found, right, rtol=1e-5, atol=1e-5)


def test_the_same_bits_at_every_call():
    given = _images(2, 33, 50), _images(2, 33, 50, seed=1), _images(33, 50, seed=2)
    for one, other in zip(_found(*given), _found(*given), strict=True):
        assert torch.equal(one, other)


def test_a_constant_image_has_no_gradient():
    sums, magnitude = _found(torch.full((1, 12, 13), 0.3), _images(2, 12, 13), _images(12, 13, seed=2))
    assert not bool(sums.any())
    assert float(magnitude) == pytest.approx(0.3, rel=1e-6)


def test_no_images_give_no_sums():
    sums, magnitude = _found(torch.zeros(0, 4, 5), torch.zeros(2, 4, 5), torch.zeros(4, 5))
    assert sums.shape == (0, 2, 1, 3)
    assert magnitude.shape == (0,)


def test_what_can_be_summed(monkeypatch):
    images = torch.zeros(1, 4, 5, device=DEVICE)
    assert triton.can_sum(images)
    assert not triton.can_sum(images.double())
    assert not triton.can_sum(images.clone().requires_grad_())
    monkeypatch.delenv("TRITON_INTERPRET", raising=False)
    assert not triton.can_sum(images.cpu())


@pytest.mark.parametrize("m", [1, 2, 10, 15])
@pytest.mark.parametrize("shape", [(40, 71), (3, 3), (1, 7), (7, 1), (1, 1)], ids=str)
def test_products_are_those_of_plain_torch(shape, m):
    given = _images(2, m, *shape), _images(2, *shape, seed=1) - 0.5, _images(*shape, seed=2)
    expected = gradient_gram(given[0], FixedGradients(*given[1:]))
    found = [result.cpu() for result in triton.gradient_grams(*(t.to(DEVICE) for t in given))]
    again = [result.cpu() for result in triton.gradient_grams(*(t.to(DEVICE) for t in given))]
    for one, other, right in zip(found, again, expected, strict=True):
        assert one.dtype == torch.float64
        assert torch.equal(one, other)
        torch.testing.assert_close(one, right, rtol=1e-5, atol=1e-5)


def test_no_groups_give_no_products():
    sums, magnitude = triton.gradient_grams(torch.zeros(0, 3, 4, 5), torch.zeros(2, 4, 5), torch.zeros(4, 5))
    assert sums.shape == (0, 2, 3, 5)
    assert magnitude.shape == (0,)
