"""Padding and pixels behind a shutter have no weight and do not affect other pixels."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from regtorch.formats import read_radiograph
from tests.imaging.test_field import collimated, torso

File = Callable[..., Path]


def test_shutter_and_padding(radiograph_file: File) -> None:
    edges = {"ShutterUpperHorizontalEdge": 1, "ShutterLowerHorizontalEdge": 6}
    edges |= {"ShutterLeftVerticalEdge": 0, "ShutterRightVerticalEdge": 4}
    path = radiograph_file(ShutterShape="RECTANGULAR", PixelPaddingValue=500, PatientOrientation=["L", "F"], **edges)
    expected = torch.zeros(6, 4)
    expected[1:5, :3] = 1
    expected[1, 1] = 0  # the padded one
    torch.testing.assert_close(read_radiograph(path, view="AP").weight, expected)
    torch.testing.assert_close(read_radiograph(path, view="PA").weight, expected.flip(1))


@pytest.mark.parametrize(
    ("shape", "tags", "inside", "outside"),
    [
        ("CIRCULAR", {"CenterOfCircularShutter": [51, 41], "RadiusOfCircularShutter": 30}, (50, 69), (50, 72)),
        ("POLYGONAL", {"VerticesOfThePolygonalShutter": [11, 11, 11, 71, 91, 71, 91, 11]}, (89, 69), (92, 40)),
    ],
)
def test_shutters_of_other_shapes(radiograph_file: File, shape: str, tags: dict, inside: tuple, outside: tuple) -> None:
    """Shuttered pixels at (row, column) from 0; their values do not make other pixels darker."""
    stored = np.arange(8000, dtype=np.uint16).reshape(100, 80) + 1000
    path = radiograph_file(stored, ShutterShape=shape, PixelIntensityRelationship="LIN", **tags)
    radiograph = read_radiograph(path, view="PA")
    assert radiograph.weight[inside] == 1
    assert radiograph.weight[outside] == 0
    covered = stored.copy()
    covered[radiograph.weight.numpy() == 0] = 0
    path = radiograph_file(covered, ShutterShape=shape, PixelIntensityRelationship="LIN", **tags)
    again = read_radiograph(path, view="PA")
    torch.testing.assert_close(again.image, radiograph.image)
    torch.testing.assert_close(again.weight, radiograph.weight)
    path = radiograph_file(stored, ShutterShape=["RECTANGULAR", shape], **tags)
    assert any("RECTANGULAR shutter is not understood" in line for line in read_radiograph(path, view="PA").warnings)


def test_padding_hides_no_collimator(radiograph_file: File) -> None:
    """Padding does not use up the grey range."""
    image = collimated(torso(), (40, 400, 0, 360), 6.5)
    stored = (1000 + 3000 * (image - image.min()) / (image.max() - image.min())).numpy().astype(np.uint16)
    whole = read_radiograph(radiograph_file(stored), view="PA")
    assert float(whole.weight[:40].max()) == 0
    stored[-8:], stored[200:220, :60] = 65535, 65535
    padded = read_radiograph(radiograph_file(stored, PixelPaddingValue=65535), view="PA")
    used = padded.weight > 0
    assert not bool(used[-8:].any() or used[200:220, :60].any())
    assert abs(int(used.any(1).nonzero()[0]) - int((whole.weight > 0).any(1).nonzero()[0])) <= 1
    torch.testing.assert_close(padded.image[used], whole.image[used], atol=0.02, rtol=0)
