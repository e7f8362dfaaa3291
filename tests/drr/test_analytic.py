"""Line integrals that are known without a projector: chords of boxes and spheres, a Gaussian, slabs."""

import math
from itertools import pairwise

import numpy as np
import pytest
import torch

from regtorch.drr import render
from regtorch.geometry import VIEWS, Detector, pixel_from_patient, project

from .scenes import pose_of, random_volume, rays_in_ct, relative, volume_of

EXACT = [("torch", torch.float64, 1e-12), ("cpu", torch.float32, 1e-6)]

POSES = {
    "axis-parallel": pose_of(),
    "source to the side": pose_of(source=(40, -25, 900), patient=(3, 4, 280)),
    "oblique": pose_of(source=(5, 5, 400), patient=(-4, 6, 90), degrees=(25, -40, 15)),
    "along a diagonal": pose_of(source=(0, 0, 300), patient=(0, 0, 100), degrees=(35, 45, 0)),
    "upside down": pose_of(degrees=(4, 170, 178)),
    "source in the box": pose_of(source=(2, 1, 100), patient=(0, 0, 97), degrees=(10, 20, 0)),
    "detector in the box": pose_of(source=(2, 1, 500), patient=(0, 0, 3), degrees=(10, 20, 0)),
}


def _chords(half: np.ndarray, source: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Length inside a box around the origin of the ray from the source to each pixel."""
    way = pixels - source
    with np.errstate(divide="ignore", invalid="ignore"):
        to_faces = np.stack([(-half - source) / way, (half - source) / way])
    inside = np.abs(source) <= half
    enter = np.where(way == 0, np.where(inside, 0, 1), to_faces.min(0)).max(-1).clip(0, 1)
    leave = np.where(way == 0, np.where(inside, 1, 0), to_faces.max(0)).min(-1).clip(0, 1)
    return np.maximum(leave - enter, 0) * np.linalg.norm(way, axis=-1)


@pytest.mark.parametrize(("backend", "dtype", "tolerance"), EXACT)
@pytest.mark.parametrize("view", ["PA", "LLAT"])
@pytest.mark.parametrize("name", POSES)
def test_siddon_is_the_chord_of_a_box(name, view, backend, dtype, tolerance):
    # Wide enough that many rays miss it; an odd count both ways, so that one ray runs along the axis.
    detector, spacing = Detector(21, 31, 2.3), (1.5, 2.0, 1.1)
    volume = volume_of(torch.full((9, 8, 11), 0.5, dtype=dtype), spacing)
    half = np.array([11, 8, 9]) * spacing / 2
    expected = torch.from_numpy(0.5 * _chords(half, *rays_in_ct(POSES[name], detector, view)))
    image = render(volume, POSES[name], detector, view, method="siddon", backend=backend)
    assert bool((expected > 0).any())
    assert relative(image, expected) < tolerance
    assert not bool(image[expected == 0].any()), "rays that miss give nothing"


@pytest.mark.parametrize(("backend", "dtype", "tolerance"), EXACT)
def test_siddon_along_a_face_is_on_either_side_and_a_hair_beside_it_is_not_in_doubt(backend, dtype, tolerance):
    volume = volume_of(torch.ones(4, 6, 5, dtype=dtype), (2.0, 3.0, 1.0))
    face = 5.0  # of the box, along x
    for offset, allowed in ((0.0, (0.0, 18.0)), (-1e-6, (18.0,)), (1e-6, (0.0,))):
        x = -(face + offset)  # PA: columns grow to the patient's right
        pose = pose_of(source=(x, 0, 1000))
        detector = Detector(1, 1, 1.0, centre_mm=(x, 0.0))
        found = float(render(volume, pose, detector, "PA", method="siddon", backend=backend))
        assert min(abs(found - value) for value in allowed) < 18 * tolerance


@pytest.mark.parametrize("method", ["siddon", "joseph"])
def test_a_ray_along_faces_between_voxels_reads_the_same_voxels_in_every_backend(method):
    # Nothing unusual: an even CT seen straight on by an odd detector.
    volume = random_volume(6, 8, 10)
    for view in VIEWS:
        images = [
            render(v, pose_of(), Detector(5, 7, 1.0), view, method=method, backend=b)
            for v, b in ((volume, "cpu"), (volume.with_data(volume.data.double()), "torch"))
        ]
        assert relative(*images) < 1e-6


@pytest.mark.parametrize("method", ["siddon", "joseph", "trilinear"])
@pytest.mark.parametrize("view", VIEWS)
def test_a_voxel_is_seen_where_the_projection_matrix_says(view, method):
    data = torch.zeros(12, 13, 14)
    data[9, 2, 4] = 1
    volume = volume_of(data, (2.0, 1.5, 2.5))
    pose, detector = pose_of((30, -20, 900), (5, 8, 300), (6, -12, 20)), Detector(120, 130, 1.0, centre_mm=(3.0, -2.0))
    image = render(volume, pose, detector, view, method=method).double()
    rows, columns = torch.meshgrid(*(torch.arange(n).double() for n in image.shape), indexing="ij")
    found = torch.stack([(columns * image).sum(), (rows * image).sum()]) / image.sum()
    point = volume.patient_from_voxel @ torch.tensor([4, 2, 9, 1.0], dtype=torch.float64)
    expected = project(pixel_from_patient(pose, detector, view, volume.origin_patient_mm), point[None, :3])[0]
    torch.testing.assert_close(found, expected, atol=0.25, rtol=0)


@pytest.mark.parametrize(("backend", "dtype", "tolerance"), EXACT)
@pytest.mark.parametrize("view", VIEWS)
def test_joseph_through_a_wide_slab_is_exact(view, backend, dtype, tolerance):
    shape = (40, 6, 40) if view in ("PA", "AP") else (40, 40, 6)
    volume = volume_of(torch.full(shape, 0.3, dtype=dtype), (3.0, 3.0, 4.0))
    pose, detector = pose_of((20, -30, 800), (0, 0, 200), (5, -8, 30)), Detector(9, 9, 4.0)
    source, pixels = rays_in_ct(pose, detector, view)
    across = 1 if view in ("PA", "AP") else 0
    way = pixels - source
    expected = 0.3 * 18 * np.linalg.norm(way, axis=-1) / np.abs(way[..., across])
    assert relative(render(volume, pose, detector, view, backend=backend), torch.from_numpy(expected)) < tolerance


def test_siddon_through_a_sphere_of_voxels_nears_its_chord_as_they_shrink():
    radius, errors = 18.0, []
    pose, detector = pose_of((10, 5, 500), (2, -3, 150), (20, 30, 10)), Detector(25, 25, 2.0)
    source, pixels = rays_in_ct(pose, detector, "PA")
    way = (pixels - source) / np.linalg.norm(pixels - source, axis=-1, keepdims=True)
    distance = np.linalg.norm(np.cross(way, source), axis=-1)
    expected = torch.from_numpy(2 * np.sqrt(np.maximum(radius**2 - distance**2, 0)))
    for voxel in (4.0, 2.0, 1.0, 0.5):
        n = math.ceil(2 * radius / voxel) + 1
        axis = (torch.arange(n) - (n - 1) / 2) * voxel
        z, y, x = torch.meshgrid(axis, axis, axis, indexing="ij")
        sphere = (x**2 + y**2 + z**2 <= radius**2).float()
        image = render(volume_of(sphere, (voxel,) * 3), pose, detector, "PA", method="siddon", backend="cpu")
        errors.append(relative(image, expected))
    assert all(fine < 0.75 * coarse for coarse, fine in pairwise(errors)), errors
    assert errors[-1] < 0.015


def test_the_methods_agree_better_and_better_on_a_smooth_object_as_voxels_shrink():
    sigma = 9.0
    pose, detector = pose_of((15, -5, 500), (4, 3, 150), (15, -30, 10)), Detector(15, 18, 4.0)
    source, pixels = rays_in_ct(pose, detector, "PA")
    way = (pixels - source) / np.linalg.norm(pixels - source, axis=-1, keepdims=True)
    distance = np.linalg.norm(np.cross(way, source), axis=-1)
    expected = torch.from_numpy(math.sqrt(2 * math.pi) * sigma * np.exp(-(distance**2) / (2 * sigma**2)))
    errors = {"joseph": [], "trilinear": [], "siddon": []}
    between = []
    for scale in (4.0, 2.0, 1.0):
        spacing = (1.0 * scale, 1.2 * scale, 0.8 * scale)
        axes = []
        for step in reversed(spacing):
            n = 2 * round(5 * sigma / step) + 1
            axes.append(torch.exp(-(((torch.arange(n) - n // 2) * step / sigma) ** 2) / 2).double())
        volume = volume_of(torch.einsum("k,j,i->kji", *axes), spacing)
        images = {m: render(volume, pose, detector, "PA", method=m, backend="torch") for m in errors}
        for method, image in images.items():
            errors[method].append(relative(image, expected))
        between.append(max(relative(images[a], images["joseph"]) for a in ("trilinear", "siddon")))
    for sequence in (*errors.values(), between):
        assert all(fine < coarse / 3 for coarse, fine in pairwise(sequence)), (errors, between)
        # Of second order: a quarter of the error at half the spacing.
        assert sequence[1] / sequence[2] == pytest.approx(4, rel=0.2), (errors, between)
    assert max(sequence[-1] for sequence in errors.values()) < 2e-3, errors
