"""Images may lie where others lay before, but never where some still do, and hold nothing of these."""

import pytest
import torch

from regtorch.drr.cpu import memory
from regtorch.drr.cpu.memory import empty
from regtorch.drr.render import render_with_jacobian
from regtorch.geometry import Detector
from tests.drr.scenes import random_volume

LARGE = (memory._LEAST_BYTES // 4,)


def test_dropped_memory_is_lent_again():
    first = empty(*LARGE)
    place = first.data_ptr()
    del first
    assert empty(*LARGE).data_ptr() == place


def test_memory_with_a_living_view_is_not():
    first = empty(*LARGE).fill_(1)
    view, array = first[5:9], first.numpy()
    del first
    other = empty(*LARGE).fill_(2)
    assert view.tolist() == [1] * 4
    del view
    another = empty(*LARGE).fill_(3)
    assert array[0] == 1
    assert len({other.data_ptr(), another.data_ptr(), array.ctypes.data}) == 3


def test_no_more_is_kept_than_the_limit(monkeypatch):
    monkeypatch.setattr(memory, "_MOST_BYTES", 3 * memory._LEAST_BYTES)
    several = [empty(*LARGE) for _ in range(8)]
    del several
    assert sum(size * len(some) for size, some in memory._kept.items()) <= memory._MOST_BYTES


@pytest.mark.parametrize("method", ["joseph", "siddon", "trilinear"])
def test_images_in_used_memory_are_the_same_bits(method):
    detector = Detector(rows=150, columns=130, pixel_mm=2.0)
    parameters = torch.tensor([0.0, 0, 1000, 0, 0, 150, 0.1, 0.05, 0], dtype=torch.float64).expand(16, 9)
    volume = random_volume(24, 26, 28)

    def rendered():
        return render_with_jacobian(volume, parameters, detector, "PA", method=method, backend="cpu")

    image, jacobian = rendered()
    places = image.data_ptr(), jacobian.data_ptr()
    before = image.clone(), jacobian.clone()
    image.fill_(torch.nan)
    jacobian.fill_(torch.nan)
    del image, jacobian
    again = rendered()
    assert (again[0].data_ptr(), again[1].data_ptr()) == places
    assert all(torch.equal(*pair) for pair in zip(again, before, strict=True))
