"""Limits of the input."""

LEAST_PIXELS, MOST_PIXELS = 8, 10_000
"""Pixels along a side of a radiograph: fewer show too little to register, more do not fit into memory."""

SDD_RANGE_MM = (300.0, 6000.0)
"""Source-detector distances, from a small C-arm to the longest room. Some DICOM writers put 0 for unknown."""
