"""Wires, a block and letters: sizes in mm, exact masks, by seed."""

import math

import pytest
import torch

from regtorch.errors import RegtorchError
from regtorch.geometry import Detector
from regtorch.simulation import add_devices, add_text

DETECTOR = Detector(150, 180, 1.0)


def _generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def _metal(detector: Detector, seed: int = 0, **options: object) -> torch.Tensor:
    blank = torch.zeros(detector.rows, detector.columns, dtype=torch.float64)
    return add_devices(blank, detector, generator=_generator(seed), **options)[0]


def test_devices_only_add_and_the_mask_is_where():
    image = torch.rand(150, 180, generator=_generator(5), dtype=torch.float64)
    with_devices, mask = add_devices(image, DETECTOR, generator=_generator())
    assert torch.equal(with_devices[~mask], image[~mask])
    assert bool((with_devices[mask] > image[mask]).all())
    assert 0.01 < float(mask.float().mean()) < 0.15


def test_a_wire_crosses_the_image_from_border_to_border():
    for seed in range(6):
        wire = _metal(DETECTOR, seed, count=1, block=False) > 0
        assert bool(wire.any(0).all()) or bool(wire.any(1).all())


@pytest.mark.parametrize("width_mm", [0.5, 2.0])
@pytest.mark.parametrize("pixel_mm", [0.25, 1.0])
def test_a_wire_is_as_wide_and_heavy_in_mm_whatever_the_pixels(width_mm, pixel_mm):
    """Across a wire the chords of its section add up to its area; the sum over the image grows with its slope."""
    detector = Detector(round(80 / pixel_mm), round(96 / pixel_mm), pixel_mm)
    wire = _metal(detector, 3, count=1, block=False, width_mm=(width_mm, width_mm), metal_per_mm=1.0)
    per_mm_of_image = float(wire.sum()) * pixel_mm**2 / (80 if bool((wire > 0).any(1).all()) else 96)
    area = math.pi * width_mm**2 / 4
    assert area * 0.99 < per_mm_of_image < 1.5 * area
    fine = _metal(Detector(320, 384, 0.25), 3, count=1, block=False, width_mm=(width_mm,) * 2, metal_per_mm=1.0)
    assert float(wire.sum()) * pixel_mm**2 == pytest.approx(float(fine.sum()) * 0.25**2, rel=0.02)
    if width_mm > pixel_mm:
        assert 0.9 * width_mm < float(wire.max()) <= width_mm, "its chord"


def test_the_block_is_dense_small_and_has_smooth_edges():
    for seed in range(6):
        block = _metal(DETECTOR, seed, count=0, block_line_integral=4.0)
        assert float(block.max()) == pytest.approx(4.0)
        assert 6 * 15 * 0.95 < float(block.sum()) / 4 * 1.0**2 < 12 * 30 * 1.05
        assert bool(((block > 0.5) & (block < 3.5)).any())


def test_devices_are_those_of_the_seed():
    assert torch.equal(_metal(DETECTOR, 1), _metal(DETECTOR, 1))
    assert not torch.equal(_metal(DETECTOR, 1), _metal(DETECTOR, 2))


def test_without_devices_nothing_changes():
    image = torch.rand(150, 180, generator=_generator())
    same, mask = add_devices(image, DETECTOR, count=0, block=False, generator=_generator())
    assert torch.equal(same, image)
    assert not bool(mask.any())


@pytest.mark.parametrize("pixel_mm", [0.5, 1.0])
def test_letters_are_as_high_in_mm_whatever_the_pixels(pixel_mm):
    detector = Detector(round(150 / pixel_mm), round(180 / pixel_mm), pixel_mm)
    image = torch.rand(detector.rows, detector.columns, generator=_generator())
    written, mask = add_text(image, detector, text="R", height_mm=20.0, line_integral=7.0)
    rows, columns = (mask.any(dim).nonzero().flatten() for dim in (1, 0))
    assert (int(rows[-1]) - int(rows[0]) + 1) * pixel_mm == pytest.approx(20, abs=pixel_mm)
    assert int(rows[0]) == round(0.06 * detector.rows)
    assert 8 < len(columns) * pixel_mm < 20
    assert set(written[mask].tolist()) == {7.0}
    assert torch.equal(written[~mask], image[~mask])


def test_letters_are_as_bright_as_the_image_gets_and_can_be_read():
    image = torch.rand(150, 180, generator=_generator())
    written, mask = add_text(image, DETECTOR, text="LAT")
    assert set(written[mask].tolist()) == {float(image.max())}
    (left,) = (add_text(image, DETECTOR, text=t)[1] for t in ("L",))
    stem, foot = left.sum(0).max(), left.sum(1).max()
    assert int(stem) == 15, "an L stands upright, its stem on the left"
    assert int(left.sum(0).argmax()) < int(left.any(0).nonzero()[-1])
    assert int(left.sum(1).argmax()) > int(left.any(1).nonzero()[0])
    assert int(foot) > 5


def test_what_cannot_be_written_or_laid_in_is_refused():
    image = torch.zeros(150, 180)
    with pytest.raises(RegtorchError, match="expected letters and a positive height"):
        add_text(image, DETECTOR, text=" ")
    with pytest.raises(RegtorchError, match="expected shares of height and width"):
        add_text(image, DETECTOR, place=(1.0, 0.0))
    with pytest.raises(RegtorchError, match="expected widths over 0"):
        add_devices(image, DETECTOR, width_mm=(0.0, 1.0), generator=_generator())
    with pytest.raises(RegtorchError, match="image of"):
        add_devices(image[1:], DETECTOR, generator=_generator())
