"""The nine parameters: order, units, freedom. Tensors hold mm and radians, dictionaries mm and degrees."""

import math
from collections.abc import Iterable, Mapping

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.errors import RegtorchError

NAMES = ("x_s", "y_s", "z_s", "x_obj", "y_obj", "z_obj", "eta", "theta", "phi")
"""Source (mm, ``world``; z_s is the SDD), patient (mm, ``world``), rotations (rad) about X, Y and Z."""

X_S, Y_S, Z_S, X_OBJ, Y_OBJ, Z_OBJ, ETA, THETA, PHI = range(len(NAMES))
"""Positions of the nine parameters in a tensor."""

KEYS = tuple(f"{name}_mm" for name in NAMES[:6]) + tuple(f"{name}_deg" for name in NAMES[6:])
"""Their names in files and tables, where angles are in degrees."""

_PER_KEY = (1.0,) * 6 + (180 / math.pi,) * 3

_FREE = {
    9: NAMES,
    7: NAMES[2:],  # a C-arm of unknown SDD: the source stays over the detector's centre
    6: NAMES[3:],
}


def free_indices(free: int | Iterable[str]) -> list[int]:
    """Positions of the free parameters, for 9, 7 or 6 degrees of freedom or any names of ``NAMES``.

    Raises ``RegtorchError`` for another number, an unknown name or none at all.

    >>> free_indices(6)
    [3, 4, 5, 6, 7, 8]
    """
    if isinstance(free, int):
        if free not in _FREE:
            raise RegtorchError(f"{free} degrees of freedom: expected one of {sorted(_FREE)} or names of parameters")
        free = _FREE[free]
    names = set(free)
    if unknown := names - set(NAMES):
        raise RegtorchError(f"unknown parameter {sorted(unknown)[0]!r}: expected one of {', '.join(NAMES)}")
    if not names:
        raise RegtorchError("every parameter is frozen: expected at least one that may move")
    return [i for i, name in enumerate(NAMES) if name in names]


def parameters_to_dict(parameters: Float[Tensor, "9"]) -> dict[str, float]:
    """The parameters in mm and degrees under ``KEYS``, as files hold them."""
    return {key: float(value) * unit for key, value, unit in zip(KEYS, parameters, _PER_KEY, strict=True)}


def parameters_from_dict(values: Mapping[str, float]) -> Float[Tensor, "9"]:
    """The inverse of ``parameters_to_dict``, in float64. Raises ``RegtorchError`` for a missing key."""
    if missing := [key for key in KEYS if key not in values]:
        raise RegtorchError(f"parameter {missing[0]!r} is missing: expected {', '.join(KEYS)}")
    numbers = [float(values[key]) / unit for key, unit in zip(KEYS, _PER_KEY, strict=True)]
    return torch.tensor(numbers, dtype=torch.float64)
