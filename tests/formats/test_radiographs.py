"""Radiographs from DICOM, PNG and TIFF: turned, bone bright, of a known pixel size; or refused."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile
import torch
from PIL import Image

from regtorch.errors import RegtorchError
from regtorch.formats import read_radiograph, write_radiograph
from regtorch.geometry import Detector
from regtorch.imaging import check_radiograph

File = Callable[..., Path]
RAMP = np.arange(24, dtype=np.float32).reshape(6, 4) / 23


def test_dicom_as_seen_from_the_source(radiograph_file: File) -> None:
    radiograph = read_radiograph(radiograph_file(DistanceSourceToDetector=1800), view="PA")
    torch.testing.assert_close(radiograph.image, torch.from_numpy(RAMP))
    assert radiograph.detector == Detector(6, 4, 0.2)
    assert radiograph.sdd_mm == 1800
    assert radiograph.name == "radiograph.dcm"
    assert radiograph.warnings == ()
    assert not radiograph.mirrored
    assert bool((radiograph.weight == 1).all())


def test_dicom_shown_as_if_facing_the_patient(radiograph_file: File) -> None:
    radiograph = read_radiograph(radiograph_file(PatientOrientation=["L", "F"]), view="PA")
    assert radiograph.mirrored
    torch.testing.assert_close(radiograph.image, torch.from_numpy(RAMP).flip(1))
    assert (radiograph.stored_from_pixel @ torch.tensor([0.0, 2, 1]).double()).tolist() == [3, 2, 1]
    assert not read_radiograph(radiograph_file(PatientOrientation=["L", "F"]), view="AP").mirrored
    assert not read_radiograph(radiograph_file(PatientOrientation=["L", "F"]), view="PA", mirrored=False).mirrored


# PhotometricInterpretation, relationship, sign, intent: is bone where values are high, and was a logarithm taken?
MEANINGS = [
    ("MONOCHROME2", None, None, None, True, False),
    ("MONOCHROME1", None, None, None, False, False),
    ("MONOCHROME2", "LIN", 1, "FOR PROCESSING", False, True),
    ("MONOCHROME1", "LIN", 1, "FOR PROCESSING", False, True),
    ("MONOCHROME2", "LIN", -1, "FOR PROCESSING", True, True),
    ("MONOCHROME2", "LOG", -1, "FOR PROCESSING", True, False),
    ("MONOCHROME1", "LOG", 1, "FOR PROCESSING", False, False),
    ("MONOCHROME1", "LOG", -1, "FOR PROCESSING", True, False),
    ("MONOCHROME2", "LIN", None, None, False, True),
    ("MONOCHROME2", "LOG", None, None, False, False),
    ("MONOCHROME2", "DISP", None, None, True, False),
    ("MONOCHROME2", "LOG", -1, "FOR PRESENTATION", True, False),
    ("MONOCHROME1", "LIN", 1, "FOR PRESENTATION", False, False),
]


@pytest.mark.parametrize(("photometric", "relation", "sign", "intent", "high", "logarithm"), MEANINGS)
def test_what_values_mean(
    radiograph_file: File,
    photometric: str,
    relation: str | None,
    sign: int | None,
    intent: str | None,
    high: bool,
    logarithm: bool,
) -> None:
    tags = {
        "PixelIntensityRelationship": relation,
        "PixelIntensityRelationshipSign": sign,
        "PresentationIntentType": intent,
    }
    stated = {key: value for key, value in tags.items() if value is not None}
    stored = np.arange(1, 25, dtype=np.uint16).reshape(6, 4) * 2000
    path = radiograph_file(stored, PhotometricInterpretation=photometric, **stated)
    image = read_radiograph(path, view="PA").image.flatten()
    assert bool((image.diff() > 0).all() if high else (image.diff() < 0).all())
    steps = image.diff().abs()
    assert (float(steps.max() / steps.min()) > 1.05) == logarithm


def test_negative_rescaling_turns_the_image(radiograph_file: File) -> None:
    path = radiograph_file(RescaleSlope=-1, RescaleIntercept=4095)
    torch.testing.assert_close(read_radiograph(path, view="PA").image, torch.from_numpy(1 - RAMP))


def test_counts_become_line_integrals(tmp_path: Path) -> None:
    lines = torch.linspace(0, 6, 3000).reshape(50, 60)
    Image.fromarray(np.round(60000 * torch.exp(-lines).numpy()).astype(np.uint16)).save(tmp_path / "counts.png")
    radiograph = read_radiograph(tmp_path / "counts.png", view="AP", pixel_mm=1.0, intensity="counts")
    torch.testing.assert_close(radiograph.image - radiograph.image[0, 0], lines, atol=0.01, rtol=0)
    Image.fromarray(np.zeros((50, 60), np.uint16)).save(tmp_path / "dark.png")
    with pytest.raises(RegtorchError, match=r"dark.png: no pixel above 0"):
        read_radiograph(tmp_path / "dark.png", view="AP", pixel_mm=1.0, intensity="counts")
    counts = np.full((50, 60), 1000, np.uint16)
    counts[3, 4] = 0
    Image.fromarray(counts).save(tmp_path / "dead.png")
    image = read_radiograph(tmp_path / "dead.png", view="AP", pixel_mm=1.0, intensity="counts").image
    assert float(image[3, 4] - image[0, 0]) == pytest.approx(np.log(2), abs=1e-3)


PIXELS = [
    ({"ImagerPixelSpacing": [0.15, 0.15], "PixelSpacing": [0.12, 0.12]}, 0.15, "PixelSpacing of 0.12 mm is not Imager"),
    ({"ImagerPixelSpacing": [0.15, 0.15], "PixelSpacing": [0.15, 0.15]}, 0.15, None),
    ({"ImagerPixelSpacing": None, "PixelSpacing": [0.12, 0.12]}, 0.12, None),
    ({"ImagerPixelSpacing": None, "PixelSpacing": [0, 0], "NominalScannedPixelSpacing": [0.3, 0.3]}, 0.3, "no size"),
    (
        {"ImagerPixelSpacing": None, "PixelSpacing": [0.12, 0.12], "Modality": "XA"},
        0.12,
        "calibrated within the patient",
    ),
    ({"ImagerPixelSpacing": [0.2, 0.2005]}, 0.20025, None),
]


@pytest.mark.parametrize(("tags", "pixel_mm", "warning"), PIXELS)
def test_pixel_size(radiograph_file: File, tags: dict, pixel_mm: float, warning: str | None) -> None:
    radiograph = read_radiograph(radiograph_file(**tags), view="PA")
    assert radiograph.detector.pixel_mm == pytest.approx(pixel_mm)
    assert warning is None or any(warning in w for w in radiograph.warnings)
    assert warning is not None or radiograph.warnings == ()
    assert read_radiograph(radiograph_file(**tags), view="PA", pixel_mm=0.4).detector.pixel_mm == 0.4


@pytest.mark.parametrize(("stated", "sdd_mm", "warns"), [(1500, 1500, False), (0, None, False), (12, None, True)])
def test_sdd(radiograph_file: File, stated: float, sdd_mm: float | None, warns: bool) -> None:
    radiograph = read_radiograph(radiograph_file(DistanceSourceToDetector=stated), view="PA")
    assert radiograph.sdd_mm == sdd_mm
    assert bool(radiograph.warnings) == warns
    assert any("SDD" in line for line in check_radiograph(radiograph)) == (sdd_mm is None)


def test_what_reading_finds(radiograph_file: File) -> None:
    path = radiograph_file(Modality="OT", PatientOrientation=None, ViewPosition="AP")
    found = read_radiograph(path, view="PA").warnings
    assert len(found) == 3
    for line in ("Modality is OT", "ViewPosition is AP, but it is read as PA", "PatientOrientation is absent"):
        assert any(w.startswith(line) for w in found)


def test_an_sdd_that_is_no_number_is_told_of(radiograph_file: File) -> None:
    path = radiograph_file(DistanceSourceToDetector=1800.5)
    path.write_bytes(path.read_bytes().replace(b"1800.5", b"180 cm"))
    radiograph = read_radiograph(path, view="PA")
    assert radiograph.sdd_mm is None
    assert "DistanceSourceToDetector is 180 cm, which is no number" in radiograph.warnings


REFUSALS = {
    "3 frames, expected a single": {"NumberOfFrames": 3},
    "PhotometricInterpretation RGB, 3 channel": {"SamplesPerPixel": 3, "PhotometricInterpretation": "RGB"},
    "PALETTE COLOR": {"PhotometricInterpretation": "PALETTE COLOR"},
    "Modality CT, expected a radiograph": {"Modality": "CT"},
    "no pixel size in the file, expected the detector's by --pixel-mm": {"ImagerPixelSpacing": None},
    "no size.*--pixel-mm": {"ImagerPixelSpacing": None, "PixelSpacing": [0, 0]},
    "0.2 x 0.3 mm is oblong": {"ImagerPixelSpacing": [0.2, 0.3]},
    "PixelAspectRatio 2/1 is oblong": {"ImagerPixelSpacing": None, "PixelAspectRatio": [2, 1]},
    "pixels cannot be decoded": {"PixelData": b"1234"},
    "a DICOM file without an image": {"Rows": None},
}


@pytest.mark.parametrize("message", REFUSALS)
def test_refused_dicom(radiograph_file: File, message: str, capfd: pytest.CaptureFixture[str]) -> None:
    path = radiograph_file(**REFUSALS[message])
    with pytest.raises(RegtorchError, match=message) as refusal:
        read_radiograph(path, view="PA")
    assert str(refusal.value).startswith(f"{path}: ")
    assert "\n" not in str(refusal.value)
    assert capfd.readouterr().err == ""


def test_refused_arguments(radiograph_file: File, tmp_path: Path) -> None:
    path = radiograph_file()
    for message, options in {
        "unknown view 'XX'": {"view": "XX"},
        "pixel size of -1.0 mm": {"view": "PA", "pixel_mm": -1.0},
        "intensity 'raw': expected one of auto, line, counts": {"view": "PA", "intensity": "raw"},
    }.items():
        with pytest.raises(RegtorchError, match=message):
            read_radiograph(path, **options)
    with pytest.raises(RegtorchError, match="no such file"):
        read_radiograph(tmp_path / "nothing.png", view="PA")
    with pytest.raises(RegtorchError, match="a folder, expected"):
        read_radiograph(tmp_path, view="PA")


def refused_images(folder: Path) -> dict[str, Path]:
    grey = np.zeros((5, 6), np.uint16)
    Image.fromarray(np.zeros((5, 6, 3), np.uint8)).save(folder / "colour.png")
    tifffile.imwrite(folder / "colour.tiff", np.zeros((5, 6, 3), np.uint8), photometric="rgb")
    tifffile.imwrite(folder / "stack.tiff", np.zeros((3, 5, 6), np.uint16), photometric="minisblack")
    tifffile.imwrite(folder / "nan.tiff", np.full((5, 6), np.nan, np.float32))
    Image.fromarray(grey).save(folder / "whole.png")
    (folder / "cut.png").write_bytes((folder / "whole.png").read_bytes()[:-30])
    (folder / "text.tiff").write_text("not an image")
    (folder / "text.jpg").write_text("not an image")
    return {
        "RGB image": folder / "colour.png",
        "colour image": folder / "colour.tiff",
        "3 images in one file": folder / "stack.tiff",
        "NaN or infinite": folder / "nan.tiff",
        "expected a whole png": folder / "cut.png",
        "expected a whole tiff": folder / "text.tiff",
        "expected DICOM, PNG or TIFF": folder / "text.jpg",
    }


def test_refused_images(tmp_path: Path) -> None:
    for message, path in refused_images(tmp_path).items():
        with pytest.raises(RegtorchError, match=message) as refusal:
            read_radiograph(path, view="PA", pixel_mm=1.0)
        assert str(refusal.value).startswith(f"{path}: ")


def test_resolution_tags_of_foreign_files_are_not_trusted(tmp_path: Path) -> None:
    stored = (np.arange(30, dtype=np.uint16) * 1000).reshape(5, 6)
    Image.fromarray(stored).save(tmp_path / "dpi.png", dpi=(300, 300))
    tifffile.imwrite(tmp_path / "dpi.tiff", stored, resolution=(300, 300), description='{"other": 1}')
    for path in (tmp_path / "dpi.png", tmp_path / "dpi.tiff"):
        with pytest.raises(RegtorchError, match="--pixel-mm"):
            read_radiograph(path, view="PA")
        radiograph = read_radiograph(path, view="PA", pixel_mm=0.5, mirrored=True)
        torch.testing.assert_close(radiograph.image, torch.arange(30.0).reshape(5, 6).flip(1) / 29)


def test_white_is_zero_tiff(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "a.tiff", np.arange(30, dtype=np.uint16).reshape(5, 6), photometric="miniswhite")
    image = read_radiograph(tmp_path / "a.tiff", view="PA", pixel_mm=1.0).image
    torch.testing.assert_close(image, 1 - torch.arange(30.0).reshape(5, 6) / 29)


def test_other_tiffs(tmp_path: Path) -> None:
    signed = np.linspace(-32000, 32000, 30).astype(np.int16).reshape(5, 6)
    tifffile.imwrite(tmp_path / "signed.tiff", signed, photometric="miniswhite")
    image = read_radiograph(tmp_path / "signed.tiff", view="PA", pixel_mm=1.0).image
    torch.testing.assert_close(image, 1 - torch.arange(30.0).reshape(5, 6) / 29, atol=1e-4, rtol=0)
    colours = np.repeat(np.arange(65535, -1, -257, dtype=np.uint16)[None], 3, axis=0)
    tifffile.imwrite(tmp_path / "map.tiff", np.ones((5, 6), np.uint8), photometric="palette", colormap=colours)
    with pytest.raises(RegtorchError, match="PALETTE image, expected one grey channel"):
        read_radiograph(tmp_path / "map.tiff", view="PA", pixel_mm=1.0)
    tag = (274, "H", 1, 6, True)
    tifffile.imwrite(tmp_path / "side.tiff", signed.astype(np.uint16), photometric="minisblack", extratags=[tag])
    (warning,) = read_radiograph(tmp_path / "side.tiff", view="PA", pixel_mm=1.0).warnings
    assert "Orientation tag of 6" in warning
    tifffile.imwrite(tmp_path / "huge.tiff", np.full((5, 6), 1e39))
    with pytest.raises(RegtorchError, match=r"NaN or infinite \(beyond 3e38\)"):
        read_radiograph(tmp_path / "huge.tiff", view="PA", pixel_mm=1.0)


def test_masks(radiograph_file: File, tmp_path: Path) -> None:
    """A mask has the file's own orientation."""
    path = radiograph_file(PatientOrientation=["L", "F"])
    mask = torch.ones(6, 4, dtype=torch.bool)
    mask[0, 1] = False
    expected = mask.flip(1).float()
    grey = np.where(mask.numpy(), 255, 0).astype(np.uint8)
    Image.fromarray(grey).save(tmp_path / "mask.png")
    Image.fromarray(grey // 255).save(tmp_path / "ones.png")
    Image.fromarray(mask.numpy()).save(tmp_path / "bits.png")
    tifffile.imwrite(tmp_path / "bits.tiff", ~mask.numpy(), photometric="miniswhite")
    tifffile.imwrite(tmp_path / "mask.tiff", mask.numpy().astype(np.float32))
    for given in (
        mask,
        mask.float(),
        mask.int() * 255,
        tmp_path / "mask.png",
        tmp_path / "ones.png",
        tmp_path / "bits.png",
        tmp_path / "bits.tiff",
        tmp_path / "mask.tiff",
    ):
        torch.testing.assert_close(read_radiograph(path, view="PA", mask=given).weight, expected)
    with pytest.raises(RegtorchError, match="mask of 4 x 6 pixels, expected 6 x 4 as stored"):
        read_radiograph(path, view="PA", mask=mask.mT)
    with pytest.raises(RegtorchError, match="every pixel is masked"):
        read_radiograph(path, view="PA", mask=torch.zeros(6, 4))
    with pytest.raises(RegtorchError, match="no such file, expected a PNG"):
        read_radiograph(path, view="PA", mask=tmp_path / "nothing.png")


@pytest.mark.parametrize("suffix", ["tiff", "tif", "png", "dcm"])
@pytest.mark.parametrize("view", ["PA", "AP", "LAT", "RLAT", None])
def test_round_trip(tmp_path: Path, suffix: str, view: str | None) -> None:
    lines = 7 * torch.rand(41, 30, generator=torch.Generator().manual_seed(0)) + 3
    paths = tmp_path / f"a.{suffix}", tmp_path / f"b.{suffix}"
    for path in paths:
        write_radiograph(path, lines, Detector(41, 30, 0.1 / 3), sdd_mm=1234.5, view=view)
    assert paths[0].read_bytes() == paths[1].read_bytes()
    assert len(list(tmp_path.iterdir())) == 2
    radiograph = read_radiograph(str(paths[0]), view=view or "PA")
    low, span = lines.min(), lines.max() - lines.min()
    torch.testing.assert_close(radiograph.image, (lines - low) / span, atol=1 / 65535, rtol=0)
    assert radiograph.detector.pixel_mm == pytest.approx(0.1 / 3, rel=1e-9)
    assert radiograph.sdd_mm == 1234.5
    assert not radiograph.mirrored
    assert bool(radiograph.warnings) == (suffix == "dcm" and view is None)


def test_metadata_of_a_written_file(tmp_path: Path) -> None:
    write_radiograph(tmp_path / "a.tiff", torch.rand(5, 6), Detector(5, 6, 0.5), view="PA")
    with tifffile.TiffFile(tmp_path / "a.tiff") as file:
        assert json.loads(file.pages[0].description) == {"pixel_mm": 0.5, "view": "PA"}
    assert read_radiograph(tmp_path / "a.tiff", view="AP").warnings == ("written as a PA view, but it is read as AP",)
    assert read_radiograph(tmp_path / "a.tiff", view="PA", pixel_mm=0.7).detector.pixel_mm == 0.7


def test_refused_writing(tmp_path: Path) -> None:
    image = torch.rand(5, 6)
    for message, arguments in {
        "expected .tiff, .png or .dcm": (tmp_path / "a.jpg", image, Detector(5, 6, 1.0)),
        "expected 6 x 5": (tmp_path / "a.png", image, Detector(6, 5, 1.0)),
        "expected a whole one": (tmp_path / "a.png", image, Detector(5, 6, 1.0, (1.0, 0.0))),
        "NaN or infinite": (tmp_path / "a.png", image / 0, Detector(5, 6, 1.0)),
        "No such file or directory": (tmp_path / "nowhere" / "a.tiff", image, Detector(5, 6, 1.0)),
    }.items():
        with pytest.raises(RegtorchError, match=message):
            write_radiograph(*arguments)
    assert list(tmp_path.iterdir()) == []


def test_constant_image_is_written(tmp_path: Path) -> None:
    write_radiograph(tmp_path / "a.dcm", torch.ones(5, 6), Detector(5, 6, 1.0), view="PA")
    assert float(read_radiograph(tmp_path / "a.dcm", view="PA").image.abs().max()) == 0
