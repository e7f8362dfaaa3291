"""The embedded phantom: an adult torso from the base of the neck to the upper femora, made without any file."""

import numpy as np
import torch

from regtorch.errors import RegtorchError
from regtorch.imaging.volume import Volume
from regtorch.phantom.pelvis import pelvis_parts
from regtorch.phantom.raster import paint
from regtorch.phantom.spine import drawn_vertebrae
from regtorch.phantom.thorax import thorax_parts
from regtorch.phantom.tissue import tissue_parts
from regtorch.phantom.vertebrae import spine_parts

__all__ = ["make_phantom"]

_LOW, _HIGH = np.array([-192.0, -126.0, -192.0]), np.array([192.0, 138.0, 468.0])
_FINEST, _COARSEST = 0.8, 6.0
_SEED = 2022


def make_phantom(spacing_mm: float = 1.5) -> tuple[Volume, dict[str, tuple[float, float, float]]]:
    """A CT of a digital torso, 384 x 264 x 660 mm, and the middle of each vertebral body.

    Every call makes the same torso; another spacing samples the same torso, with partial volumes at its edges. It is
    made for registration: vertebrae and ribs that nearly repeat, as in people, and no symmetry that would let a mirror
    image pass. Sizes, curvatures and their sources stand in the tables of this package.

    Args:
        spacing_mm: edge of the cubic voxels, 0.8 to 6 mm.

    Returns:
        The ``Volume`` in whole HU (air -1000 to cortical bone about 1000, nothing but bone from 100 HU up), its axes
        those of LPS, the middle of the sacral endplate near the patient's origin; and the centres (x, y, z) of the
        bodies of C7, T1 to T12, L1 to L5 and S1 in LPS mm.

    Raises:
        RegtorchError: for a spacing outside these bounds.
    """
    if not _FINEST <= spacing_mm <= _COARSEST:
        raise RegtorchError(f"phantom: spacing of {spacing_mm} mm, expected {_FINEST} to {_COARSEST} mm")
    rng = np.random.default_rng(_SEED)
    vertebrae = drawn_vertebrae(rng)
    parts = [
        *tissue_parts(vertebrae, rng),
        *thorax_parts(vertebrae, rng),
        *pelvis_parts(rng),
        *spine_parts(vertebrae, rng),
    ]

    size = np.round((_HIGH - _LOW) / spacing_mm).astype(int)
    first = (_LOW + _HIGH) / 2 - (size - 1) / 2 * spacing_mm
    data = np.full(size[::-1], -1000, np.float32)
    paint(data, first, spacing_mm, parts, _SEED)

    patient_from_voxel = torch.diag(torch.tensor([spacing_mm, spacing_mm, spacing_mm, 1.0], dtype=torch.float64))
    patient_from_voxel[:3, 3] = torch.from_numpy(first)
    targets = {n: tuple(map(float, v.centre)) for n, v in vertebrae.items() if n == "S1" or n[0] in "TL" or n == "C7"}
    return Volume.from_grid(torch.from_numpy(data).round_(), patient_from_voxel, name="phantom"), targets
