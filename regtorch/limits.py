"""Sizes and distances beyond which nothing is registered."""

LEAST_PIXELS, MOST_PIXELS = 8, 10_000
"""A side of a radiograph: less shows nothing to register, more does not fit into memory."""

SDD_RANGE_MM = (300.0, 6000.0)
"""From a small C-arm to the longest room; DICOM writers put 0 where they know nothing."""
