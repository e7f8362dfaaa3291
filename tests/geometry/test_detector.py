"""Pixels keep their places in the plane when an image is cropped or made coarser."""

import pytest
import torch

from regtorch.errors import RegtorchError
from regtorch.geometry import Detector, pixel_from_patient, project

from .poses import ORIGIN_MM, random_points, random_poses


def _plane(detector: Detector, column: float, row: float) -> list[float]:
    """(X, Y) in mm of a pixel."""
    pixel = torch.tensor([column, row, 1], dtype=torch.float64)
    return torch.linalg.solve(detector.pixel_from_plane(), pixel)[:2].tolist()


def test_the_middle_of_the_grid_is_its_centre_and_rows_grow_downwards():
    detector = Detector(4, 7, 0.5, centre_mm=(2.0, -3.0))
    assert _plane(detector, 3, 1.5) == pytest.approx([2, -3])
    assert _plane(detector, 4, 1.5) == pytest.approx([2.5, -3])
    assert _plane(detector, 3, 2.5) == pytest.approx([2, -3.5])


@pytest.mark.parametrize("box", [(0, 10, 0, 14), (2, 10, 0, 14), (0, 7, 5, 6), (3, 8, 4, 11)])
def test_a_cropped_detector_keeps_its_pixels_places(box):
    whole = Detector(10, 14, 0.8, centre_mm=(5.0, 1.0))
    row0, row1, column0, column1 = box
    part = whole.crop(*box)
    assert (part.rows, part.columns, part.pixel_mm) == (row1 - row0, column1 - column0, 0.8)
    assert _plane(part, 0, 0) == pytest.approx(_plane(whole, column0, row0))
    assert _plane(part, part.columns - 1, part.rows - 1) == pytest.approx(_plane(whole, column1 - 1, row1 - 1))
    poses, points = random_poses(3), random_points(4)
    moved = torch.tensor([column0, row0], dtype=torch.float64)
    of_whole, of_part = (project(pixel_from_patient(poses, d, "PA", ORIGIN_MM), points) for d in (whole, part))
    torch.testing.assert_close(of_part, of_whole - moved)


@pytest.mark.parametrize(
    ("rows", "columns", "longest"), [(500, 500, 125), (501, 300, 125), (37, 400, 125), (3, 999, 10)]
)
def test_a_coarser_detector_keeps_its_centre_and_all_but_a_pixel_of_its_area(rows, columns, longest):
    whole = Detector(rows, columns, 0.7, centre_mm=(4.0, -9.0))
    coarse = whole.fit(longest)
    assert max(coarse.rows, coarse.columns) == longest
    assert coarse.centre_mm == whole.centre_mm
    for fine, few in ((rows, coarse.rows), (columns, coarse.columns)):
        left_out = fine * whole.pixel_mm - few * coarse.pixel_mm
        assert -1e-6 < left_out < coarse.pixel_mm or few == 1
    middle = ((coarse.columns - 1) / 2, (coarse.rows - 1) / 2)
    assert _plane(coarse, *middle) == pytest.approx([4, -9])


def test_a_detector_is_never_made_finer():
    detector = Detector(60, 100, 0.7)
    assert detector.fit(100) == detector
    assert detector.fit(125) == detector


@pytest.mark.parametrize(("rows", "columns"), [(0, 5), (5, 0), (-1, 5)])
def test_a_detector_without_pixels_is_refused(rows, columns):
    with pytest.raises(RegtorchError, match=f"detector of {rows} x {columns} pixels"):
        Detector(rows, columns, 1.0)


@pytest.mark.parametrize("pixel_mm", [0.0, -0.1, float("nan"), float("inf")])
def test_pixels_without_a_size_are_refused(pixel_mm):
    with pytest.raises(RegtorchError, match=f"detector pixel of {pixel_mm} mm"):
        Detector(5, 5, pixel_mm)
