"""A DICOM folder is read exactly or refused with a sentence."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from pydicom.dataset import Dataset

from regtorch.errors import RegtorchError
from regtorch.formats import read_volume

from .conftest import save

Slices = Callable[..., Dataset]


def write(folder: Path, slices: list[Dataset]) -> Path:
    folder.mkdir(exist_ok=True)
    for number, dataset in enumerate(slices):
        save(dataset, folder / f"{number}.dcm")
    return folder


def test_place_and_values_whatever_the_order_of_the_files(tmp_path: Path, ct_slice: Slices) -> None:
    folder = write(tmp_path / "ct", [ct_slice(k) for k in (2, 0, 3, 1)])
    (folder / "notes.txt").write_text("not DICOM")
    volume = read_volume(folder)
    assert volume.data.shape == (4, 4, 5)
    assert volume.data.dtype == torch.float32
    assert volume.unit == "HU"
    torch.testing.assert_close(volume.data[:, 0, 0], torch.tensor([-1024.0, -924, -824, -724]))
    expected = [[0.5, 0, 0, -10], [0, 0.8, 0, -20], [0, 0, 2, 30], [0, 0, 0, 1]]
    torch.testing.assert_close(volume.patient_from_voxel, torch.tensor(expected, dtype=torch.float64))
    torch.testing.assert_close(volume.origin_patient_mm, torch.tensor([-9.0, -18.8, 33.0], dtype=torch.float64))


def test_coronal_slices(tmp_path: Path, ct_slice: Slices) -> None:
    """Rows to the left, columns downwards: slices are ordered to posterior, right-handed."""
    cosines = [1, 0, 0, 0, 0, -1]
    made = [ct_slice(k, ImageOrientationPatient=cosines, ImagePositionPatient=[0, 3 - 2 * k, 5]) for k in range(3)]
    volume = read_volume(write(tmp_path / "ct", made))
    expected = [[0.5, 0, 0, 0], [0, 0, 2, -1], [0, -0.8, 0, 5], [0, 0, 0, 1]]
    torch.testing.assert_close(volume.patient_from_voxel, torch.tensor(expected, dtype=torch.float64))
    assert float(volume.data[0, 0, 0]) == -824


def test_each_slice_has_its_own_rescaling(tmp_path: Path, ct_slice: Slices) -> None:
    made = [ct_slice(0), ct_slice(1, RescaleSlope=2, RescaleIntercept=-1000)]
    assert read_volume(write(tmp_path / "ct", made)).data[:, 0, 0].tolist() == [-1024, -800]


def test_positions_rounded_to_a_tenth_are_even(tmp_path: Path, ct_slice: Slices) -> None:
    made = [ct_slice(k, ImagePositionPatient=[0, 0, round(0.625 * k, 1)]) for k in range(17)]
    assert float(read_volume(write(tmp_path / "ct", made)).spacing_mm[2]) == pytest.approx(0.625)


def shifted(ct_slice: Slices, heights: list[float], lean: float = 0) -> list[Dataset]:
    return [ct_slice(k, ImagePositionPatient=[0, lean * z, z]) for k, z in enumerate(heights)]


REFUSALS = {
    "2 series.*'1 series 1' \\(2 images, 1.2.3.1\\); '2 series 2' \\(1 images": lambda s: [s(0), s(1), s(0, "2")],
    "1 slice.*missing between 1.dcm and 2.dcm .at 2.00 and 6.00 mm.*one every 2.00": lambda s: shifted(
        s, [0, 2, 6, 8, 10]
    ),
    "2.70 mm between 2.dcm and 3.dcm.*expected 2.00 mm": lambda s: shifted(s, [0, 2, 4, 6.7, 8.7, 10.7]),
    "slice spacing changes along the stack": lambda s: shifted(s, [2 * k + 0.002 * k * k for k in range(24)]),
    "gantry tilt of 5.7 degrees": lambda s: shifted(s, [0, 2, 4, 6], lean=0.1),
    "0.dcm and 1.dcm both lie at 2.00 mm": lambda s: shifted(s, [2, 2, 4, 6]),
    "1.dcm and 0.dcm have \\(5, 4\\) and \\(4, 5\\) pixels": lambda s: [s(0), s(1, Rows=5, Columns=4)],
    "PixelSpacing \\(0.8, 0.6\\) and": lambda s: [s(0), s(1, PixelSpacing=[0.8, 0.6])],
    "lie at an angle": lambda s: [s(0), s(1, ImageOrientationPatient=[0.8, 0.6, 0, -0.6, 0.8, 0])],
    "ImagePositionPatient is absent, expected 3 numbers": lambda s: [s(0), s(1, ImagePositionPatient=None)],
    "ImageOrientationPatient is absent": lambda s: [s(0, ImageOrientationPatient=None), s(1)],
    "two unit vectors": lambda s: [s(0, ImageOrientationPatient=[1, 0, 0, 1, 0, 0]), s(1)],
    "PixelSpacing is .*expected positive": lambda s: [s(0, PixelSpacing=[0, 0]), s(1)],
    "Modality MR, expected CT": lambda s: [s(0, Modality="MR"), s(1, Modality="MR")],
    "30 frames in one file": lambda s: [s(0, NumberOfFrames=30)],
    "colour image": lambda s: [s(0, SamplesPerPixel=3), s(1)],
    "one slice only": lambda s: [s(0)],
    "pixels cannot be decoded": lambda s: [s(0), s(1, PixelData=b"1234")],
}


@pytest.mark.parametrize("message", REFUSALS)
def test_refusals(tmp_path: Path, ct_slice: Slices, message: str, capfd: pytest.CaptureFixture[str]) -> None:
    folder = write(tmp_path / "ct", REFUSALS[message](ct_slice))
    with pytest.raises(RegtorchError, match=message) as refusal:
        read_volume(folder)
    assert str(folder) in str(refusal.value)
    assert "\n" not in str(refusal.value)
    assert capfd.readouterr().err == ""


def test_padding_denser_than_bone_is_air(tmp_path: Path, ct_slice: Slices) -> None:
    """Padding of -2000 stored as an unsigned number becomes air; padding with the value of air or water stays."""
    stored = np.arange(20, dtype=np.uint16).reshape(4, 5)
    stored[0, :2] = 63536
    for padding, vr in ((63536, "US"), (-2000, "SS")):
        slices = [ct_slice(k, PixelData=stored.tobytes(), PixelRepresentation=0) for k in range(2)]
        for each in slices:
            each.add_new("PixelPaddingValue", vr, padding)
        folder = write(tmp_path / vr, slices)
        hu = read_volume(folder).data[0, 0]
        assert hu[:3].tolist() == [-1024, -1024, 2 - 1024]
    slices = [ct_slice(k, PixelPaddingValue=7) for k in range(2)]
    assert read_volume(write(tmp_path / "seven", slices)).data[0, 1, 2] == 7 - 1024


def test_an_intercept_that_is_no_number_is_not_taken_for_none(tmp_path: Path, ct_slice: Slices) -> None:
    folder = write(tmp_path / "ct", [ct_slice(k) for k in range(2)])
    (folder / "1.dcm").write_bytes((folder / "1.dcm").read_bytes().replace(b"-1024.0", b"-1024,0"))
    with pytest.raises(RegtorchError, match=r"1\.dcm: RescaleIntercept is -1024,0, expected a number"):
        read_volume(folder)


def test_a_slice_that_cannot_be_read_is_not_passed_over(tmp_path: Path, ct_slice: Slices) -> None:
    folder = write(tmp_path / "ct", [ct_slice(k) for k in range(4)])
    (folder / "._0.dcm").write_bytes(b"what another system left")
    (folder / "notes.txt").write_text("of no concern")
    assert read_volume(folder).data.shape[0] == 4
    whole = (folder / "3.dcm").read_bytes()
    for broken in (whole[132:], whole[: whole.index(b"US", 400) - 4]):
        (folder / "3.dcm").write_bytes(broken)
        with pytest.raises(RegtorchError, match=r"3\.dcm: cannot be read .*expected a whole CT slice"):
            read_volume(folder)


def test_no_dicom_in_the_folder(tmp_path: Path, ct_slice: Slices) -> None:
    with pytest.raises(RegtorchError, match="no DICOM image in this folder"):
        read_volume(tmp_path)
    write(tmp_path / "series", [ct_slice(0), ct_slice(1)])
    with pytest.raises(RegtorchError, match=r"it holds 1 folder.s.: name the one of the series"):
        read_volume(tmp_path)


def test_one_file_instead_of_the_folder(tmp_path: Path, ct_slice: Slices) -> None:
    folder = write(tmp_path / "ct", [ct_slice(0), ct_slice(1)])
    with pytest.raises(RegtorchError, match=f"a single DICOM file, expected the folder of the whole series: {folder}"):
        read_volume(folder / "0.dcm")


def test_real_slices(data_folder: Path) -> None:
    """GE, padded with -3024 HU, SliceThickness 5 but 4.25 mm apart, files from superior to inferior."""
    volume = read_volume(data_folder / "ct_slices_dicom")
    assert volume.data.shape == (12, 512, 512)
    assert volume.spacing_mm.tolist() == pytest.approx([0.976562, 0.976562, 4.25])
    assert volume.patient_from_voxel[:3, 3].tolist() == pytest.approx([-250, -250, -642.25])
    assert volume.slice_thickness_mm == 5
    assert float(volume.data.min()) == -3024
    assert float(volume.data.max()) == 1254
    assert float(volume.data[:, 0, 0].max()) == -3024
