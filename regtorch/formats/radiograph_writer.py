"""``write_radiograph``: 16-bit files that ``read_radiograph`` reads back; equal images give equal bytes."""

import json
from pathlib import Path

import numpy as np
import tifffile
from jaxtyping import Float, UInt16
from numpy import ndarray
from PIL import Image
from PIL.PngImagePlugin import PngInfo
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import DigitalXRayImageStorageForProcessing, ExplicitVRLittleEndian, generate_uid
from torch import Tensor

from regtorch.errors import RegtorchError
from regtorch.files import written_whole
from regtorch.formats.radiographs import METADATA_KEY
from regtorch.geometry import Detector
from regtorch.imaging.orientation import directions

_VIEW_POSITIONS = {"PA": "PA", "AP": "AP", "LAT": "LL", "LLAT": "LL", "RLAT": "RL"}


def write_radiograph(
    path: str | Path,
    image: Float[Tensor, "h w"],
    detector: Detector,
    *,
    sdd_mm: float | None = None,
    view: str | None = None,
) -> None:
    """Write line integrals seen from the source as 16-bit ``.tiff``, ``.png`` or ``.dcm`` (DX).

    The values are stretched to the whole range, so gain and offset are lost. The header holds pixel size, SDD and
    view. Raises ``RegtorchError`` for an image of the wrong shape or with values that are not finite, a cropped
    detector, or another suffix.

    Args:
        path: File to write; its suffix chooses the format.
        image: Line integrals, bone bright.
        detector: The whole detector, centred on (0, 0).
        sdd_mm: Source-detector distance, if known.
        view: View of the patient, if known.
    """
    path = Path(path)
    if tuple(image.shape) != (detector.rows, detector.columns):
        raise RegtorchError(f"{path}: image of {tuple(image.shape)}, expected {detector.rows} x {detector.columns}")
    if detector.centre_mm != (0.0, 0.0):
        raise RegtorchError(f"{path}: detector centred on {detector.centre_mm} mm, expected a whole one, on (0, 0)")
    if not bool(image.isfinite().all()):
        raise RegtorchError(f"{path}: image with NaN or infinite pixels, expected numbers everywhere")
    suffix = path.suffix.lower()
    writers = {".tif": _write_tiff, ".tiff": _write_tiff, ".png": _write_png, ".dcm": _write_dicom}
    if suffix not in writers:
        raise RegtorchError(f"{path}: cannot write this kind of file, expected .tiff, .png or .dcm")
    values = image.detach().cpu().double().numpy()
    low, span = values.min(), np.ptp(values)
    stored = np.round((values - low) * (65535 / span if span else 0)).astype(np.uint16)
    stated = {"pixel_mm": detector.pixel_mm, "sdd_mm": sdd_mm, "view": view}
    with written_whole(path, path.suffix) as temporary:
        writers[suffix](temporary, stored, {key: value for key, value in stated.items() if value is not None})


def _write_tiff(path: Path, stored: UInt16[ndarray, "h w"], stated: dict) -> None:
    tifffile.imwrite(
        path, stored, photometric="minisblack", description=json.dumps(stated), metadata=None, software=False
    )


def _write_png(path: Path, stored: UInt16[ndarray, "h w"], stated: dict) -> None:
    text = PngInfo()
    text.add_text(METADATA_KEY, json.dumps(stated))
    Image.fromarray(stored).save(path, pnginfo=text)


def _write_dicom(path: Path, stored: UInt16[ndarray, "h w"], stated: dict) -> None:
    content = [stored.tobytes().hex(), json.dumps(stated)]
    view, pixel_mm = stated.get("view"), f"{stated['pixel_mm']:.10g}"
    d = Dataset()
    d.SOPClassUID = DigitalXRayImageStorageForProcessing
    d.SOPInstanceUID, d.StudyInstanceUID, d.SeriesInstanceUID = (
        generate_uid(entropy_srcs=[*content, part]) for part in ("instance", "study", "series")
    )
    d.ImageType = ["DERIVED", "PRIMARY", ""]
    d.Modality, d.PresentationIntentType, d.Manufacturer = "DX", "FOR PROCESSING", "regtorch"
    d.PatientName, d.PatientID, d.PatientBirthDate, d.PatientSex = "", "", "", ""
    d.StudyDate, d.StudyTime, d.AccessionNumber, d.ReferringPhysicianName, d.StudyID = "", "", "", "", ""
    d.SeriesNumber, d.InstanceNumber, d.ContentDate, d.ContentTime = 1, 1, "", ""
    d.BodyPartExamined, d.ImageLaterality, d.DetectorType = "", "U", ""
    d.PatientOrientation = list(directions(view)) if view else ""
    d.ViewPosition = _VIEW_POSITIONS[view] if view else ""
    d.ImagerPixelSpacing = [pixel_mm, pixel_mm]
    d.DistanceSourceToDetector = f"{stated['sdd_mm']:.10g}" if "sdd_mm" in stated else ""
    d.SamplesPerPixel, d.PhotometricInterpretation = 1, "MONOCHROME2"
    d.Rows, d.Columns = stored.shape
    d.BitsAllocated, d.BitsStored, d.HighBit, d.PixelRepresentation = 16, 16, 15, 0
    d.PixelIntensityRelationship, d.PixelIntensityRelationshipSign = "LOG", -1
    d.RescaleIntercept, d.RescaleSlope, d.RescaleType = 0, 1, "US"
    d.PresentationLUTShape, d.LossyImageCompression, d.BurnedInAnnotation = "IDENTITY", "00", "NO"
    d.PixelData = stored.astype("<u2").tobytes()
    d.file_meta = FileMetaDataset()
    d.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    d.save_as(path, enforce_file_format=True)
