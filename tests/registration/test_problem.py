"""The input of a search method: bounds, the free parameters among the nine, distances in the detector plane."""

from dataclasses import replace

import torch

from regtorch.drr import render
from regtorch.geometry import world_from_ct

from .conftest import DETECTOR, HALF_RANGE
from .test_search import matcher_of

ALL, PATIENT = list(range(9)), [3, 4, 5, 6, 7, 8]


def _close(found, expected, tolerance=1e-9):
    torch.testing.assert_close(found, torch.as_tensor(expected, dtype=torch.float64), atol=tolerance, rtol=tolerance)


def test_bounds_lie_half_a_range_on_either_side_of_the_start(pair):
    half = torch.tensor(HALF_RANGE, dtype=torch.float64)
    for free in (ALL, PATIENT, [2, 6]):
        problem = pair.problem(free)
        _close(problem.unknowns.lower, (pair.initial - half)[free])
        _close(problem.unknowns.upper, (pair.initial + half)[free])


def test_the_source_stays_in_front_of_the_detector(pair):
    half = torch.tensor(HALF_RANGE, dtype=torch.float64)
    half[2] = 2000
    problem = pair.problem(ALL, half_range=half)
    assert problem.unknowns.lower[2] == 250
    assert problem.unknowns.upper[2] == 3000
    _close(pair.problem(PATIENT, half_range=half).unknowns.lower, (pair.initial - half)[PATIENT])


def test_embed_moves_what_is_free_and_keeps_the_rest(pair):
    problem = pair.problem([2, 7])
    values = torch.tensor([[[900.0, 0.1], [950.0, 0.2]], [[1000.0, 0.3], [1050.0, 0.4]]], dtype=torch.float64)
    found = problem.parameters(values)
    assert found.shape == (2, 2, 9)
    assert torch.equal(found[..., [2, 7]], values)
    rest = [0, 1, 3, 4, 5, 6, 8]
    assert torch.equal(found[..., rest], pair.initial[rest].expand(2, 2, 7))
    assert problem.parameters(values[0, 0]).shape == (9,)
    found[0, 0, 0] = 77
    assert problem.searched.initial[0] == 0


def test_shift_is_the_mean_distance_between_projections(pair):
    problem = pair.problem(ALL)
    z = _heights(pair, problem)
    sdd, moved = float(pair.initial[2]), pair.initial.clone()
    moved[3] += 3
    _close(problem.shift_mm(moved, pair.initial), float((3 * sdd / (sdd - z)).mean()))
    assert problem.shift_mm(moved, moved) == 0
    both = torch.stack([pair.initial, moved])
    assert problem.shift_mm(both, pair.initial).shape == (2,)
    behind = pair.initial.clone()
    behind[5] = 2000
    assert problem.shift_mm(behind, pair.initial).isinf()


def test_sensitivity_is_that_of_similar_triangles(pair):
    problem = pair.problem(ALL)
    z = _heights(pair, problem)
    sdd = float(pair.initial[2])
    found = problem.sensitivity
    _close(found[[3, 4]], [float((sdd / (sdd - z)).mean())] * 2, 1e-6)
    _close(found[[0, 1]], [float((z / (sdd - z)).mean())] * 2, 1e-6)
    _close(pair.problem([0, 4]).sensitivity, found[[0, 4]])
    # The coupling of source and patient that the paper describes: some 300 mm of one look like 100 of the other.
    assert 3 < float(found[3] / found[0]) < 15


def test_a_level_is_averaged_to_match_and_rates_the_truth_best(pair):
    problem = pair.problem(PATIENT)
    level = matcher_of(problem, problem.attenuating, 32)
    assert (level.fixed.detector.rows, level.fixed.detector.columns) == (32, 25)
    magnification = 1000 / (1000 - float(pair.initial[5]))
    voxel = max(6.0, 1.3 * level.fixed.detector.pixel_mm / magnification)
    _close(level.volume.spacing_mm, [voxel] * 3, 1e-6)
    truth = pair.truth.parameters
    off = truth.repeat(10, 1)
    off[torch.arange(1, 10), torch.arange(9)] += torch.tensor(HALF_RANGE) / 2
    similarities = level.similarity(off)
    assert similarities.dtype == torch.float64
    assert similarities[0] > 0.9
    assert similarities.argmax() == 0
    assert level.similarity(off[:0]).shape == (0,)


def _heights(pair, problem):
    world = world_from_ct(pair.initial, "PA")
    return ((problem.points - pair.ct.origin_patient_mm) @ world[:3, :3].mT + world[:3, 3])[:, 2]


def test_the_mirrored_problem_has_the_mirrored_drr(pair):
    problem = pair.problem(list(range(9)), initial=pair.truth.parameters)
    mirrored = problem.mirrored()
    symmetric = problem.whole.with_data(problem.whole.data + problem.whole.data.flip(2))
    centre = symmetric.patient_from_voxel @ torch.tensor([(symmetric.data.shape[2] - 1) / 2, 0, 0, 1.0]).double()
    symmetric = replace(symmetric, origin_patient_mm=torch.cat([centre[:1], problem.whole.origin_patient_mm[1:]]))
    image = render(symmetric, problem.searched.initial, DETECTOR)
    torch.testing.assert_close(
        render(symmetric, mirrored.searched.initial, DETECTOR), image.flip(1), rtol=1e-3, atol=1e-3
    )
    assert torch.equal(mirrored.radiograph.image, problem.radiograph.image.flip(1))
    assert torch.equal(mirrored.mirrored().searched.initial, problem.searched.initial)
