"""Where a CT ends and the patient does not: a radiograph shows what goes on, and none of the edges of the CT."""

import math

import torch

from regtorch.imaging.attenuation import BONE_HU, MU_WATER_PER_MM
from regtorch.imaging.volume import Volume

_CUT = 0.1
"""What the first or last slice must attenuate, of the densest one, for the body to go on beyond it."""

_SOFT_PER_MM = MU_WATER_PER_MM * (1 + BONE_HU / 1000)


def continued(whole: Volume, beyond_mm: float) -> Volume:
    """All tissue, and above and below, where the CT cuts the body, ``beyond_mm`` more of what lies there.

    As soft tissue at most, since the next bone is another one. The same volume where the CT cuts nothing.
    """
    along = int(whole.patient_from_voxel[2, :3].abs().argmax())  # the voxel axis nearest to the patient's
    data = whole.data.movedim(-1 - along, 0)
    count = math.ceil(beyond_mm / float(whole.spacing_mm[along]))
    least = _CUT * data.flatten(1).sum(1).max()
    # The outermost slice may be air in part, where coarser voxels reach beyond the finer ones.
    faces = (torch.maximum(data[end], data[beside]).clamp(max=_SOFT_PER_MM) for end, beside in ((0, 1), (-1, -2)))
    below, above = (face.expand(count if face.sum() > least else 0, *face.shape) for face in faces)
    if len(below) + len(above) == 0:
        return whole
    patient_from_voxel = whole.patient_from_voxel.clone()
    patient_from_voxel[:, 3] -= len(below) * patient_from_voxel[:, along]
    return whole.on_grid(torch.cat([below, data, above]).movedim(0, -1 - along).contiguous(), patient_from_voxel)
