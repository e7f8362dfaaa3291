"""CTs in and out of files: ``read_volume`` reads every format, ``write_volume`` writes SimpleITK's."""

from pathlib import Path

import numpy as np
import SimpleITK
import torch

from regtorch.errors import RegtorchError
from regtorch.files import one_line, written_whole
from regtorch.formats.dicom_volumes import read_dicom_folder
from regtorch.formats.files import is_dicom, native_silence
from regtorch.formats.nifti import check_nifti
from regtorch.imaging.volume import Volume

SUFFIXES = (".nii", ".nii.gz", ".nrrd", ".mha")
_SHEARED = "axes that are not at 90 degrees (a gantry tilt?), expected a resampled volume"


def read_volume(path: str | Path) -> Volume:
    """A CT in HU (float32) from a DICOM folder of one series, NIfTI, NRRD or MHA.

    Raises ``RegtorchError`` for anything but one whole, evenly spaced, finite volume.
    """
    path = Path(path)
    if not path.exists():
        raise RegtorchError(f"{path}: no such file or folder, expected a CT ({', '.join(SUFFIXES)} or DICOM folder)")
    if path.is_dir():
        volume = read_dicom_folder(path)
    elif path.name.lower().endswith(SUFFIXES):
        volume = _read_file(path)
    elif is_dicom(path):
        raise RegtorchError(f"{path}: a single DICOM file, expected the folder of the whole series: {path.parent}")
    else:
        raise RegtorchError(f"{path}: not a CT, expected a DICOM folder or one of {', '.join(SUFFIXES)}")
    if not bool(volume.data.isfinite().all()):
        count = int((~volume.data.isfinite()).sum())
        raise RegtorchError(f"{path}: {count} voxel(s) are NaN or infinite, expected HU everywhere")
    return volume


def write_volume(path: str | Path, volume: Volume) -> None:
    """Writes values and place as NIfTI, NRRD or MHA, by the suffix; compressed but for ``.nii``."""
    path = Path(path)
    suffix = next((s for s in reversed(SUFFIXES) if path.name.lower().endswith(s)), None)
    if suffix is None:
        raise RegtorchError(f"{path}: cannot write this kind of file, expected one of {', '.join(SUFFIXES)}")
    image = SimpleITK.GetImageFromArray(volume.data.cpu().numpy())
    image.SetSpacing(volume.spacing_mm.tolist())
    image.SetDirection((volume.patient_from_voxel[:3, :3] / volume.spacing_mm).flatten().tolist())
    image.SetOrigin(volume.patient_from_voxel[:3, 3].tolist())
    with written_whole(path, suffix) as temporary, native_silence():
        SimpleITK.WriteImage(image, str(temporary), useCompression=suffix != ".nii")


def _read_file(path: Path) -> Volume:
    warnings = check_nifti(path) if path.name.lower().endswith((".nii", ".nii.gz")) else _nrrd_warnings(path)
    with native_silence():
        try:
            image = SimpleITK.ReadImage(str(path))
        except RuntimeError as error:
            if "orthonormal" in str(error):
                raise RegtorchError(f"{path}: {_SHEARED}") from error
            reason = one_line(str(error).rsplit("ERROR: ", 1)[-1])
            raise RegtorchError(f"{path}: cannot be read ({reason}), expected a whole {path.suffix} file") from error
    size = image.GetSize()
    if len(size) != 3 or min(size) < 2:
        raise RegtorchError(f"{path}: {' x '.join(map(str, size))} voxels, expected a volume with three dimensions")
    if image.GetNumberOfComponentsPerPixel() != 1 or "complex" in image.GetPixelIDTypeAsString():
        raise RegtorchError(f"{path}: voxels of {image.GetPixelIDTypeAsString()}, expected one HU value each")
    axes = torch.tensor(image.GetDirection(), dtype=torch.float64).reshape(3, 3)
    spacing = torch.tensor(image.GetSpacing(), dtype=torch.float64)
    if float((axes.mT @ axes - torch.eye(3, dtype=torch.float64)).abs().max()) > 1e-3:
        raise RegtorchError(f"{path}: {_SHEARED}")
    patient_from_voxel = torch.eye(4, dtype=torch.float64)
    patient_from_voxel[:3, :3] = axes * spacing
    patient_from_voxel[:3, 3] = torch.tensor(image.GetOrigin(), dtype=torch.float64)
    if not bool(patient_from_voxel.isfinite().all()) or float(spacing.min()) <= 0:
        raise RegtorchError(f"{path}: voxel size {spacing.tolist()} mm, expected three positive numbers")
    values = SimpleITK.GetArrayViewFromImage(image).astype(np.float32)
    return Volume.from_grid(torch.from_numpy(values), patient_from_voxel, path.name, warnings=warnings)


def _nrrd_warnings(path: Path) -> tuple[str, ...]:
    """Of the text before the voxels, which ends with an empty line."""
    if not path.name.lower().endswith(".nrrd"):
        return ()
    with path.open("rb") as file:
        header = iter(lambda: file.readline(1 << 16).strip(), b"")
        if any(line.lower().startswith(b"space:") for line in header):
            return ()
    return ("no orientation is stated (no 'space'): rows are taken to run to the left, then back",)
