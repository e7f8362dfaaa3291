"""Processing for presentation: each step alone, the identity, whole numbers and polarity as a file would have them."""

import math

import pytest
import torch
from PIL import Image

from regtorch.errors import RegtorchError
from regtorch.formats import read_radiograph
from regtorch.geometry import Detector
from regtorch.simulation import STRENGTHS, process_for_presentation
from regtorch.simulation.blur import gaussian

DETECTOR = Detector(80, 100, 1.0)
OFF = {"equalisation": 0.0, "edges": 0.0, "gradation": 0.0, "bits": None}


def _image() -> torch.Tensor:
    """A thick and a thin half, with the same weak and strong spots in each."""
    image = torch.full((80, 100), 1.5, dtype=torch.float64)
    image[:, 50:] = 5
    for column in (20, 70):
        image[18:23, column : column + 5] += 0.2
        image[58:63, column : column + 5] += 1.5
    image[:5] = 0
    return gaussian(image, 1.0)


def _contrast(image: torch.Tensor, row: int, column: int) -> float:
    return float(image[row, column] - image[row, column + 15])


def test_nothing_but_gain_and_offset_changes_without_steps():
    image = _image()
    made = process_for_presentation(image, DETECTOR, **OFF)
    torch.testing.assert_close(made, (image - image.min()) / (image.max() - image.min()))
    assert process_for_presentation(image.float(), DETECTOR).dtype == torch.float32


def test_equalisation_lifts_weak_structures_against_strong_ones():
    image = _image()
    made = process_for_presentation(image, DETECTOR, **OFF | {"equalisation": 0.4})
    for column in (22, 72):
        before = _contrast(image, 20, column) / _contrast(image, 60, column)
        assert _contrast(made, 20, column) / _contrast(made, 60, column) > 1.3 * before


def test_edges_overshoot_by_their_gain():
    image = _image()
    plain, sharp = (process_for_presentation(image, DETECTOR, **OFF | {"edges": gain}) for gain in (0.0, 2.0))
    scale = float((sharp - sharp.mean()).std() / (plain - plain.mean()).std())
    assert _contrast(sharp, 20, 22) > 1.2 * scale * _contrast(plain, 20, 22)


def test_gradation_is_a_sigmoid_that_keeps_the_order():
    image = _image()
    made = process_for_presentation(image, DETECTOR, **OFF | {"gradation": 1.6})
    order = image.flatten().argsort()
    assert bool((made.flatten()[order].diff() >= 0).all())
    logits = torch.linspace(-3, 3, 50, dtype=torch.float64)
    ramp = logits.expand(80, 50)
    table = process_for_presentation(ramp, Detector(80, 50, 1.0), **OFF | {"gradation": 1.6})[0]
    slopes = table.diff()
    assert 20 < int(slopes.argmax()) < 40
    assert float(slopes[0] + slopes[-1]) < float(slopes.max())


@pytest.mark.parametrize("bits", [8, 12])
def test_it_is_stored_in_whole_numbers(bits):
    noisy = _image() + 0.1 * torch.randn(80, 100, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    made = process_for_presentation(noisy, DETECTOR, bits=bits)
    steps = made.unique().diff()
    assert len(steps) < 2**bits
    torch.testing.assert_close(steps / steps.min(), (steps / steps.min()).round(), atol=1e-6, rtol=0)


def test_an_inverted_file_is_the_negative():
    bright, dark = (process_for_presentation(_image(), DETECTOR, inverted=inverted) for inverted in (False, True))
    torch.testing.assert_close(dark, 1 - bright, atol=2 / 4095, rtol=0)


@pytest.mark.parametrize("strength", STRENGTHS)
def test_it_is_what_the_reader_hands_over(strength, tmp_path):
    made = process_for_presentation(_image(), DETECTOR, **STRENGTHS[strength])
    highest = 2 ** STRENGTHS[strength]["bits"] - 1
    stored = (made * highest).round().numpy().astype("uint16")
    Image.fromarray(stored).save(tmp_path / "shown.png")
    read = read_radiograph(tmp_path / "shown.png", view="PA", pixel_mm=1.0, mirrored=False)
    torch.testing.assert_close(read.image, made.float(), atol=1 / highest, rtol=0)


def test_the_hard_one_is_further_from_the_log_image():
    image = _image()
    both = (process_for_presentation(image, DETECTOR, **STRENGTHS[name]) for name in ("soft", "hard"))
    soft, hard = (float(torch.corrcoef(torch.stack([made.flatten(), image.flatten()]))[0, 1]) for made in both)
    assert hard < soft < 1


def test_the_same_image_gives_the_same_bits():
    assert torch.equal(*(process_for_presentation(_image(), DETECTOR) for _ in range(2)))


def test_impossible_processing_is_refused():
    image = _image()
    with pytest.raises(RegtorchError, match="expected the first below 1"):
        process_for_presentation(image, DETECTOR, equalisation=1.0)
    with pytest.raises(RegtorchError, match="edges nan"):
        process_for_presentation(image, DETECTOR, edges=math.nan)
    with pytest.raises(RegtorchError, match="17 bits"):
        process_for_presentation(image, DETECTOR, bits=17)
    with pytest.raises(RegtorchError, match="without contrast"):
        process_for_presentation(torch.zeros(80, 100), DETECTOR)
