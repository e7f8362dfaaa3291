"""One radiograph's pixels and their meaning by the DICOM header."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Shaped
from numpy import ndarray
from PIL import Image, ImageDraw
from pydicom import Dataset

from regtorch.errors import RegtorchError
from regtorch.formats.dicom import number, numbers, quiet, read_header, read_pixels, words
from regtorch.formats.intensity import Meaning, dicom_meaning
from regtorch.limits import SDD_RANGE_MM

_PROJECTIONS = ("CR", "DX", "RF", "XA")
_FLUORO = ("RF", "XA")
_NOT_PROJECTIONS = ("CT", "MR", "PT", "NM", "US")
_VIEW_POSITIONS = {"PA": ("PA",), "AP": ("AP",), "LL": ("LLAT", "LAT"), "RL": ("RLAT",)}
_LEAST_OPENING = 1 / 16
"""Of the image, that a shutter leaves."""


@dataclass(frozen=True)
class StoredRadiograph:
    """A radiograph as its file has it: values and their meaning, place and size of the pixels where stated."""

    values: Shaped[ndarray, "h w"]
    meaning: Meaning
    pixel_mm: float | None
    sdd_mm: float | None = None
    orientation: tuple[str, str] | None = None
    unused: Shaped[ndarray, "h w"] | None = None
    warnings: list[str] = field(default_factory=list)


def read_dicom(path: Path, view: str, intensity: str, pixel_mm: float | None) -> StoredRadiograph:
    """A single monochrome frame; ``pixel_mm`` overrules the header."""
    with quiet():
        header = read_header(path)
        if header is None:
            raise RegtorchError(f"{path}: cannot be read, expected a whole DICOM file")
        found: list[str] = []
        _check_kind(path, header, found)
        stored = read_pixels(path)
        if stored.shape != (header.Rows, header.Columns):
            raise RegtorchError(f"{path}: pixels of shape {stored.shape}, expected {(header.Rows, header.Columns)}")
        meaning = dicom_meaning(header, intensity)
        found += meaning.warnings
        values = stored
        if not meaning.of_stored:
            values = stored * np.float32(number(header, "RescaleSlope") or 1)
        _check_view(header, view, found)
        stated_mm = _pixel_mm(path, header, found if pixel_mm is None else [])
        return StoredRadiograph(
            values,
            meaning,
            stated_mm if pixel_mm is None else pixel_mm,
            _sdd_mm(header, found),
            _orientation(header, found),
            _padding(header, stored) | _shuttered(header, found),
            found,
        )


def _check_kind(path: Path, header: Dataset, found: list[str]) -> None:
    modality = header.get("Modality") or "absent"
    if modality in _NOT_PROJECTIONS:
        raise RegtorchError(f"{path}: Modality {modality}, expected a radiograph ({', '.join(_PROJECTIONS)})")
    if "Rows" not in header:
        raise RegtorchError(f"{path}: a DICOM file without an image, expected a radiograph")
    if (number(header, "NumberOfFrames") or 1) > 1:
        raise RegtorchError(f"{path}: {header.NumberOfFrames} frames, expected a single radiograph")
    photometric = header.get("PhotometricInterpretation") or "absent"
    if (number(header, "SamplesPerPixel") or 1) != 1 or photometric not in ("MONOCHROME1", "MONOCHROME2"):
        what = f"PhotometricInterpretation {photometric}, {header.get('SamplesPerPixel')} channel(s)"
        raise RegtorchError(f"{path}: {what}, expected MONOCHROME1 or MONOCHROME2 in one")
    if modality not in _PROJECTIONS:
        found.append(f"Modality is {modality}, none of {', '.join(_PROJECTIONS)}: taken as a radiograph")


def _check_view(header: Dataset, view: str, found: list[str]) -> None:
    stated = str(header.get("ViewPosition") or "").upper()
    if stated in _VIEW_POSITIONS and view not in _VIEW_POSITIONS[stated]:
        found.append(f"ViewPosition is {stated}, but it is read as {view}")


def _pixel_mm(path: Path, header: Dataset, found: list[str]) -> float | None:
    """In the detector's plane: ImagerPixelSpacing is there, PixelSpacing may have been calibrated in the patient."""
    sizes = {}
    for keyword in ("ImagerPixelSpacing", "PixelSpacing", "NominalScannedPixelSpacing"):
        values = numbers(header, keyword)
        if len(values) == 2 and min(values) > 0:
            sizes[keyword] = values
        elif words(header, keyword):
            found.append(f"{keyword} is {'/'.join(words(header, keyword))}, which is no size")
    if not sizes:
        _check_aspect(path, header)
        return None
    used, (row, column) = next(iter(sizes.items()))
    if abs(row / column - 1) > 0.01:
        raise RegtorchError(f"{path}: {used} of {row:g} x {column:g} mm is oblong, expected square pixels")
    plain = sizes.get("PixelSpacing")
    if plain and used == "ImagerPixelSpacing" and max(abs(plain[0] / row - 1), abs(plain[1] / column - 1)) > 1e-3:
        found.append(f"PixelSpacing of {plain[0]:g} mm is not ImagerPixelSpacing's {row:g} mm: the detector's is used")
    if used == "PixelSpacing" and (words(header, "PixelSpacingCalibrationType") or header.get("Modality") in _FLUORO):
        found.append(f"only PixelSpacing ({row:g} mm) is stated, which may be calibrated within the patient")
    return (row + column) / 2


