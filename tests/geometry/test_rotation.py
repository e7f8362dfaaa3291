"""ZYX Euler angles against products of elementary rotations, and the views against HOUSE's table."""

import math

import numpy as np
import pytest
import torch

from regtorch.errors import RegtorchError
from regtorch.geometry import VIEWS, euler_from_rotation, rotation_from_euler, world_from_ct, world_from_patient_axes

DIRECTIONS = {
    "left": (1, 0, 0), "right": (-1, 0, 0),
    "posterior": (0, 1, 0), "anterior": (0, -1, 0),
    "superior": (0, 0, 1), "inferior": (0, 0, -1),
}  # fmt: skip


def _elementary(axis: int, angle: float) -> np.ndarray:
    """Right-handed turn about one axis, the other two in cyclic order."""
    a, b = (axis + 1) % 3, (axis + 2) % 3
    turn = np.eye(3)
    turn[[a, a, b, b], [a, b, a, b]] = math.cos(angle), -math.sin(angle), math.sin(angle), math.cos(angle)
    return turn


def _angles(*batch: int, dtype: torch.dtype = torch.float64) -> torch.Tensor:
    """Over all of their ranges, theta short of +-90 degrees."""
    uniform = 2 * torch.rand(*batch, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64) - 1
    return (uniform * torch.tensor([3.1, 1.5, 3.1])).to(dtype)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_rotation_is_the_product_of_elementary_ones(dtype):
    angles = _angles(20)
    expected = np.stack([_elementary(2, p) @ _elementary(1, t) @ _elementary(0, e) for e, t, p in angles.tolist()])
    rotation = rotation_from_euler(angles.to(dtype))
    assert rotation.dtype == dtype
    np.testing.assert_allclose(rotation.numpy(), expected, atol=1e-12 if dtype == torch.float64 else 1e-6)


def test_theta_turns_about_the_vertical_axis_from_the_detector_to_the_right():
    # A quarter turn about Y (up) brings what pointed to the source (Z) to where columns grow (X).
    quarter = torch.tensor([0, math.pi / 2, 0], dtype=torch.float64)
    turned = rotation_from_euler(quarter) @ torch.tensor([0, 0, 1.0], dtype=torch.float64)
    torch.testing.assert_close(turned, torch.tensor([1.0, 0, 0], dtype=torch.float64))


@pytest.mark.parametrize("batch", [(), (7,), (2, 3)])
def test_euler_round_trip_in_any_batch_shape(batch):
    angles = _angles(*batch)
    rotation = rotation_from_euler(angles)
    assert rotation.shape == (*batch, 3, 3)
    torch.testing.assert_close(euler_from_rotation(rotation), angles, atol=1e-12, rtol=0)


@pytest.mark.parametrize("theta", [-math.pi / 2, math.pi / 2])
def test_at_gimbal_lock_the_angles_still_give_the_rotation(theta):
    rotation = rotation_from_euler(torch.tensor([0.3, theta, -0.4], dtype=torch.float64))
    angles = euler_from_rotation(rotation)
    assert float(angles[1]) == pytest.approx(theta, abs=1e-7)
    torch.testing.assert_close(rotation_from_euler(angles), rotation, atol=1e-6, rtol=0)


@pytest.mark.parametrize(
    ("view", "x", "y", "z"),
    [
        ("PA", "right", "superior", "posterior"),
        ("AP", "left", "superior", "anterior"),
        ("LLAT", "anterior", "superior", "right"),
        ("LAT", "anterior", "superior", "right"),
        ("RLAT", "posterior", "superior", "left"),
    ],
)
def test_views_are_the_table(view, x, y, z):
    axes = world_from_patient_axes(view)
    assert axes.tolist() == [list(map(float, DIRECTIONS[direction])) for direction in (x, y, z)]
    assert float(torch.linalg.det(axes)) == 1
    at_zero = world_from_ct(torch.tensor([0, 0, 1000.0, 0, 0, 0, 0, 0, 0]), view)
    assert torch.equal(at_zero, torch.block_diag(axes.float(), torch.ones(1, 1)))


def test_every_view_is_in_the_table():
    assert set(VIEWS) == {"PA", "AP", "LAT", "LLAT", "RLAT"}


@pytest.mark.parametrize("view", ["pa", "LATERAL", ""])
def test_an_unknown_view_is_named(view):
    with pytest.raises(RegtorchError, match=f"unknown view '{view}': expected one of PA, AP"):
        world_from_patient_axes(view)
