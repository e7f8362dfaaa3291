"""DICOM files made up by the tests: a small CT series and single radiographs."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import ComputedRadiographyImageStorage, CTImageStorage, ExplicitVRLittleEndian, generate_uid


def save(dataset: Dataset, path: Path) -> Path:
    dataset.file_meta = FileMetaDataset()
    dataset.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    dataset.save_as(path, enforce_file_format=True)
    return path


def pixels(dataset: Dataset, stored: np.ndarray) -> None:
    dataset.Rows, dataset.Columns = stored.shape
    dataset.SamplesPerPixel, dataset.PhotometricInterpretation = 1, "MONOCHROME2"
    dataset.BitsAllocated, dataset.BitsStored, dataset.HighBit = 16, 16, 15
    dataset.PixelRepresentation = int(stored.dtype.kind == "i")
    dataset.PixelData = stored.tobytes()


@pytest.fixture
def ct_slice() -> Callable[..., Dataset]:
    """Slice ``k`` of a 4 x 5 CT with voxels of 0.5 mm along rows, 0.8 mm along columns, 2 mm apart."""

    def make(k: int, series: str = "1", **changes: object) -> Dataset:
        d = Dataset()
        d.SOPClassUID, d.SOPInstanceUID = CTImageStorage, generate_uid(entropy_srcs=[series, str(k)])
        d.SeriesInstanceUID, d.SeriesNumber = f"1.2.3.{series}", series
        d.SeriesDescription = f"series {series}"
        d.Modality, d.SliceThickness = "CT", 2
        d.ImageOrientationPatient, d.ImagePositionPatient = [1, 0, 0, 0, 1, 0], [-10, -20, 30 + 2 * k]
        d.PixelSpacing, d.RescaleSlope, d.RescaleIntercept = [0.8, 0.5], 1, -1024
        pixels(d, np.arange(20, dtype=np.int16).reshape(4, 5) + 100 * k)
        for keyword, value in changes.items():
            if value is None:
                delattr(d, keyword)
            else:
                setattr(d, keyword, value)
        return d

    return make


@pytest.fixture
def radiograph_file(tmp_path: Path) -> Callable[..., Path]:
    """A CR of 6 x 4 pixels whose values grow by row and column: every corner differs."""

    def make(stored: np.ndarray | None = None, **changes: object) -> Path:
        d = Dataset()
        d.SOPClassUID, d.SOPInstanceUID = ComputedRadiographyImageStorage, generate_uid(entropy_srcs=["cr"])
        d.Modality, d.PatientOrientation, d.ImagerPixelSpacing = "CR", ["R", "F"], [0.2, 0.2]
        pixels(d, np.arange(24, dtype=np.uint16).reshape(6, 4) * 100 if stored is None else stored)
        for keyword, value in changes.items():
            if value is None:
                delattr(d, keyword)
            else:
                setattr(d, keyword, value)
        return save(d, tmp_path / "radiograph.dcm")

    return make
