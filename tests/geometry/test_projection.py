"""Projection against a ray meeting a plane, written out in numpy; its inverse; its derivatives."""

import math

import numpy as np
import pytest
import torch

from regtorch.errors import RegtorchError
from regtorch.geometry import (
    VIEWS,
    Detector,
    parameters_from_matrix,
    pixel_from_patient,
    pixel_from_world,
    project,
    world_from_ct,
)

from .poses import MIDDLE, ORIGIN_MM, random_points, random_poses

DETECTORS = [
    Detector(500, 500, 0.7),
    Detector(125, 301, 1.9),
    Detector(64, 9, 2.5, centre_mm=(31.0, -17.5)),
]


def _ray_meets_plane(pose: list[float], detector: Detector, view: str, points: np.ndarray) -> np.ndarray:
    """(column, row), from the conventions alone: the line from the source through a point, where Z = 0."""
    (x_s, y_s, z_s), t, (eta, theta, phi) = pose[:3], np.array(pose[3:6]), pose[6:]
    c, s = np.cos, np.sin
    rx = np.array([[1, 0, 0], [0, c(eta), -s(eta)], [0, s(eta), c(eta)]])
    ry = np.array([[c(theta), 0, s(theta)], [0, 1, 0], [-s(theta), 0, c(theta)]])
    rz = np.array([[c(phi), -s(phi), 0], [s(phi), c(phi), 0], [0, 0, 1]])
    right, posterior, superior = np.array([-1, 0, 0]), np.array([0, 1, 0]), np.array([0, 0, 1])
    axes = {
        "PA": (right, superior, posterior),
        "AP": (-right, superior, -posterior),
        "LLAT": (-posterior, superior, right),
        "LAT": (-posterior, superior, right),
        "RLAT": (posterior, superior, -right),
    }[view]
    source = np.array([x_s, y_s, z_s])
    pixels = []
    for point in points:
        world = rz @ ry @ rx @ np.array([axis @ (point - ORIGIN_MM.numpy()) for axis in axes]) + t
        along = source[2] / (source[2] - world[2])  # of the way from the source through the point
        x, y, z = source + along * (world - source)
        assert abs(z) < 1e-9
        x, y = x - detector.centre_mm[0], y - detector.centre_mm[1]
        pixels.append(
            ((detector.columns - 1) / 2 + x / detector.pixel_mm, (detector.rows - 1) / 2 - y / detector.pixel_mm)
        )
    return np.array(pixels)


@pytest.mark.parametrize("detector", DETECTORS)
def test_a_point_on_the_detector_projects_to_itself(detector):
    matrix = pixel_from_world(random_poses(6), detector)
    at = torch.tensor([[0, 0], [3, 5], [detector.columns - 1, 0], [0, detector.rows - 1]], dtype=torch.float64)
    x = (at[:, 0] - (detector.columns - 1) / 2) * detector.pixel_mm + detector.centre_mm[0]
    y = ((detector.rows - 1) / 2 - at[:, 1]) * detector.pixel_mm + detector.centre_mm[1]
    pixels = project(matrix, torch.stack([x, y, torch.zeros_like(x)], dim=1))
    torch.testing.assert_close(pixels, at.expand(6, 4, 2), atol=1e-9, rtol=0)


def test_eq_1_with_the_sign_put_right():
    # Source 10 mm to the right at 1000 mm: a point on the axis half way is cast 10 mm to the left, not to the right.
    pose = MIDDLE.clone()
    pose[0] = 10
    column, row = project(pixel_from_world(pose, Detector(101, 101, 1.0)), torch.tensor([[0, 0, 500.0]]))[0].tolist()
    assert (column, row) == (40, 50)


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("detector", DETECTORS)
def test_projection_is_ray_meets_plane(view, detector):
    poses, points = random_poses(5), random_points(8)
    pixels = project(pixel_from_patient(poses, detector, view, ORIGIN_MM), points)
    expected = np.stack([_ray_meets_plane(pose, detector, view, points.numpy()) for pose in poses.tolist()])
    np.testing.assert_allclose(pixels.numpy(), expected, atol=1e-8)
    single = project(pixel_from_patient(poses.float(), detector, view, ORIGIN_MM), points)
    assert single.dtype == torch.float32
    np.testing.assert_allclose(single.numpy(), expected, atol=0.02)


def test_world_from_ct_is_rigid_and_moves_the_origin_to_the_patients_place():
    poses = random_poses(4)
    for view in VIEWS:
        world = world_from_ct(poses, view)
        rotation = world[:, :3, :3]
        torch.testing.assert_close(rotation @ rotation.mT, torch.eye(3, dtype=torch.float64).expand(4, 3, 3))
        torch.testing.assert_close(torch.linalg.det(rotation), torch.ones(4, dtype=torch.float64))
        assert torch.equal(world[:, :3, 3], poses[:, 3:6])
        assert world[:, 3].tolist() == 4 * [[0, 0, 0, 1]]


