"""ZYX Euler angles: R = Rz(phi) Ry(theta) Rx(eta)."""

import torch
from jaxtyping import Float
from torch import Tensor


def rotation_from_euler(angles: Float[Tensor, "*b 3"]) -> Float[Tensor, "*b 3 3"]:
    """Rotation matrices for (eta, theta, phi) in radians, about X, Y and Z of the fixed frame, in that order."""
    (cx, cy, cz), (sx, sy, sz) = angles.cos().unbind(-1), angles.sin().unbind(-1)
    entries = [
        cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx,
        sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx,
        -sy, cy * sx, cy * cx,
    ]  # fmt: skip
    return torch.stack(entries, dim=-1).unflatten(-1, (3, 3))


def euler_from_rotation(rotation: Float[Tensor, "*b 3 3"]) -> Float[Tensor, "*b 3"]:
    """(eta, theta, phi) in radians with theta in [-pi/2, pi/2]; at theta = +-pi/2 only phi -+ eta is determined."""
    eta = torch.atan2(rotation[..., 2, 1], rotation[..., 2, 2])
    theta = torch.atan2(-rotation[..., 2, 0], torch.hypot(rotation[..., 2, 1], rotation[..., 2, 2]))
    phi = torch.atan2(rotation[..., 1, 0], rotation[..., 0, 0])
    return torch.stack([eta, theta, phi], dim=-1)
