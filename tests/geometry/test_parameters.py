"""Order, units and freedom of the nine parameters."""

import math

import pytest
import torch

from regtorch.errors import RegtorchError
from regtorch.geometry import KEYS, NAMES, free_indices, parameters_from_dict, parameters_to_dict

from .poses import random_poses


def test_order_and_units_are_the_contract():
    assert NAMES == ("x_s", "y_s", "z_s", "x_obj", "y_obj", "z_obj", "eta", "theta", "phi")
    assert " ".join(KEYS) == "x_s_mm y_s_mm z_s_mm x_obj_mm y_obj_mm z_obj_mm eta_deg theta_deg phi_deg"


@pytest.mark.parametrize(
    ("free", "expected"),
    [
        (9, [0, 1, 2, 3, 4, 5, 6, 7, 8]),
        (7, [2, 3, 4, 5, 6, 7, 8]),
        (6, [3, 4, 5, 6, 7, 8]),
        (["phi", "x_s"], [0, 8]),
        (("z_s",), [2]),
        (NAMES, [0, 1, 2, 3, 4, 5, 6, 7, 8]),
    ],
)
def test_free_parameters_by_number_or_name_come_in_their_order(free, expected):
    assert free_indices(free) == expected


@pytest.mark.parametrize(
    ("free", "message"),
    [
        (5, r"5 degrees of freedom: expected one of \[6, 7, 9\]"),
        (0, "0 degrees of freedom"),
        (["x_s", "yaw"], "unknown parameter 'yaw': expected one of x_s, y_s"),
        ([], "every parameter is frozen"),
    ],
)
def test_freedom_that_makes_no_sense_is_refused(free, message):
    with pytest.raises(RegtorchError, match=message):
        free_indices(free)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_dictionaries_are_in_degrees_and_come_back_in_radians(dtype):
    pose = random_poses(dtype=dtype)
    written = parameters_to_dict(pose)
    assert tuple(written) == KEYS
    assert written["z_s_mm"] == float(pose[2])
    assert written["theta_deg"] == pytest.approx(math.degrees(pose[7]))
    back = parameters_from_dict(written)
    assert back.dtype == torch.float64
    torch.testing.assert_close(back, pose.double(), atol=1e-12, rtol=0)


def test_a_dictionary_may_hold_more_but_not_less():
    written = parameters_to_dict(random_poses())
    assert parameters_from_dict({**written, "note": 1.0}).shape == (9,)
    del written["eta_deg"]
    with pytest.raises(RegtorchError, match="parameter 'eta_deg' is missing"):
        parameters_from_dict(written)
