"""NIfTI, NRRD and MHA: round trips in any orientation; broken files are refused."""

from pathlib import Path

import numpy as np
import pytest
import SimpleITK
import torch

from regtorch.errors import RegtorchError
from regtorch.formats import read_volume, write_volume
from regtorch.imaging import Volume, check_volume

SUFFIXES = ["nii", "nii.gz", "nrrd", "mha"]
AXES = {
    "LPS": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "RAS": [[-1, 0, 0], [0, -1, 0], [0, 0, 1]],
    "left-handed": [[1, 0, 0], [0, 1, 0], [0, 0, -1]],
    "sagittal": [[0, 0, 1], [1, 0, 0], [0, -1, 0]],
    "oblique": [[1, 0, 0], [0, 0.8, 0.6], [0, -0.6, 0.8]],
}


def volume_of(axes: list[list[float]]) -> Volume:
    patient_from_voxel = torch.eye(4, dtype=torch.float64)
    patient_from_voxel[:3, :3] = torch.tensor(axes, dtype=torch.float64) * torch.tensor([0.5, 0.75, 2.0])
    patient_from_voxel[:3, 3] = torch.tensor([10.0, -20, 300])
    data = torch.randint(-1024, 2000, (4, 5, 6), generator=torch.Generator().manual_seed(0)).float()
    return Volume.from_grid(data, patient_from_voxel)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("axes", AXES)
