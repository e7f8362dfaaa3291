"""Radiographic views: which way the patient faces at zero rotation."""

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.errors import RegtorchError

_LEFT, _POSTERIOR, _SUPERIOR = (1, 0, 0), (0, 1, 0), (0, 0, 1)
_RIGHT, _ANTERIOR = (-1, 0, 0), (0, -1, 0)

# X, Y and Z of `world` (along columns, up, towards the source) in patient axes (LPS).
_AXES = {
    "PA": (_RIGHT, _SUPERIOR, _POSTERIOR),
    "AP": (_LEFT, _SUPERIOR, _ANTERIOR),
    "LLAT": (_ANTERIOR, _SUPERIOR, _RIGHT),
    "RLAT": (_POSTERIOR, _SUPERIOR, _LEFT),
}
_AXES["LAT"] = _AXES["LLAT"]

VIEWS = tuple(_AXES)
"""PA: source behind the patient. AP: in front. LLAT: left side on the detector, also called LAT. RLAT: right side."""


def world_from_patient_axes(view: str) -> Float[Tensor, "3 3"]:
    """The rotation B of a view (float64): patient axes to world axes at eta = theta = phi = 0."""
    if view not in _AXES:
        raise RegtorchError(f"unknown view {view!r}: expected one of {', '.join(VIEWS)}")
    return torch.tensor(_AXES[view], dtype=torch.float64)


def same_view(one: str, other: str) -> bool:
    """Whether two names mean the same view, as LAT and LLAT do; an unknown name equals no view."""
    return one in _AXES and _AXES[one] == _AXES.get(other)
