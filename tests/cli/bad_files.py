"""Files that are not what a command expects."""

import json
from pathlib import Path

import numpy as np
import SimpleITK
import tifffile
from PIL import Image
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import ComputedRadiographyImageStorage, CTImageStorage, ExplicitVRLittleEndian


def bad_volumes(folder: Path) -> None:
    (folder / "empty").mkdir()
    (folder / "nothing.nii.gz").write_bytes(b"")
    (folder / "cut.nii.gz").write_bytes((folder / "ct.nii.gz").read_bytes()[:5000])
    image = SimpleITK.ReadImage(str(folder / "ct.nii.gz"))
    soft = image * 0 - 500
    SimpleITK.WriteImage(soft, str(folder / "soft.mha"))
    for suffix in ("nii.gz", "mha"):
        image[3, 4, 5] = float("nan")
        SimpleITK.WriteImage(image, str(folder / f"nan.{suffix}"))
    heights = {
        "gap": [0, 2, 4, 8, 10],
        "uneven": [0, 2, 4, 6.6, 8.6],
        "twice": [0, 2, 2, 4, 6],
        "two_series": [0, 2, 4, 6, 8],
    }
    for name, at in heights.items():
        (folder / name).mkdir()
        for number, z in enumerate(at):
            _dicom_slice(folder / name / f"{number}.dcm", z, f"1.2.{int(name == 'two_series' and number > 2)}")


def _dicom_slice(path: Path, z: float, series: str) -> None:
    d = Dataset()
    d.SOPClassUID, d.SOPInstanceUID, d.SeriesInstanceUID = CTImageStorage, f"1.2.3.{z}", series
    d.Modality, d.ImageOrientationPatient, d.ImagePositionPatient = "CT", [1, 0, 0, 0, 1, 0], [0, 0, z]
    d.PixelSpacing, d.RescaleSlope, d.RescaleIntercept = [1, 1], 1, -1024
    _save(d, path, np.full((6, 6), 1500, np.uint16))


def _save(d: Dataset, path: Path, stored: np.ndarray, **changes: object) -> None:
    d.Rows, d.Columns = stored.shape[-2:]
    d.SamplesPerPixel, d.PhotometricInterpretation = 1, "MONOCHROME2"
    d.BitsAllocated, d.BitsStored, d.HighBit, d.PixelRepresentation = 16, 16, 15, 0
    d.PixelData = stored.tobytes()
    for keyword, value in changes.items():
        setattr(d, keyword, value)
    d.file_meta = FileMetaDataset()
    d.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    d.save_as(path, enforce_file_format=True)


def bad_radiographs(folder: Path) -> None:
    good = tifffile.imread(folder / "good" / "radiograph.tiff")
    tifffile.imwrite(folder / "unsized.tiff", good)
    Image.fromarray(good).save(folder / "unsized.png")
    (folder / "nothing.tiff").write_bytes(b"")
    (folder / "cut.tiff").write_bytes((folder / "good" / "radiograph.tiff").read_bytes()[:3000])
    tifffile.imwrite(folder / "rgb.tiff", np.zeros((20, 20, 3), np.uint8))
    tifffile.imwrite(folder / "frames.tiff", np.zeros((4, 20, 20), np.uint16), photometric="minisblack")
    tifffile.imwrite(folder / "nan.tiff", np.full((20, 20), np.nan, np.float32))
    tifffile.imwrite(folder / "tiny.tiff", np.arange(42, dtype=np.uint16).reshape(6, 7))
    tifffile.imwrite(folder / "mask_small.tiff", np.ones((10, 10), np.uint8))
    tifffile.imwrite(folder / "mask_none.tiff", np.zeros((100, 80), np.uint8))
    for name, stored, changes in (
        ("unsized.dcm", good, {}),
        ("frames.dcm", np.stack([good, good]), {"NumberOfFrames": 2, "ImagerPixelSpacing": [3.5, 3.5]}),
        ("rgb.dcm", good, {"SamplesPerPixel": 3, "PhotometricInterpretation": "RGB", "ImagerPixelSpacing": [1, 1]}),
        ("zero.dcm", good, {"ImagerPixelSpacing": [0, 0]}),
    ):
        d = Dataset()
        d.SOPClassUID, d.SOPInstanceUID, d.Modality = ComputedRadiographyImageStorage, "1.2.3", "CR"
        _save(d, folder / name, stored, **changes)


def bad_texts(folder: Path, truth: dict) -> None:
    (folder / "a_file").write_text("text")
    (folder / "short.csv").write_text("name,x,y,z\nfirst,1,2,3\nsecond,4,5\n")
    (folder / "words.csv").write_text("first,one,two,three\n")
    (folder / "empty.csv").write_text("")
    (folder / "list.json").write_text("[1, 2]")
    (folder / "cut.json").write_text(json.dumps(truth)[:200])
    (folder / "other.json").write_text('{"patients": []}')
    detector = truth["detector"] | {"rows": 50}
    for name, change in (
        ("ap", {"view": "AP"}),
        ("detector", {"detector": detector}),
        ("unknown_view", {"view": "pa"}),
        ("no_targets", {"targets_patient_mm": {}}),
        ("matrix", {"pixel_from_patient": [[1, 2], [3, 4]]}),
        ("nan", {"parameters": truth["parameters"] | {"x_s_mm": float("nan")}}),
    ):
        (folder / f"truth_{name}.json").write_text(json.dumps(truth | change))
