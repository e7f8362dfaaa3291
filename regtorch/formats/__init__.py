"""Files of CTs, radiographs and named points: DICOM, NIfTI, NRRD, MHA, PNG, TIFF, CSV, markups of 3D Slicer."""

from regtorch.formats.radiograph_writer import write_radiograph
from regtorch.formats.radiographs import read_radiograph
from regtorch.formats.targets import read_points
from regtorch.formats.volumes import read_volume, write_volume

__all__ = ["read_points", "read_radiograph", "read_volume", "write_radiograph", "write_volume"]