def test_points_not_in_front_of_the_source_are_not_a_number():
    points = torch.tensor([[0, 0, 999.0], [0, 0, 1000.0], [0, 0, 1001.0], [50, 0, 5000.0], [0, 0, -50.0]])
    pixels = project(pixel_from_world(MIDDLE.float(), Detector(5, 5, 1.0)), points)
    assert pixels.isnan().all(1).tolist() == [False, True, True, True, False]
    assert pixels.isnan().any(1).tolist() == [False, True, True, True, False]


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("scale", [1.0, -1.0, 1e-4, -3e5])
@pytest.mark.parametrize("batch", [(), (6,), (2, 3)])
def test_the_inverse_gives_back_the_nine_parameters(batch, scale, view):
    poses = random_poses(*batch)
    for detector in DETECTORS:
        matrix = scale * pixel_from_patient(poses, detector, view, ORIGIN_MM)
        found = parameters_from_matrix(matrix, detector, view, ORIGIN_MM)
        torch.testing.assert_close(found, poses, atol=1e-7, rtol=0)


@pytest.mark.parametrize("scale", [1.0, -1e-3, 100.0])
def test_the_inverse_in_float32(scale):
    poses, detector = random_poses(20, dtype=torch.float32), DETECTORS[0]
    origin = torch.tensor([0.0, 20, -30])
    matrix = scale * pixel_from_patient(poses, detector, "PA", origin)
    found = parameters_from_matrix(matrix, detector, "PA", origin)
    assert found.dtype == torch.float32
    torch.testing.assert_close(found[:, :6], poses[:, :6], atol=0.05, rtol=0)
    torch.testing.assert_close(found[:, 6:], poses[:, 6:], atol=1e-5, rtol=0)


def test_each_matrix_of_a_batch_has_its_own_scale():
    poses, detector = random_poses(3), DETECTORS[1]
    scale = torch.tensor([1.0, -20.0, 1e-3], dtype=torch.float64)[:, None, None]
    matrix = scale * pixel_from_patient(poses, detector, "LLAT", ORIGIN_MM)
    torch.testing.assert_close(parameters_from_matrix(matrix, detector, "LLAT", ORIGIN_MM), poses, atol=1e-7, rtol=0)


@pytest.mark.parametrize(
    "spoil",
    [
        pytest.param(torch.diag(torch.tensor([1.01, 1.0, 1.0], dtype=torch.float64)), id="oblong pixels"),
        pytest.param(torch.tensor([[1, 0.01, 0], [0, 1, 0], [0, 0, 1]], dtype=torch.float64), id="skewed pixels"),
        pytest.param(torch.zeros(3, 3, dtype=torch.float64), id="zero"),
        pytest.param(torch.full((3, 3), math.nan, dtype=torch.float64), id="not a number"),
    ],
)
def test_a_matrix_that_no_source_makes_is_refused(spoil):
    matrix = spoil @ pixel_from_patient(random_poses(2), DETECTORS[0], "AP", ORIGIN_MM)
    matrix[0] = pixel_from_patient(random_poses(), DETECTORS[0], "AP", ORIGIN_MM)
    with pytest.raises(RegtorchError, match="expected square ones"):
        parameters_from_matrix(matrix, DETECTORS[0], "AP", ORIGIN_MM)


@pytest.mark.parametrize("view", ["PA", "RLAT"])
def test_gradcheck(view):
    detector, poses = DETECTORS[2], random_poses(2).requires_grad_()
    assert torch.autograd.gradcheck(lambda p: pixel_from_patient(p, detector, view, ORIGIN_MM), poses)
    assert torch.autograd.gradcheck(
        lambda p: project(pixel_from_patient(p, detector, view, ORIGIN_MM), random_points(3)), poses
    )
    matrix = pixel_from_patient(poses.detach(), detector, view, ORIGIN_MM)
    # Off the matrices of some pose the answer is a compromise; along them it must be right.
    assert torch.autograd.gradcheck(
        lambda m: parameters_from_matrix(m, detector, view, ORIGIN_MM), matrix.requires_grad_(), atol=1e-4
    )
    there_and_back = torch.autograd.functional.jacobian(
        lambda p: parameters_from_matrix(pixel_from_patient(p, detector, view, ORIGIN_MM), detector, view, ORIGIN_MM),
        poses[0].detach(),
    )
    torch.testing.assert_close(there_and_back, torch.eye(9, dtype=torch.float64), atol=1e-7, rtol=0)
