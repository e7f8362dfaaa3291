"""A thread's working arrays for the rays of a tile: sizes and offsets."""

from typing import no_type_check

import numpy as np
from numba import njit, types
from numba.extending import overload

TILE_ROWS, TILE_COLUMNS = 8, 16
N = TILE_ROWS * TILE_COLUMNS

# Offsets in a tile's float32 scratch, each N long. One array shows the compiler that they do not overlap.
A0, DA, B0, DB, END, FA, FB, SHARE, DERIVATIVE, TOTAL = (N * i for i in range(10))
TOTAL_A, TOTAL_B, MOMENT_A, MOMENT_B, AT_HIGH, AT_LOW = (N * i for i in range(6))
SOURCE_A, SOURCE_B, SOURCE_M, PIXEL_A, PIXEL_B, PIXEL_M = (N * i for i in range(6))
PER_CHANNEL = 6 * N

SLICES = 64  # looked at together

ROW, COLUMN = (place.astype(np.float64) for place in np.divmod(np.arange(N), TILE_COLUMNS))
Y, X = ROW.astype(np.float32), COLUMN.astype(np.float32)
"""Row and column of pixel q of a tile. Loops run over q, since compilers vectorise long loops only."""


@njit(nogil=True)
@no_type_check
def scratch(channels):
    """Floats [(9 + c) N], offsets [N], groups of four voxels [N], the same as floats, boxes in slices [5 SLICES]."""
    groups, boxes = np.empty(N, np.complex128), np.empty(5 * SLICES, np.int32)
    return np.empty(TOTAL + channels * N, np.float32), np.empty(N, np.uint32), groups, groups.view(np.float32), boxes


def slope_scratch(channels, jacobian):
    """Room for derivatives and for rays in float64, or None where ``jacobian`` is None.

    A bilinear value has a kink at every voxel. In float32 a ray near a kink may take the derivative of the wrong side.
    """


@overload(slope_scratch)  # of the types, so that no kernel asks again and again
@no_type_check
def _slope_scratch(channels, jacobian):
    if isinstance(jacobian, types.NoneType):
        return lambda channels, jacobian: None
    return lambda channels, jacobian: (np.empty(channels * PER_CHANNEL, np.float32), np.empty(4 * N))
