"""Where a CT ends and the patient does not: a radiograph shows the rest of the body, and none of the edges of the
CT."""

import math

import torch
from torch import Tensor

from regtorch.imaging.hounsfield import BONE_HU, MU_WATER_PER_MM
from regtorch.imaging.volume import Volume

_CUT = 0.1
"""Least attenuation of the first or last slice, as a share of the densest one's, for the body to go on beyond it."""

_SOFT_PER_MM = MU_WATER_PER_MM * (1 + BONE_HU / 1000)


def continued(whole: Volume, reach_mm: float) -> Volume:
    """All tissue and, where the CT cuts the body, copies of the last slices, up to ``reach_mm`` from the origin.

    As soft tissue at most, since the next bone is another one. The same volume where the CT cuts nothing or reaches far
    enough.
    """
    axis = whole.along_body
    data = whole.data.movedim(-1 - axis, 0)
    origin = torch.linalg.solve(whole.patient_from_voxel, torch.cat([whole.origin_patient_mm, torch.ones(1).double()]))
    slices = reach_mm / float(whole.spacing_mm[axis])
    least = _CUT * data.flatten(1).sum(1).max()

    def beyond(outermost: Tensor, lacking: float) -> Tensor:
        """Copies of two slices together: the last may be air in part, where coarser voxels reach beyond finer ones."""
        face = outermost.amax(0).clamp(max=_SOFT_PER_MM)
        return face.expand(max(0, math.ceil(lacking)) if face.sum() > least else 0, *face.shape)

    below = beyond(data[:2], slices - float(origin[axis]))
    above = beyond(data[-2:], slices - (len(data) - 1 - float(origin[axis])))
    if len(below) + len(above) == 0:
        return whole
    data = data.clone()
    for end, copies in ((0, below), (-1, above)):
        if len(copies):
            data[end] = torch.maximum(data[end], copies[0])
    patient_from_voxel = whole.patient_from_voxel.clone()
    patient_from_voxel[:, 3] -= len(below) * patient_from_voxel[:, axis]
    return whole.on_grid(torch.cat([below, data, above]).movedim(0, -1 - axis).contiguous(), patient_from_voxel)
