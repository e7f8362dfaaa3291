"""``read_radiograph``: any file of one radiograph, turned to be seen from the source, bone bright."""

import json
from pathlib import Path

import numpy as np
import tifffile
import torch
from jaxtyping import Float, Shaped
from numpy import ndarray
from PIL import Image
from torch import Tensor

from regtorch.errors import RegtorchError
from regtorch.files import one_line
from regtorch.formats.dicom_radiographs import StoredRadiograph, read_dicom
from regtorch.formats.files import is_dicom
from regtorch.formats.intensity import Meaning, check_intensity, line_integrals
from regtorch.geometry import Detector, same_view, world_from_patient_axes
from regtorch.imaging.field import exposed_field
from regtorch.imaging.orientation import pixel_axes, turned
from regtorch.imaging.radiograph import Radiograph

METADATA_KEY = "regtorch"
"""Of the text in a PNG; in a TIFF the same JSON object is the ImageDescription."""


def read_radiograph(
    path: str | Path,
    *,
    view: str,
    pixel_mm: float | None = None,
    intensity: str = "auto",
    mirrored: bool | None = None,
    mask: str | Path | Shaped[Tensor, "rows columns"] | None = None,
) -> Radiograph:
    """One radiograph from DICOM (CR, DX, RF, XA), PNG or TIFF.

    ``pixel_mm`` is the detector's and overrules the file. ``intensity`` says whether values are ``line`` integrals
    (bone bright), as a PNG or TIFF is taken to be, or ``counts`` of the beam; DICOM says it itself. ``mirrored`` says
    whether the file shows the image as seen towards the source, and overrules PatientOrientation. ``mask`` has the
    size of the file's image; 0 is not used, the rest by its weight of up to 1 (booleans, fractions) or 255 (integers).
    """
    path = Path(path)
    world_from_patient_axes(view)
    check_intensity(intensity)
    if pixel_mm is not None and not 0 < pixel_mm < float("inf"):
        raise RegtorchError(f"pixel size of {pixel_mm} mm: expected a positive one")
    if not path.is_file():
        what = "a folder" if path.is_dir() else "no such file"
        raise RegtorchError(f"{path}: {what}, expected a radiograph (DICOM, PNG or TIFF)")
    stored = read_dicom(path, view, intensity, pixel_mm) if is_dicom(path) else _plain(path, view, intensity, pixel_mm)
    if stored.pixel_mm is None:
        why = "".join(f" ({w})" for w in stored.warnings if w.endswith("no size"))
        raise RegtorchError(f"{path}: no pixel size in the file{why}, expected the detector's by --pixel-mm")
    with np.errstate(over="ignore"):
        finite = np.isfinite(stored.values.astype(np.float32)).all()
    if not finite:
        raise RegtorchError(f"{path}: pixels that are NaN or infinite (beyond 3e38), expected numbers everywhere")
    try:
        image = torch.from_numpy(line_integrals(_without_unused(stored), stored.meaning))
    except RegtorchError as error:
        raise RegtorchError(f"{path}: {error}") from error
    warnings = list(stored.warnings)
    weight = _weight(path, image, stored, mask)
    rows, columns = image.shape
    stored_from_pixel, complaint = pixel_axes(stored.orientation, view, mirrored, columns, rows)
    warnings += [complaint] if complaint else []
    image, weight = turned(image, stored_from_pixel), turned(weight, stored_from_pixel)
    detector = Detector(*image.shape, float(stored.pixel_mm))
    return Radiograph(image, detector, weight, stored_from_pixel, stored.sdd_mm, path.name, tuple(warnings))


def _without_unused(stored: StoredRadiograph) -> Shaped[ndarray, "h w"]:
    """Padding and shutters look as if no beam had come through; they tell nothing of the other pixels."""
    if stored.unused is None or not stored.unused.any() or stored.unused.all():
        return stored.values
    used = stored.values[~stored.unused]
    return np.where(stored.unused, used.min() if stored.meaning.grows else used.max(), stored.values)


def _weight(
    path: Path,
    image: Float[Tensor, "h w"],
    stored: StoredRadiograph,
    mask: str | Path | Shaped[Tensor, "rows columns"] | None,
) -> Float[Tensor, "h w"]:
    weight = torch.zeros_like(image)
    r0, r1, c0, c1 = exposed_field(image)
    weight[r0:r1, c0:c1] = 1
    if stored.unused is not None:
        weight[torch.from_numpy(stored.unused)] = 0
    if mask is not None:
        weight *= _mask(mask, tuple(image.shape))
    if not bool(weight.any()):
        raise RegtorchError(f"{path}: every pixel is masked or outside the field, expected some to register")
    return weight


