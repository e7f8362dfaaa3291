"""CT and radiograph in memory: made into line integrals and attenuation, and checked."""

from regtorch.imaging.averaging import coarsen
from regtorch.imaging.checks import check_radiograph, check_volume
from regtorch.imaging.hounsfield import BONE_HU, attenuation, bone_contrast, crop_to_anatomy
from regtorch.imaging.radiograph import Radiograph, level
from regtorch.imaging.truncation import continued
from regtorch.imaging.volume import Volume

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
]
