"""The radiograph's pyramid: places, weights, and the way back to the file's pixels."""

import pytest
import torch

from regtorch.errors import RegtorchError
from regtorch.geometry import Detector, pixel_from_patient, project
from regtorch.imaging import Radiograph, level
from regtorch.imaging.orientation import directions, pixel_axes, turned

PARAMETERS = torch.tensor([5.0, -8, 1000, 10, 4, 200, 0.05, -0.1, 0.02], dtype=torch.float64)
POINTS = torch.tensor([[0.0, 0, 0], [30, -20, 50], [-40, 10, -35]], dtype=torch.float64)


def stored_pixels(radiograph: Radiograph) -> torch.Tensor:
    matrix = pixel_from_patient(PARAMETERS, radiograph.detector, "PA", torch.zeros(3))
    return project(radiograph.stored_from_pixel @ matrix, POINTS)


@pytest.mark.parametrize("longest", [500, 97, 60, 7])
@pytest.mark.parametrize("mirrored", [False, True])
def test_a_point_falls_on_the_same_stored_pixel_at_every_level(longest: int, mirrored: bool) -> None:
    detector = Detector(140, 100, 1.5)
    weight = torch.zeros(140, 100)
    weight[11:130, 7:92] = 1
    stored_from_pixel, _ = pixel_axes(None, "PA", mirrored, 100, 140)
    whole = Radiograph(torch.rand(140, 100), detector, weight, stored_from_pixel)
    part = level(whole, longest)
    assert part.mirrored == mirrored
    assert max(part.image.shape) <= longest
    torch.testing.assert_close(stored_pixels(part), stored_pixels(whole))


def test_averaging_by_weight() -> None:
    image = torch.tensor([[1.0, 2, 100, 4], [3, 4, 100, 100]])
    weight = torch.tensor([[1.0, 1, 0, 1], [1, 1, 0, 0.5]])
    coarse = level(Radiograph.from_image(image, Detector(2, 4, 1.0), weight=weight), 2)
    torch.testing.assert_close(coarse.image, torch.tensor([[2.5, (4 + 50) / 1.5]]))
    torch.testing.assert_close(coarse.weight, torch.tensor([[1.0, 0.375]]))


def test_what_is_masked_leaks_nowhere() -> None:
    generator = torch.Generator().manual_seed(0)
    image, weight = torch.rand(50, 60, generator=generator), torch.ones(50, 60)
    weight[20:33, 30:41] = 0
    weight[:, :4] = 0
    marked = torch.where(weight > 0, image, 1e4)
    a, b = (level(Radiograph.from_image(i, Detector(50, 60, 1.0), weight=weight), 23) for i in (image, marked))
    torch.testing.assert_close(a.image, b.image)
    assert float(a.weight.min()) == 0
    assert float(a.image.max()) <= 1
    assert a.detector.centre_mm[0] == 2, "the cropped columns are gone"


def test_averages_keep_the_digits_of_a_large_offset() -> None:
    image = torch.rand(64, 64, generator=torch.Generator().manual_seed(0))
    a, b = (level(Radiograph.from_image(image + offset, Detector(64, 64, 1.0)), 20).image for offset in (0, 1000))
    torch.testing.assert_close(b - 1000, a, atol=1e-4, rtol=0)


def test_never_finer_and_never_nothing() -> None:
    radiograph = Radiograph.from_image(torch.rand(5, 6), Detector(5, 6, 1.0))
    assert level(radiograph, 500).detector == radiograph.detector
    torch.testing.assert_close(level(radiograph, 500).image, radiograph.image)
    with pytest.raises(RegtorchError, match="every pixel is masked"):
        level(Radiograph.from_image(torch.rand(5, 6), Detector(5, 6, 1.0), weight=torch.zeros(5, 6)), 3)
    with pytest.raises(RegtorchError, match="level of 0 pixels"):
        level(radiograph, 0)
    with pytest.raises(RegtorchError, match="expected the detector's"):
        Radiograph.from_image(torch.rand(5, 6), Detector(6, 5, 1.0))


def test_directions_of_each_view() -> None:
    expected = {"PA": ("R", "F"), "AP": ("L", "F"), "LLAT": ("A", "F"), "LAT": ("A", "F"), "RLAT": ("P", "F")}
    assert {view: directions(view) for view in expected} == expected


OPPOSITE = dict(zip("RLFHAP", "LRHFPA", strict=True))


@pytest.mark.parametrize("view", ["PA", "AP", "LLAT", "RLAT"])
@pytest.mark.parametrize("transposed", [False, True])
@pytest.mark.parametrize("flip_columns", [False, True])
@pytest.mark.parametrize("flip_rows", [False, True])
def test_each_of_the_eight_ways_is_undone(view: str, transposed: bool, flip_columns: bool, flip_rows: bool) -> None:
    wanted = torch.arange(12.0).reshape(3, 4)
    x, y = directions(view)
    stored = wanted.flip([d for d, flip in ((1, flip_columns), (0, flip_rows)) if flip])
    letters = [OPPOSITE[x] if flip_columns else x, OPPOSITE[y] if flip_rows else y]
    if transposed:
        stored, letters = stored.mT, letters[::-1]
    letters = [letters[0] + "X", letters[1]]
    rows, columns = stored.shape
    matrix, complaint = pixel_axes(letters, view, None, columns, rows)
    assert complaint is None
    torch.testing.assert_close(turned(stored, matrix), wanted)
    for row in range(3):
        for column in range(4):
            c, r, _ = (matrix @ torch.tensor([column, row, 1], dtype=torch.float64)).int().tolist()
            assert stored[r, c] == wanted[row, column]
    assert (float(torch.linalg.det(matrix)) < 0) == (transposed ^ flip_columns ^ flip_rows)


@pytest.mark.parametrize("letters", [["A", "F"], ["R", "L"], ["?", "F"], ["F", "H"]])
def test_directions_that_do_not_fit_leave_the_image(letters: list[str]) -> None:
    matrix, complaint = pixel_axes(letters, "PA", None, 4, 3)
    torch.testing.assert_close(matrix, torch.eye(3, dtype=torch.float64))
    assert complaint is not None
    assert "/".join(letters) in complaint
    assert "R/F is seen from the source" in complaint


@pytest.mark.parametrize("letters", [None, ["R", "F"], ["L", "F"], ["F", "R"], ["L", "H"]])
@pytest.mark.parametrize("mirrored", [False, True])
def test_what_one_says_has_the_last_word(letters: list[str] | None, mirrored: bool) -> None:
    matrix, _ = pixel_axes(letters, "PA", mirrored, 4, 3)
    assert (float(torch.linalg.det(matrix)) < 0) == mirrored