def _mask(mask: str | Path | Shaped[Tensor, "rows columns"], shape: tuple[int, int]) -> Float[Tensor, "h w"]:
    name, values = "mask", mask
    if not isinstance(mask, Tensor):
        name, values = str(mask), torch.from_numpy(np.ascontiguousarray(_grey(Path(mask))[0].astype(np.float32)))
        values = values / 255 if bool((values > 1).any()) else values
    elif not mask.is_floating_point() and bool((mask > 1).any()):
        values = mask / 255
    if tuple(values.shape) != shape:
        raise RegtorchError(
            f"{name}: mask of {values.shape[0]} x {values.shape[1]} pixels, expected {shape[0]} x {shape[1]} as stored"
        )
    return values.to(torch.float32).clamp(0, 1)


def _plain(path: Path, view: str, intensity: str, pixel_mm: float | None) -> StoredRadiograph:
    values, text, warnings = _grey(path)
    metadata = _metadata(text)
    if "view" in metadata and not same_view(str(metadata["view"]), view):
        warnings.append(f"written as a {metadata['view']} view, but it is read as {view}")
    numbers = {}
    for key in ("pixel_mm", "sdd_mm"):
        value = metadata.get(key)
        numbers[key] = float(value) if isinstance(value, int | float) and value > 0 else None
    return StoredRadiograph(
        values,
        Meaning(grows=intensity == "counts", counts=intensity == "counts"),
        numbers["pixel_mm"] if pixel_mm is None else pixel_mm,
        numbers["sdd_mm"],
        warnings=warnings,
    )


def _metadata(text: str) -> dict:
    """The metadata of ``write_radiograph``; a foreign file's resolution in dpi is that of a printout and is not
    asked."""
    try:
        found = json.loads(text)
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


def _grey(path: Path) -> tuple[Shaped[ndarray, "h w"], str, list[str]]:
    """Values of a PNG or TIFF with one grey channel, its text, and its faults."""
    if not path.is_file():
        raise RegtorchError(f"{path}: no such file, expected a PNG or TIFF image")
    suffix = path.suffix.lower()
    try:
        if suffix in (".tif", ".tiff"):
            return _tiff(path)
        if suffix == ".png":
            return _png(path)
    except RegtorchError:
        raise
    except Exception as error:  # a broken file may raise anything
        raise RegtorchError(
            f"{path}: cannot be read ({one_line(error)}), expected a whole {suffix[1:]} file"
        ) from error
    raise RegtorchError(f"{path}: not a radiograph, expected DICOM, PNG or TIFF")


def _tiff(path: Path) -> tuple[Shaped[ndarray, "h w"], str, list[str]]:
    with tifffile.TiffFile(path) as file:
        page = file.pages[0]
        if len(file.pages) != 1:
            raise RegtorchError(f"{path}: {len(file.pages)} images in one file, expected a single radiograph")
        if page.samplesperpixel != 1 or len(page.shape) != 2:
            raise RegtorchError(f"{path}: colour image, expected one grey channel")
        if page.photometric not in (tifffile.PHOTOMETRIC.MINISWHITE, tifffile.PHOTOMETRIC.MINISBLACK):
            raise RegtorchError(f"{path}: {page.photometric.name} image, expected one grey channel")
        values = page.asarray()
        values = values.astype(np.uint8) if values.dtype == bool else values
        if page.photometric == tifffile.PHOTOMETRIC.MINISWHITE:
            whole = values.dtype.kind == "u" and page.bitspersample > 1
            values = (np.iinfo(values.dtype).max if whole else values.max()) - values.astype(np.float64)
        turned = page.tags.get("Orientation")
        ignored = turned is not None and turned.value != 1
        warnings = [f"Orientation tag of {turned.value} is not followed: pixels are as stored"] if ignored else []
        return values, page.description, warnings


def _png(path: Path) -> tuple[Shaped[ndarray, "h w"], str, list[str]]:
    with Image.open(path) as image:
        if image.mode not in ("1", "L", "I;16", "I;16B", "I"):
            raise RegtorchError(f"{path}: {image.mode} image, expected 16-bit grey")
        values = np.array(image)
        values = values.astype(np.uint8) if values.dtype == bool else values
        return values, image.info.get(METADATA_KEY, ""), []