def _check_aspect(path: Path, header: Dataset) -> None:
    """How high a pixel is to its width, which is stated where no size is."""
    aspect = numbers(header, "PixelAspectRatio")
    if len(aspect) == 2 and min(aspect) > 0 and abs(aspect[0] / aspect[1] - 1) > 0.01:
        raise RegtorchError(f"{path}: PixelAspectRatio {aspect[0]:g}/{aspect[1]:g} is oblong, expected square pixels")


def _sdd_mm(header: Dataset, found: list[str]) -> float | None:
    stated = number(header, "DistanceSourceToDetector")
    if not stated:
        if stated is None and (told := words(header, "DistanceSourceToDetector")):
            found.append(f"DistanceSourceToDetector is {', '.join(told)}, which is no number")
        return None
    low, high = SDD_RANGE_MM
    if not low <= stated <= high:
        found.append(f"DistanceSourceToDetector of {stated:g} mm is not believed: expected {low:g} to {high:g} mm")
        return None
    return stated


def _orientation(header: Dataset, found: list[str]) -> tuple[str, str] | None:
    directions = words(header, "PatientOrientation")
    if len(directions) != 2 or not all(directions):
        found.append("PatientOrientation is absent: taken as seen from the source, unless told that it is mirrored")
        return None
    return directions[0], directions[1]


def _padding(header: Dataset, stored: Shaped[ndarray, "h w"]) -> Bool[ndarray, "h w"]:
    low = number(header, "PixelPaddingValue")
    if low is None:
        return np.zeros(stored.shape, bool)
    limit = number(header, "PixelPaddingRangeLimit")
    high = low if limit is None else limit
    return (stored >= min(low, high)) & (stored <= max(low, high))


def _shuttered(header: Dataset, found: list[str]) -> Bool[ndarray, "h w"]:
    """Where display shutters lie (DICOM PS3.3 C.7.6.11): rows and columns are counted from 1."""
    rows, columns = header.Rows, header.Columns
    row, column = np.ogrid[1 : rows + 1, 1 : columns + 1]
    closed = np.zeros((rows, columns), bool)
    for shape in words(header, "ShutterShape"):
        opening = _opening(header, shape, row, column)
        if opening is None or opening.mean() < _LEAST_OPENING:
            found.append(f"the {shape} shutter is not understood or leaves next to nothing: it is not used")
        else:
            closed |= ~opening
    return closed


def _opening(
    header: Dataset, shape: str, row: Shaped[ndarray, "h 1"], column: Shaped[ndarray, "1 w"]
) -> Bool[ndarray, "h w"] | None:
    if shape == "RECTANGULAR":  # its edges are the lines just outside
        names = ("UpperHorizontal", "LowerHorizontal", "LeftVertical", "RightVertical")
        edges = [number(header, f"Shutter{name}Edge") for name in names]
        if None in edges:
            return None
        top, bottom, left, right = edges
        return (row > top) & (row < bottom) & (column > left) & (column < right)
    if shape == "CIRCULAR":
        centre, radius = numbers(header, "CenterOfCircularShutter"), number(header, "RadiusOfCircularShutter")
        if len(centre) != 2 or radius is None:
            return None
        return (row - centre[0]) ** 2 + (column - centre[1]) ** 2 <= radius**2
    if shape == "POLYGONAL":
        corners = numbers(header, "VerticesOfThePolygonalShutter")
        if len(corners) < 6 or len(corners) % 2:
            return None
        picture = Image.new("1", (header.Columns, header.Rows))
        ImageDraw.Draw(picture).polygon([(x - 1, y - 1) for y, x in zip(corners[::2], corners[1::2], strict=True)], 1)
        return np.array(picture)
    return None
