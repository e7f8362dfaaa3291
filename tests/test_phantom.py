"""The phantom: the same plausible torso at every call and spacing, nearly but not exactly periodic and symmetric."""

from itertools import pairwise

import numpy as np
import pytest
import torch

from regtorch.errors import RegtorchError
from regtorch.phantom import make_phantom, raster
from regtorch.phantom.shapes import capsule, drum, loft, sheet, smooth, triangle

NAMES = ["C7", *(f"T{i}" for i in range(1, 13)), *(f"L{i}" for i in range(1, 6)), "S1"]
BONE_HU = 100


@pytest.fixture(scope="module")
def phantom():
    return make_phantom(3.0)


def voxel_of(volume, point):
    """(k, j, i) nearest to a point in LPS mm."""
    ijk = torch.linalg.inv(volume.patient_from_voxel) @ torch.tensor([*point, 1.0], dtype=torch.float64)
    return [round(float(v)) for v in reversed(ijk[:3])]


def around(volume, point, reach=6):
    k, j, i = voxel_of(volume, point)
    return volume.data[k - reach + 2 : k + reach - 1, j - reach : j + reach + 1, i - reach : i + reach + 1].double()


def painted(*rows, spacing=1.0, half=40):
    """Share of each voxel that solids cover, on a cube about the origin."""
    n = round(2 * half / spacing) + 1
    volume = np.zeros((n, n, n), np.float32)
    shapes = np.concatenate([row.reshape(-1, row.shape[-1]) for row in rows])
    raster.paint(volume, np.full(3, -(n - 1) / 2 * spacing), spacing, [raster.Part(shapes, 1.0, 1.0)], 0)
    return volume


def test_grid(phantom):
    volume, targets = phantom
    assert volume.unit == "HU"
    assert volume.name == "phantom"
    assert volume.data.dtype == torch.float32
    torch.testing.assert_close(volume.patient_from_voxel[:3, :3], 3 * torch.eye(3, dtype=torch.float64))
    extent = torch.tensor(volume.data.shape) * 3
    assert extent.tolist() == [660, 264, 384]
    assert list(targets) == NAMES


def test_same_at_every_call_and_with_any_number_of_threads(phantom, monkeypatch):
    volume, targets = phantom
    monkeypatch.setattr(raster.os, "cpu_count", lambda: 1)
    again, again_targets = make_phantom(3.0)
    assert torch.equal(volume.data, again.data)
    assert targets == again_targets


@pytest.mark.parametrize("spacing", [2.0, 5.0])
def test_mass_does_not_depend_on_spacing(phantom, spacing):
    def masses(volume):
        cube = volume.spacing_mm.prod()
        data = volume.data.double()
        return (data + 1000).sum() * cube, (data - 50)[data >= BONE_HU].sum() * cube  # bone: what it adds to muscle

    for mass, other in zip(masses(phantom[0]), masses(make_phantom(spacing)[0]), strict=True):
        assert float(other / mass) == pytest.approx(1, abs=0.03)


def test_targets_do_not_depend_on_spacing(phantom):
    assert make_phantom(6.0)[1] == phantom[1]


def test_targets_lie_in_cancellous_bone(phantom):
    volume, targets = phantom
    for name, point in targets.items():
        k, j, i = voxel_of(volume, point)
        middle = volume.data[k - 1 : k + 2, j - 1 : j + 2, i - 1 : i + 2]
        assert 150 < float(middle.mean()) < 350, name


def test_spine_descends_with_its_curves(phantom):
    _, targets = phantom
    points = {name: np.array(targets[name]) for name in NAMES}
    steps = [points[a] - points[b] for a, b in pairwise(NAMES)]
    assert all(15 < np.linalg.norm(step) < 45 and step[2] > 0 for step in steps)
    assert points["T7"][1] > points["T1"][1] + 10  # kyphosis: the middle lies further back than both ends
    assert points["T7"][1] > points["L1"][1] + 10
    assert points["L3"][1] < points["S1"][1] - 10  # lordosis
    assert max(abs(p[0]) for p in points.values()) < 15


def test_neighbours_are_alike_but_not_the_same(phantom):
    volume, targets = phantom
    for upper, lower in pairwise(NAMES[2:-2]):
        patches = torch.stack([around(volume, targets[name]).flatten() for name in (upper, lower)])
        correlation = float(torch.corrcoef(patches)[0, 1])
        assert 0.4 < correlation < 0.98, (upper, lower, correlation)


