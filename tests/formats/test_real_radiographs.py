"""The four real radiographs: contents and gaps of their headers, and contents of the images."""

from pathlib import Path

import pytest
import torch

from regtorch.errors import RegtorchError
from regtorch.formats import read_radiograph
from regtorch.imaging import Radiograph, check_radiograph, level


@pytest.fixture(scope="module")
def folder(data_folder: Path) -> Path:
    return data_folder / "radiographs"


def tone(radiograph: Radiograph, row: int, column: int) -> float:
    """Mean of 21 x 21 pixels about a place in the file, in the grey range 0..1."""
    there = torch.linalg.inv(radiograph.stored_from_pixel) @ torch.tensor([column, row, 1], dtype=torch.float64)
    c, r = (round(v) for v in there[:2].tolist())
    return float(radiograph.image[r - 10 : r + 11, c - 10 : c + 11].mean())


def field_in_file(radiograph: Radiograph) -> tuple[int, int, int, int]:
    """First and last + 1 row, first and last + 1 column of the used pixels, in the file."""
    r, c = radiograph.weight.nonzero().mT
    ends = torch.stack([c[[0, -1]], r[[0, -1]], torch.ones(2)]).double()
    columns, rows, _ = (radiograph.stored_from_pixel @ ends).sort(dim=-1).values.round().int().tolist()
    return rows[0], rows[1] + 1, columns[0], columns[1] + 1


def test_chest_needs_its_pixel_size(folder: Path) -> None:
    with pytest.raises(RegtorchError, match=r"chest.*PixelSpacing is 0.000/0.000, which is no size.*--pixel-mm"):
        read_radiograph(folder / "chest_pa_cr_monochrome1.dcm", view="PA")


def test_chest(folder: Path) -> None:
    """MONOCHROME1, lossy JPEG 2000, L\\F: shown as if facing the patient, so mirrored for PA."""
    chest = read_radiograph(folder / "chest_pa_cr_monochrome1.dcm", view="PA", pixel_mm=0.2)
    assert (chest.detector.rows, chest.detector.columns, chest.detector.pixel_mm) == (1955, 1841, 0.2)
    assert chest.sdd_mm == 1996
    assert chest.mirrored
    assert (chest.stored_from_pixel @ torch.tensor([0.0, 0, 1]).double()).tolist() == [1840, 0, 1]
    mediastinum, lung, air = tone(chest, 900, 920), tone(chest, 500, 480), tone(chest, 120, 60)
    assert mediastinum > lung + 0.2
    assert lung > air + 0.2, "beside the neck nothing attenuates"
    assert tone(chest, 1500, 430) > 0.85, "the liver is on the left of the picture, the patient's right"
    # The collimator shows above and on the right; its header has edges in no known unit (-184 to 184, 907 to 1299).
    top, bottom, left, right = field_in_file(chest)
    assert 20 <= top <= 60
    assert 1780 <= right <= 1830
    assert (bottom, left) == (1955, 0)
    assert check_radiograph(chest) == [line for line in check_radiograph(chest) if line.startswith("not logarithmic?")]
    assert len(check_radiograph(chest)) == 1
    counts = read_radiograph(folder / "chest_pa_cr_monochrome1.dcm", view="PA", pixel_mm=0.2, intensity="counts")
    assert check_radiograph(counts) == []


def test_chest_seen_from_in_front_is_not_mirrored(folder: Path) -> None:
    chest = read_radiograph(folder / "chest_pa_cr_monochrome1.dcm", view="AP", pixel_mm=0.2)
    assert not chest.mirrored
    assert chest.warnings == ("ViewPosition is PA, but it is read as AP",)


def test_hip(folder: Path) -> None:
    """MONOCHROME2 at 0.2 mm, no orientation, no SDD; a bright band on either side of the field."""
    hip = read_radiograph(folder / "hip_cr_monochrome2.dcm", view="AP")
    assert (hip.detector.rows, hip.detector.columns, hip.detector.pixel_mm) == (2140, 1760, 0.2)
    assert hip.sdd_mm is None
    assert not hip.mirrored
    femoral_head, muscle, air = tone(hip, 820, 880), tone(hip, 1150, 900), tone(hip, 1800, 800)
    assert femoral_head > muscle + 0.1
    assert muscle > air + 0.1
    top, bottom, left, right = field_in_file(hip)
    assert (top, bottom) == (0, 2140)
    assert 185 <= left <= 225
    assert 1395 <= right <= 1440
    assert [line.split(":")[0] for line in check_radiograph(hip)] == [
        "PatientOrientation is absent",
        "no source-detector distance (SDD) in the file",
    ]


def test_jpeg_ls_and_jpeg_2000_hold_the_same_hip(folder: Path) -> None:
    a, b = (read_radiograph(folder / f"hip_cr_{kind}.dcm", view="AP") for kind in ("monochrome2", "jpegls"))
    assert torch.equal(a.image, b.image)
    assert torch.equal(a.weight, b.weight)
    assert float(level(a, 125).weight.min()) > 0.99, "nothing beyond the collimator is left"


def test_leg(folder: Path) -> None:
    """MONOCHROME1, R\\F with the marker in mirror writing: mirrored for AP. No spacing of any kind."""
    path = folder / "leg_ap_no_spacing_monochrome1.dcm"
    with pytest.raises(RegtorchError, match=r"leg.*no pixel size in the file, expected the detector's by --pixel-mm"):
        read_radiograph(path, view="AP")
    leg = read_radiograph(path, view="AP", pixel_mm=0.2)
    assert (leg.detector.rows, leg.detector.columns) == (1760, 1760)
    assert leg.mirrored
    assert leg.sdd_mm is None
    tibia, muscle, air = tone(leg, 700, 895), tone(leg, 700, 740), tone(leg, 1200, 520)
    assert tibia > muscle + 0.05
    assert muscle > air + 0.2
    top, bottom, left, right = field_in_file(leg)
    assert (top, bottom) == (0, 1760)
    assert 440 <= left <= 500
    assert 1200 <= right <= 1250
