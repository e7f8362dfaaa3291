"""Poses in the conventions of other tools project points as regtorch's own matrix does."""

import pytest
import torch

from regtorch.geometry import Detector, pixel_from_patient, project
from regtorch.geometry.conventions import to_camera, to_plastimatch, to_rtk

from .poses import ORIGIN_MM, random_points, random_poses

VIEWS = ("PA", "AP", "LLAT", "RLAT")
WHOLE, CROPPED = Detector(60, 90, 4.0), Detector(60, 90, 4.0).crop(10, 50, 20, 85)
POSES, POINTS = random_poses(200), random_points(30)


def _expected(detector: Detector, view: str) -> torch.Tensor:
    return project(pixel_from_patient(POSES, detector, view, ORIGIN_MM), POINTS)


def _on_plane(source, origin, normal):
    """Where rays from the source [n, 3] through the points meet the plane through ``origin``."""
    ray = POINTS - source[:, None]
    share = ((origin - source) * normal).sum(1)[:, None] / (ray * normal[:, None]).sum(-1)
    return source[:, None] + share[..., None] * ray


@pytest.mark.parametrize("view", VIEWS)
def test_rtk(view):
    seen = to_rtk(POSES, view, ORIGIN_MM)
    normal = torch.linalg.cross(seen.columns, seen.rows)
    offset = _on_plane(seen.source, seen.detector, normal) - seen.detector[:, None]
    along = torch.stack([(offset * axis[:, None]).sum(-1) for axis in (seen.columns, seen.rows)], dim=-1)
    middle = torch.tensor([(WHOLE.columns - 1) / 2, (WHOLE.rows - 1) / 2])
    torch.testing.assert_close(along / WHOLE.pixel_mm + middle, _expected(WHOLE, view), atol=1e-9, rtol=1e-9)


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("detector", [WHOLE, CROPPED], ids=["whole", "cropped"])
def test_camera(detector, view):
    camera = to_camera(POSES, detector, view, ORIGIN_MM)
    homogeneous = torch.cat([POINTS, torch.ones(len(POINTS), 1)], dim=1)
    seen = homogeneous @ torch.linalg.inv(camera.patient_from_camera).mT[:, :, :3]
    assert bool((seen[..., 2] > 0).all())
    pixel = (seen / seen[..., 2:]) @ camera.pixel_from_camera.mT
    torch.testing.assert_close(pixel[..., :2] - 0.5, _expected(detector, view), atol=1e-9, rtol=1e-9)


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("detector", [WHOLE, CROPPED], ids=["whole", "cropped"])
def test_plastimatch(detector, view):
    seen = to_plastimatch(POSES, detector, view, ORIGIN_MM)
    source = seen.isocenter + seen.distance[:, None] * seen.normal
    right = torch.linalg.cross(seen.up, seen.normal)
    offset = _on_plane(source, seen.isocenter, seen.normal) - seen.isocenter[:, None]
    along = torch.stack([(offset * axis[:, None]).sum(-1) for axis in (right, -seen.up)], dim=-1)
    pixel = along / detector.pixel_mm + seen.image_center[:, None]
    torch.testing.assert_close(pixel, _expected(detector, view), atol=1e-9, rtol=1e-9)
