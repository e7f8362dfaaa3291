"""What is too small to be registered, and what too large."""

LEAST_PIXELS, MOST_PIXELS = 8, 10_000
"""A side of a radiograph: less shows nothing to register, more does not fit into memory."""
