"""Points on the anatomy, spread evenly: the targets of a CT where nobody named any."""

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.imaging.averaging import coarsen
from regtorch.imaging.volume import Volume

_GRID_MM = 6.0


def spread_points(volume: Volume, n: int) -> Float[Tensor, "n 3"]:
    """Up to ``n`` places (LPS mm) in the denser half of the attenuating voxels, each as far as can be from all before
    it.

    The first is the one nearest to the middle of them all. Deterministic.
    """
    coarse = coarsen(volume, _GRID_MM)
    dense = coarse.data >= coarse.data[coarse.data > 0].median()
    index = dense.nonzero().flip(1).cpu().double()
    candidates = index @ coarse.patient_from_voxel[:3, :3].mT + coarse.patient_from_voxel[:3, 3]
    chosen = [int((candidates - candidates.mean(0)).norm(dim=1).argmin())]
    distance = torch.full((len(candidates),), torch.inf, dtype=torch.float64)
    while len(chosen) < min(n, len(candidates)):
        distance = torch.minimum(distance, (candidates - candidates[chosen[-1]]).norm(dim=1))
        chosen.append(int(distance.argmax()))
    return candidates[chosen]