def test_mirror_image_is_another(phantom):
    data = phantom[0].data.double().clamp(min=-1000)
    for part in (data, (data - BONE_HU).clamp(min=0)):
        frontal = part.mean(dim=1)
        difference = (frontal - frontal.flip(-1)).abs().mean() / (frontal - frontal.min()).mean()
        assert difference > 0.03


def test_plausible_hounsfield_units():
    data = make_phantom(1.5)[0].data
    assert bool(torch.isfinite(data).all())
    assert float(data.min()) == -1000
    assert 900 < float(data.max()) < 1200
    share = torch.histc(data, 22, -1000, 1200) / data.numel()  # steps of 100 HU
    assert share[0] > 0.2  # air, and
    assert share[1:3].sum() > 0.04  # lung
    assert share[9:11].sum() > 0.3  # fat and muscle
    assert 0.02 < share[11:].sum() < 0.06  # bone


def test_only_bone_is_over_the_threshold(phantom, monkeypatch):
    for name in ("thorax_parts", "pelvis_parts", "spine_parts"):
        monkeypatch.setattr(f"regtorch.phantom.{name}", lambda *_: [])
    soft, _ = make_phantom(3.0)
    assert float(soft.data.max()) < 90
    inside = soft.data[phantom[0].data >= BONE_HU]
    assert float((inside < -900).double().mean()) < 0.02  # and none of it sticks out of the skin


@pytest.mark.parametrize("spacing", [0.5, 7.0, 0.0, -1.0, float("nan"), float("inf")])
def test_implausible_spacing(spacing):
    with pytest.raises(RegtorchError, match=r"spacing of .* mm, expected 0\.8 to 6"):
        make_phantom(spacing)


@pytest.mark.parametrize("spacing", [1.0, 4.0])
def test_volumes_of_solids(spacing):
    ball = painted(capsule((0, 0, 0), (0, 0, 0), 20, 20), spacing=spacing)
    assert ball.sum() * spacing**3 == pytest.approx(4 / 3 * np.pi * 20**3, rel=0.02)
    rod = painted(capsule((-15, 0, 0), (15, 0, 0), 10, 10), spacing=spacing)
    assert rod.sum() * spacing**3 == pytest.approx(np.pi * 10**2 * 30 + 4 / 3 * np.pi * 10**3, rel=0.02)
    column = painted(loft([(0, 0, -60, 12, 8), (3, 0, 0, 12, 8), (0, 0, 60, 12, 8)]), spacing=spacing)
    assert column.sum() * spacing**2 / len(column) == pytest.approx(np.pi * 12 * 8, rel=0.02)
    plate = painted(triangle((-25, 0, -20), (25, 0, -20), (0, 0, 25), (4, 4, 4)), spacing=spacing)
    edges = 50 + 2 * np.hypot(25, 45)
    volume = 8 * 0.5 * 50 * 45 + edges * np.pi * 4**2 / 2 + 4 / 3 * np.pi * 4**3  # plate, rounded edges, corners
    assert plate.sum() * spacing**3 == pytest.approx(volume, rel=0.03)
    tin = painted(drum((0, 0, 0), np.eye(3), 20, (40, 40), (30, 30), waist=0, dish=0), spacing=spacing)
    assert 0.85 < tin.sum() * spacing**3 / (np.pi * 20 * 15 * 20) < 1  # less its hollow back and rounded rims


def test_carving_takes_away():
    ball, hole = capsule((0, 0, 0), (0, 0, 0), 20, 20), capsule((0, -50, 0), (0, 50, 0), 6, 6, carve=True)
    volume = painted(ball, hole)
    middle = volume.shape[0] // 2
    assert volume[middle, :, middle].max() == 0
    assert volume[middle + 10, middle, middle] == 1


def test_spline_and_sheet_pass_through_their_points():
    points = np.random.default_rng(0).normal(size=(5, 3))
    np.testing.assert_allclose(smooth(points, 4)[::4], points, atol=1e-12)
    grid = np.array([[(x, 0.01 * x * z, z, 2.0) for z in (-20, 0, 20)] for x in (-20, 0, 20)])
    volume = painted(sheet(grid))
    middle = volume.shape[0] // 2
    assert all(volume[middle + z, middle, middle] == 1 for z in (-20, 0, 20))


def test_texture_is_bounded_smooth_and_of_mean_zero():
    noise = raster.texture(1)
    assert np.abs(noise).max() == pytest.approx(1)
    assert abs(noise.mean()) < 0.01
    assert np.corrcoef(noise[:-1].ravel(), noise[1:].ravel())[0, 1] > 0.3
