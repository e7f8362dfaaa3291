"""A CT from a folder of DICOM slices, or a sentence that says why the slices do not make one."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from pydicom import Dataset

from regtorch.errors import RegtorchError
from regtorch.files import one_line
from regtorch.formats.dicom import number, numbers, quiet, read_header, read_pixels, words
from regtorch.imaging.volume import Volume

_KEYWORDS = [
    *("Modality", "SeriesInstanceUID", "SeriesNumber", "SeriesDescription", "NumberOfFrames", "SamplesPerPixel"),
    *("Rows", "Columns", "PixelSpacing", "ImagePositionPatient", "ImageOrientationPatient", "SliceThickness"),
    *("RescaleSlope", "RescaleIntercept", "PixelPaddingValue"),
]
_CT_IMAGE = "1.2.840.10008.5.1.4.1.1.2"
_AIR_HU, _DENSEST_HU = -1024, 4000
"""The value of padding that would be denser than any bone; metal ends above 3,000 HU in most scanners."""


@dataclass(frozen=True)
class _Slice:
    """``axes`` are the directions of increasing column and of increasing row; ``spacing`` is between rows, columns."""

    path: Path
    header: Dataset
    shape: tuple[int, int]
    spacing: tuple[float, float]
    position: Float[ndarray, "3"]
    axes: Float[ndarray, "2 3"]


def read_dicom_folder(folder: Path) -> Volume:
    """The one CT series in ``folder``, in HU; every slice must be there, once, at equal distances."""
    with quiet():
        headers = _headers(folder)
        _check_one_series(folder, list(headers.values()))
        slices = [_slice(folder, path, header) for path, header in headers.items()]
        _check_alike(folder, slices)
        first = slices[0]
        normal = np.cross(*first.axes)
        slices.sort(key=lambda s: float(s.position @ normal))
        step = _equal_step(folder, slices, np.array([s.position @ normal for s in slices]))
        _check_upright(folder, slices, normal)
        data = np.empty((len(slices), *first.shape), np.float32)
        for values, item in zip(data, slices, strict=True):
            values[:] = _hounsfield(item)
    patient_from_voxel = torch.eye(4, dtype=torch.float64)
    (along_row, along_column), (row_mm, column_mm) = first.axes, first.spacing
    columns = [along_row * column_mm, along_column * row_mm, normal * step, slices[0].position]
    patient_from_voxel[:3] = torch.from_numpy(np.stack(columns, axis=-1))
    thickness = number(first.header, "SliceThickness")
    return Volume.from_grid(torch.from_numpy(data), patient_from_voxel, folder.name, thickness or None)


def _headers(folder: Path) -> dict[Path, Dataset]:
    """Of the DICOM images in the folder; other files lie there undisturbed."""
    inside = sorted(folder.iterdir())
    found = {p: read_header(p, _KEYWORDS) for p in inside if p.is_file()}
    for path, header in found.items():
        if header is None:
            broken = path.suffix.lower() == ".dcm" and not path.name.startswith(".")
        else:
            broken = "Rows" not in header and header.file_meta.get("MediaStorageSOPClassUID") == _CT_IMAGE
        if broken:
            raise RegtorchError(f"{path}: cannot be read (cut short, or no DICOM preamble), expected a whole CT slice")
    found = {path: header for path, header in found.items() if header is not None and "Rows" in header}
    if not found:
        folders = sum(p.is_dir() for p in inside)
        hint = f" (it holds {folders} folder(s): name the one of the series)" if folders else ""
        raise RegtorchError(f"{folder}: no DICOM image in this folder, expected the slices of one CT series{hint}")
    return found


def _check_one_series(folder: Path, headers: list[Dataset]) -> None:
    count = Counter(str(h.get("SeriesInstanceUID", "")) for h in headers)
    if len(count) > 1:
        names = []
        for uid, images in count.items():
            h = next(h for h in headers if str(h.get("SeriesInstanceUID", "")) == uid)
            label = " ".join(words(h, "SeriesNumber") + words(h, "SeriesDescription"))
            names.append(f"{label or 'unnamed'!r} ({images} images, {uid or 'no UID'})")
        raise RegtorchError(f"{folder}: {len(count)} series, expected one: {one_line('; '.join(names), 400)}")


def _slice(folder: Path, path: Path, header: Dataset) -> _Slice:
    name = f"{folder}: {path.name}"
    modality = header.get("Modality") or "CT"
    if modality != "CT":
        raise RegtorchError(f"{name}: Modality {modality}, expected CT")
    if (number(header, "NumberOfFrames") or 1) > 1:
        frames = f"{header.NumberOfFrames} frames in one file"
        raise RegtorchError(f"{name}: {frames}, expected one slice a file (convert it to NIfTI first)")
    if (number(header, "SamplesPerPixel") or 1) != 1:
        raise RegtorchError(f"{name}: colour image, expected HU in one channel")
    found = []
    for keyword, length in (("PixelSpacing", 2), ("ImagePositionPatient", 3), ("ImageOrientationPatient", 6)):
        values = numbers(header, keyword)
        if len(values) != length:
            stated = "\\".join(words(header, keyword)) or "absent"
            raise RegtorchError(f"{name}: {keyword} is {stated}, expected {length} numbers")
        found.append(values)
    spacing, position, axes = found[0], np.array(found[1]), np.array(found[2]).reshape(2, 3)
    if min(spacing) <= 0:
        raise RegtorchError(f"{name}: PixelSpacing is {spacing}, expected positive mm")
    if np.abs(axes @ axes.T - np.eye(2)).max() > 1e-3:
        raise RegtorchError(f"{name}: ImageOrientationPatient is {found[2]}, expected two unit vectors at 90 degrees")
    return _Slice(path, header, (header.Rows, header.Columns), (spacing[0], spacing[1]), position, axes)


def _check_alike(folder: Path, slices: list[_Slice]) -> None:
    first = slices[0]
    if len(slices) < 2:
        raise RegtorchError(f"{folder}: one slice only ({first.path.name}), expected a stack of CT slices")
    for item in slices[1:]:
        names = f"{folder}: {item.path.name} and {first.path.name}"
        if item.shape != first.shape:
            raise RegtorchError(f"{names} have {item.shape} and {first.shape} pixels, expected one size")
        if not np.allclose(item.spacing, first.spacing, rtol=1e-3):
            raise RegtorchError(f"{names} have PixelSpacing {item.spacing} and {first.spacing} mm, expected one")
        if np.abs(item.axes - first.axes).max() > 1e-3:
            raise RegtorchError(f"{names} lie at an angle, expected parallel slices")


def _equal_step(folder: Path, slices: list[_Slice], heights: Float[ndarray, " n"]) -> float:
    gaps = np.diff(heights)
    usual = float(np.median(gaps))
    # Positions may come rounded to 0.1 mm, which moves a gap by up to that much.
    tolerance = min(0.11, 0.2 * usual)
    worst = int(np.argmin(gaps))
    if gaps[worst] <= 0.01:
        a, b = slices[worst].path.name, slices[worst + 1].path.name
        raise RegtorchError(f"{folder}: {a} and {b} both lie at {heights[worst]:.2f} mm, expected one slice a place")
    worst = int(np.argmax(np.abs(gaps - usual)))
    if abs(gaps[worst] - usual) > tolerance:
        a, b = slices[worst].path.name, slices[worst + 1].path.name
        between = f"between {a} and {b} (at {heights[worst]:.2f} and {heights[worst + 1]:.2f} mm)"
        slots = round(gaps[worst] / usual)
        if slots > 1 and abs(gaps[worst] - slots * usual) < slots * tolerance:
            raise RegtorchError(f"{folder}: {slots - 1} slice(s) missing {between}, expected one every {usual:.2f} mm")
        raise RegtorchError(f"{folder}: {gaps[worst]:.2f} mm {between}, expected {usual:.2f} mm as elsewhere")
    step = float((heights[-1] - heights[0]) / (len(heights) - 1))
    drift = heights - heights[0] - step * np.arange(len(heights))
    worst = int(np.argmax(np.abs(drift)))
    if abs(drift[worst]) > 2 * tolerance:
        off = f"{slices[worst].path.name} lies {drift[worst]:+.2f} mm off an even spacing of {step:.3f} mm"
        raise RegtorchError(f"{folder}: slice spacing changes along the stack ({off}), expected equal spacing")
    return step


def _check_upright(folder: Path, slices: list[_Slice], normal: Float[ndarray, "3"]) -> None:
    """A slice must lie straight above the first one: a tilted gantry shifts each a little further."""
    way = np.stack([s.position for s in slices]) - slices[0].position
    height = float(way[-1] @ normal)
    lateral = np.linalg.norm(way - np.outer(way @ normal, normal), axis=1)
    worst = int(np.argmax(lateral))
    # Directions come rounded to some 4 digits, which looks like a shift of that share of the height.
    if lateral[worst] > max(0.1, 1e-3 * height):
        tilt = np.degrees(np.arctan2(lateral[worst], way[worst] @ normal))
        raise RegtorchError(
            f"{folder}: {slices[worst].path.name} is shifted sideways by {lateral[worst]:.2f} mm (as by a gantry tilt "
            f"of {tilt:.1f} degrees), expected slices straight above each other: resample the CT first"
        )


def _hounsfield(item: _Slice) -> Float[ndarray, "h w"]:
    stored = read_pixels(item.path)
    if stored.shape != item.shape:
        raise RegtorchError(f"{item.path}: pixels of shape {stored.shape}, expected {item.shape}")
    slope, intercept = (_scale(item, *each) for each in (("RescaleSlope", 1.0), ("RescaleIntercept", 0.0)))
    values = stored * np.float32(slope) + np.float32(intercept)
    padding = number(item.header, "PixelPaddingValue")
    if padding is not None:
        same = (stored.astype(np.int64) - int(padding)) % 65536 == 0  # signed in one tag, unsigned in the other
        values[same & (values > _DENSEST_HU)] = _AIR_HU
    return values


def _scale(item: _Slice, keyword: str, default: float) -> float:
    stated, value = words(item.header, keyword), number(item.header, keyword)
    if stated and value is None:
        raise RegtorchError(f"{item.path}: {keyword} is {', '.join(stated)}, expected a number")
    return default if value is None else value
