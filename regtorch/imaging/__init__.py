"""CT and radiograph: in and out of files, made into what the registration compares, checked."""

from regtorch.imaging.attenuation import BONE_HU, attenuation, bone_contrast, crop_to_anatomy, tissue_classes
from regtorch.imaging.averaging import coarsen
from regtorch.imaging.checks import check_radiograph, check_volume
from regtorch.imaging.radiograph import Radiograph, level
from regtorch.imaging.radiograph_files import read_radiograph
from regtorch.imaging.radiograph_writer import write_radiograph
from regtorch.imaging.target_files import read_points
from regtorch.imaging.truncation import continued
from regtorch.imaging.volume import Volume
from regtorch.imaging.volume_files import read_volume, write_volume

__all__ = [
    "BONE_HU",
    "Radiograph",
    "Volume",
    "attenuation",
    "bone_contrast",
    "check_radiograph",
    "check_volume",
    "coarsen",
    "continued",
    "crop_to_anatomy",
    "level",
    "read_points",
    "read_radiograph",
    "read_volume",
    "tissue_classes",
    "write_radiograph",
    "write_volume",
]
