"""True geometries lie within three deviations of the default, show what they should, and are the same for a seed."""

import math
from dataclasses import replace

import pytest
import torch

from experiments.simulation.geometries import bone_voxels, misplacement
from experiments.simulation.study import Study
from regtorch.errors import RegtorchError
from regtorch.evaluation import projection_distances
from regtorch.geometry import pixel_from_patient, project, world_from_ct
from regtorch.imaging import attenuation


@pytest.fixture(scope="module")
def study(settings) -> Study:
    return Study(settings("detector={rows: 500, columns: 500, pixel_mm: 0.7}"))


def test_draws_are_near_show_the_spine_and_repeat(study):
    for view in ("PA", "LAT"):
        geometries = study.geometries(view)
        for seed in range(100):
            true, _ = geometries.draw(seed)
            assert bool(((true - geometries.default).abs() <= 3 * geometries.deviations).all())
            matrix = pixel_from_patient(true, study.detector, view, study.ct.origin_patient_mm)
            pixels = project(matrix, geometries.targets)
            assert int(((pixels >= 0) & (pixels <= 499)).all(1).sum()) >= 2
            height = (geometries.bone @ world_from_ct(true, view)[:3, :3].mT)[:, 2] + true[5]
            assert 0 < float(height.min()) < float(height.max()) < float(true[2])
        assert torch.equal(true, geometries.draw(seed)[0])


def test_the_initial_pde_is_the_papers_and_few_geometries_are_drawn_again(study):
    distances, again = [], 0
    for view in ("PA", "LAT"):
        geometries = study.geometries(view)
        place = study.detector, view, study.ct.origin_patient_mm
        for seed in range(300):
            true, redrawn = geometries.draw(seed)
            again += redrawn
            matrix = pixel_from_patient(true, *place)
            pixels = project(matrix, geometries.targets)
            shown = geometries.targets[((pixels >= 0) & (pixels <= 499)).all(1)]
            start = pixel_from_patient(geometries.default, *place)
            distances.append(float(projection_distances(start, matrix, shown, 0.7).mean()))
    assert 110 < float(torch.tensor(distances).median()) < 130
    assert 0 < again < 0.1 * 600


def test_errors_are_normal_and_truncated(study):
    wide = replace(study.geometries("PA"), least_targets=0, bone=torch.zeros(1, 3, dtype=torch.float64))
    errors = torch.stack([(wide.draw(seed)[0] - wide.default) / wide.deviations for seed in range(2000)])
    assert float(errors.abs().max()) < 3
    assert float(errors.mean().abs()) < 0.03
    assert float(errors.std()) == pytest.approx(0.9867, abs=0.02)  # of a normal distribution truncated at three


def test_deviations_that_show_nothing_are_refused(study):
    with pytest.raises(RegtorchError, match=r"none of 100 geometries.*expected smaller ones"):
        replace(study.geometries("PA"), least_targets=20).draw(0)


def test_the_marker_lies_in_the_middle_of_the_default_image(study):
    for view in ("PA", "LAT"):
        default = study.geometries(view).default
        matrix = pixel_from_patient(default, study.detector, view, study.ct.origin_patient_mm)
        marker = torch.tensor([study.targets["L3"]], dtype=torch.float64)
        assert torch.allclose(project(matrix, marker), torch.tensor([[249.5, 249.5]], dtype=torch.float64))


def test_bone_voxels_are_where_the_bone_is(study):
    bone, kept = bone_voxels(study.ct), attenuation(study.ct)
    assert len(bone) == int((kept.data > 0).sum())  # the phantom has voxels of 6 mm
    in_voxels = bone @ kept.voxel_from_ct[:3, :3].mT + kept.voxel_from_ct[:3, 3]
    i, j, k = in_voxels.round().long().unbind(1)
    assert bool((kept.data[k, j, i] > 0).all())


def test_squares_of_figure_2_are_square_where_nothing_is_misplaced_and_moved_where_the_patient_is():
    true = torch.tensor([0, 0, 1000, 0, 0, 300, 0, 0, 0], dtype=torch.float64)
    marker = torch.tensor([4, -3, 50], dtype=torch.float64)
    row = misplacement(true, true, marker, "PA")
    depth = 1000 - (300 - 3)
    assert row["marker_x_mm"] == pytest.approx(-4 * 1000 / depth)
    assert row["marker_y_mm"] == pytest.approx(50 * 1000 / depth)
    half = 20 * 1000 / depth
    corners = [(row[f"corner{n}_x_mm"], row[f"corner{n}_y_mm"]) for n in (1, 2, 3, 4)]
    wanted = [(-half, half), (half, half), (half, -half), (-half, -half)]
    assert [pytest.approx(corner) for corner in wanted] == corners
    moved = misplacement(true + torch.tensor([0, 0, 0, 7.0, 0, 0, 0, 0, 0]), true, marker, "PA")
    assert moved["corner1_x_mm"] - row["corner1_x_mm"] == pytest.approx(7 * 1000 / depth)
    assert moved["marker_x_mm"] == row["marker_x_mm"]
    turned = misplacement(true, true + torch.tensor([0, 0, 0, 0, 0, 0, 0, 0, 0.1]), marker, "PA")
    assert turned["corner2_y_mm"] - turned["corner1_y_mm"] == pytest.approx(-2 * half * math.sin(0.1))