def test_round_trip(tmp_path: Path, suffix: str, axes: str) -> None:
    volume, path = volume_of(AXES[axes]), tmp_path / f"ct.{suffix}"
    write_volume(path, volume)
    back = read_volume(str(path))
    torch.testing.assert_close(back.data, volume.data)
    torch.testing.assert_close(back.patient_from_voxel, volume.patient_from_voxel, atol=1e-4, rtol=0)
    torch.testing.assert_close(back.origin_patient_mm, volume.origin_patient_mm, atol=1e-4, rtol=0)
    assert back.name == path.name
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("share", [0.02, 0.5, 0.98])
def test_truncated_file(tmp_path: Path, suffix: str, share: float, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / f"ct.{suffix}"
    write_volume(path, volume_of(AXES["LPS"]).with_data(torch.rand(4, 5, 6)))
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(RegtorchError, match=f"{path}: .*expected a whole"):
        read_volume(path)
    assert capfd.readouterr() == ("", "")


def test_damaged_gzip(tmp_path: Path) -> None:
    path = tmp_path / "ct.nii.gz"
    write_volume(path, volume_of(AXES["LPS"]))
    damaged = bytearray(path.read_bytes())
    damaged[len(damaged) // 2] ^= 0xFF
    path.write_bytes(bytes(damaged))
    with pytest.raises(RegtorchError, match="expected a whole NIfTI"):
        read_volume(path)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_not_an_image(tmp_path: Path, suffix: str, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / f"ct.{suffix}"
    path.write_text("not an image")
    with pytest.raises(RegtorchError, match=str(path)) as refusal:
        read_volume(path)
    assert "\n" not in str(refusal.value)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_not_finite(tmp_path: Path, value: float) -> None:
    volume = volume_of(AXES["LPS"])
    volume.data[1, 2, 3] = value
    write_volume(tmp_path / "ct.nii.gz", volume)
    with pytest.raises(RegtorchError, match="1 voxel\\(s\\) are NaN or infinite"):
        read_volume(tmp_path / "ct.nii.gz")


def test_dimensions_and_channels(tmp_path: Path) -> None:
    arrays = {"4d": (np.zeros((2, 3, 4, 5), np.int16), False), "2d": (np.zeros((4, 5), np.int16), False)}
    arrays["thin"] = (np.zeros((1, 4, 5), np.int16), False)
    for name, (array, vector) in arrays.items():
        path = tmp_path / f"{name}.nrrd"
        SimpleITK.WriteImage(SimpleITK.GetImageFromArray(array, isVector=vector), str(path))
        with pytest.raises(RegtorchError, match="expected a volume with three dimensions"):
            read_volume(path)
    path = tmp_path / "vector.nrrd"
    SimpleITK.WriteImage(SimpleITK.GetImageFromArray(np.zeros((3, 4, 5, 3), np.int16), isVector=True), str(path))
    with pytest.raises(RegtorchError, match="expected one HU value each"):
        read_volume(path)


@pytest.mark.parametrize("suffix", ["nii", "mha"])
def test_sheared_axes(tmp_path: Path, suffix: str, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / f"ct.{suffix}"
    image = SimpleITK.GetImageFromArray(np.zeros((4, 5, 6), np.int16))
    image.SetDirection([1, 0, 0.1, 0, 1, 0, 0, 0, 1])
    SimpleITK.WriteImage(image, str(path))
    if suffix == "nii":  # SimpleITK makes the axes orthogonal when it writes, so the header is edited
        header = bytearray(path.read_bytes())
        header[252:256] = np.array([0, 1], "<i2").tobytes()
        header[280:328] = np.array([[-1, 0, -0.1, 0], [0, -1, 0, 0], [0, 0, 1, 0]], "<f4").tobytes()
        path.write_bytes(bytes(header))
    capfd.readouterr()
    with pytest.raises(RegtorchError, match="not at 90 degrees"):
        read_volume(path)
    assert capfd.readouterr() == ("", "")


def _edited(path: Path, version: int, **fields: np.ndarray) -> Path:
    """A NIfTI file of the same voxels with other values in its header."""
    places = {"pixdim": (80, 108), "qform_code": (252, 344), "sform_code": (254, 348), "sform": (280, 400)}
    header = bytearray(path.read_bytes())
    for name, values in fields.items():
        at = places[name][version - 1]
        header[at : at + values.nbytes] = values.tobytes()
    path.write_bytes(bytes(header))
    return path


@pytest.mark.parametrize("axes", AXES)
def test_a_nifti_that_tells_two_places_is_refused(tmp_path: Path, axes: str) -> None:
    """Other readers differ in their choice between sform and qform."""
    write_volume(path := tmp_path / "ct.nii", volume_of(AXES[axes]))
    sform = np.frombuffer(path.read_bytes(), "<f4", 12, 280).reshape(3, 4).copy()
    both = {"qform_code": np.array(1, "<i2"), "sform_code": np.array(1, "<i2")}
    right = read_volume(_edited(path, 1, **both))
    assert right.warnings == ()
    torch.testing.assert_close(right.patient_from_voxel, volume_of(AXES[axes]).patient_from_voxel, atol=1e-3, rtol=0)
    mirrored = sform * [-1, 1, 1, 1]
    for wrong in (mirrored, sform + [[0, 0, 0, 3]] * 3):
        with pytest.raises(RegtorchError, match=r"ct\.nii: sform and qform put voxels up to [\d.]+ mm apart"):
            read_volume(_edited(path, 1, sform=wrong.astype("<f4")))
    with pytest.raises(RegtorchError, match=r"voxels of 0\.5 x 0\.75 x 2 and 1 x 1\.5 x 4 mm by pixdim and by sform"):
        read_volume(_edited(path, 1, sform=(2 * sform).astype("<f4"), qform_code=np.array(0, "<i2")))
    neither = {"qform_code": np.array(0, "<i2"), "sform_code": np.array(0, "<i2")}
    (warning,) = read_volume(_edited(path, 1, **neither)).warnings
    assert "no orientation is stated" in warning
    with pytest.raises(RegtorchError, match=r"\(pixdim\) \[0\.5, 0\.0, 2\.0\] mm, expected three positive"):
        read_volume(_edited(path, 1, pixdim=np.array([0.5, 0, 2], "<f4")))


def test_an_nrrd_without_a_space_is_told_of(tmp_path: Path) -> None:
    write_volume(path := tmp_path / "ct.nrrd", volume_of(AXES["LPS"]))
    assert read_volume(path).warnings == ()
    header, _, voxels = path.read_bytes().partition(b"\n\n")
    lines = [line for line in header.split(b"\n") if not line.startswith((b"space", b"kinds"))]
    lines.insert(-1, b"spacings: 0.5 0.75 2")
    path.write_bytes(b"\n".join(lines) + b"\n\n" + voxels)
    volume = read_volume(path)
    assert volume.spacing_mm.tolist() == [0.5, 0.75, 2]
    assert "no orientation is stated" in check_volume(volume)[0]


def test_missing_and_unknown(tmp_path: Path) -> None:
    with pytest.raises(RegtorchError, match="no such file or folder"):
        read_volume(tmp_path / "nothing.nii")
    (tmp_path / "ct.txt").write_text("")
    with pytest.raises(RegtorchError, match=r"not a CT, expected a DICOM folder or one of .nii"):
        read_volume(tmp_path / "ct.txt")
    with pytest.raises(RegtorchError, match="cannot write this kind of file"):
        write_volume(tmp_path / "ct.txt", volume_of(AXES["LPS"]))
    with pytest.raises(RegtorchError, match=r"ct\.nii: .*expected a file to write to"):
        write_volume(tmp_path / "nowhere" / "ct.nii", volume_of(AXES["LPS"]))


@pytest.mark.parametrize(
    ("name", "shape", "spacing", "highest"),
    [
        ("acrin_abdomen_pelvis.nii.gz", (99, 316, 424), (0.97656, 0.97656, 4.25), 1288),
        ("totalsegmentator_pelvis_3mm.nii.gz", (112, 101, 122), (3, 3, 3), 3382),
    ],
)
def test_real_files(data_folder: Path, name: str, shape: tuple, spacing: tuple, highest: float) -> None:
    volume = read_volume(data_folder / name)
    assert volume.data.shape == shape
    assert volume.spacing_mm.tolist() == pytest.approx(spacing, abs=1e-5)
    assert float(volume.data.max()) == highest
    assert float(volume.patient_from_voxel[2, 2]) > 0, "slices run to superior"
