"""``register``: a small registration end to end, and the effect of its options."""

import math
from dataclasses import replace
from functools import partial

import pytest
import torch

from regtorch.errors import RegtorchError
from regtorch.evaluation import evaluate
from regtorch.geometry import KEYS, pixel_from_patient, project
from regtorch.imaging import Radiograph
from regtorch.optimization import cma_es, pycma
from regtorch.registration import cmaes, register
from regtorch.registration.found import Found
from regtorch.registration.start import SEARCH
from regtorch.registration.trust.evidence import measure

from .conftest import DETECTOR, HALF_RANGE
from .test_search import matcher_of

SMALL = partial(cmaes, starts=8, generations=20, pixels=(24, 40), survivors=2, finalists=1, final_generations=30)


class Told:
    """A method that does not search but records its problem."""

    def __call__(self, problem):
        self.problem = problem
        initial = problem.searched.initial
        starts, similarity = initial.repeat(3, 1), torch.tensor([0.5, 0.5, 0.5]).double()
        return Found(
            initial, 0.5, starts, similarity, 3, measure(problem, initial, 0.5, starts, similarity, comparable=True)
        )


def test_finds_where_a_matched_radiograph_was_taken(pair):
    told = []
    found = register(
        pair.ct,
        pair.radiograph,
        "PA",
        method=SMALL,
        half_range=torch.tensor(HALF_RANGE),
        progress=lambda share, what: told.append((share, what)),
    )
    assert evaluate(found.to_dict(), pair.truth.to_dict())["pde_mm"] < 1
    assert found.status == "ok", found.message
    assert found.similarity > 0.9
    shares = [share for share, _ in told]
    assert shares == sorted(shares)
    assert 0 < shares[0] < 0.1
    assert shares[-1] <= 1
    matrix = pixel_from_patient(found.parameters, DETECTOR, "PA", pair.ct.origin_patient_mm)
    torch.testing.assert_close(found.pixel_from_patient, matrix)
    assert found.starts.shape == (8, 9)
    assert bool((found.start_similarity.diff() <= 0).all())


def test_the_same_seed_gives_the_same_result_and_another_seed_another(pair):
    quick = partial(cmaes, starts=3, generations=2, pixels=(16, 20), final_generations=2)
    one, same, other = (register(pair.ct, pair.radiograph, "PA", method=quick, seed=seed) for seed in (4, 4, 5))
    assert torch.equal(one.parameters, same.parameters)
    assert one.similarity == same.similarity
    assert torch.equal(one.starts, same.starts)
    assert not torch.equal(one.parameters, other.parameters)


@pytest.mark.parametrize(("free", "moving"), [(9, 9), (7, 7), (6, 6), (["phi", "x_obj"], 2)])
def test_only_what_is_free_moves(pair, free, moving):
    quick = partial(cmaes, starts=3, generations=2, pixels=(16, 20), final_generations=2)
    found = register(pair.ct, pair.radiograph, "PA", method=quick, free=free)
    assert int((found.parameters != pair.initial).sum()) == moving
    if free == 6:
        assert found.parameters[:3].tolist() == [0, 0, 1000]


def test_converges_as_pycma_does_on_a_registration(pair):
    free = [3, 4, 5, 6, 7, 8]
    problem = pair.problem(free, initial=pair.truth.parameters)
    unknowns, level = problem.unknowns, matcher_of(problem, problem.attenuating, 24)
    goal = float(level.similarity(pair.truth.parameters[None])) - 3e-3
    starts, population = 8, 9
    spread = unknowns.upper - unknowns.lower
    random = torch.rand(starts, len(free), generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    begin = unknowns.lower + (0.2 + 0.6 * random) * spread
    generations = {}
    for optimizer in (cma_es, pycma):
        reached = torch.full((starts,), math.inf)

        def note(generation, running, cost, reached=reached):
            reached[(-cost >= goal) & reached.isinf()] = generation

        optimizer(
            lambda values: -level.similarity(problem.parameters(values)),
            begin,
            0.1 * spread,
            lower=unknowns.lower,
            upper=unknowns.upper,
            population=population,
            max_generations=45,
            tol_fun=1e-4,
            on_generation=note,
        )
        assert int(reached.isfinite().sum()) >= starts - 1
        generations[optimizer.__name__] = float(reached.median())
    assert 0.67 < generations["cma_es"] / generations["pycma"] < 1.5, generations


def test_a_landmark_is_given_in_the_pixels_of_the_file(pair):
    mirror = torch.tensor([[-1, 0, DETECTOR.columns - 1], [0, 1, 0], [0, 0, 1]], dtype=torch.float64)
    flipped = Radiograph(
        pair.radiograph.image, DETECTOR, pair.radiograph.weight, stored_from_pixel=mirror, name="flipped"
    )
    landmark = (20.0, -10.0, 150.0)
    point = torch.tensor([landmark], dtype=torch.float64)
    results = []
    for radiograph, pixel in ((pair.radiograph, (30.0, 40.0)), (flipped, (DETECTOR.columns - 1 - 30.0, 40.0))):
        found = register(pair.ct, radiograph, "PA", method=Told(), landmark_patient_mm=landmark, landmark_stored=pixel)
        torch.testing.assert_close(
            project(found.pixel_from_patient, point)[0], torch.tensor(pixel, dtype=torch.float64)
        )
        results.append(found)
    plain, mirrored = results
    torch.testing.assert_close(plain.initial, mirrored.initial)
    torch.testing.assert_close(plain.image_from_patient, mirrored.image_from_patient)
    assert (plain.mirrored, mirrored.mirrored) == (False, True)


def test_the_sdd_is_what_was_told_then_what_the_file_says_then_the_protocols(pair):
    stated = Radiograph.from_image(pair.radiograph.image, DETECTOR, sdd_mm=1200.0)
    for radiograph, told, expected in ((pair.radiograph, None, 1000), (stated, None, 1200), (stated, 1500.0, 1500)):
        assert register(pair.ct, radiograph, "PA", method=Told(), sdd_mm=told).initial[2] == expected


def test_a_start_and_a_range_that_are_given_are_used(pair):
    method, initial = Told(), pair.truth.parameters
    found = register(pair.ct, pair.radiograph, "PA", method=method, initial=initial)
    assert torch.equal(found.initial, initial)
    torch.testing.assert_close(method.problem.searched.half_range, torch.tensor(SEARCH, dtype=torch.float64))
    half = torch.arange(1.0, 10.0)
    register(pair.ct, pair.radiograph, "PA", method=method, half_range=half, seed=3)
    torch.testing.assert_close(method.problem.searched.half_range, half.double())
    assert method.problem.seed == 3


def test_the_points_that_measure_shifts_lie_in_the_image(pair):
    method = Told()
    register(pair.ct, pair.radiograph, "PA", method=method, initial=pair.truth.parameters)
    pixels = project(pair.truth.pixel_from_patient, method.problem.points)
    limit = torch.tensor([DETECTOR.columns - 0.5, DETECTOR.rows - 0.5])
    assert len(pixels) >= 8
    assert bool(((pixels > -0.5) & (pixels < limit)).all())


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({"free": 8}, "8 degrees of freedom"),
        ({"free": ["x"]}, "unknown parameter 'x'"),
        ({"free": []}, "frozen"),
        ({"view": "XX"}, "unknown view 'XX'"),
        ({"sdd_mm": -1000.0}, "SDD of -1000 mm"),
        ({"threshold_hu": 5000.0}, "no voxel over 5000 HU"),
        ({"landmark_stored": (1.0, 1.0)}, "both or in neither"),
    ],
)
def test_input_that_cannot_be_registered(pair, settings, expected):
    with pytest.raises(RegtorchError, match=expected):
        register(pair.ct, pair.radiograph, **settings, method=Told())


def test_a_patient_behind_the_source_is_refused(pair):
    initial = pair.initial.clone()
    initial[5] = 3000
    with pytest.raises(RegtorchError, match="behind the source"):
        register(pair.ct, pair.radiograph, "PA", initial=initial, method=Told())


def test_the_result_as_a_dictionary_keeps_the_contract(pair):
    found = register(pair.ct, pair.radiograph, "PA", method=Told()).to_dict()
    contract = "parameters view mirrored detector pixel_from_patient status message similarity evaluations seconds"
    assert set(found) >= {*contract.split(), "device", "seed", "version"}
    assert list(found["parameters"]) == list(KEYS)
    assert found["stored_from_pixel"] == [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
    assert found["detector"] == {"rows": 100, "columns": 80, "pixel_mm": 3.5}


def test_a_search_that_reaches_behind_the_source_still_ends_with_a_verdict(pair):
    quick = partial(cmaes, starts=8, generations=10, pixels=(20, 30), final_generations=5)
    found = register(pair.ct, pair.radiograph, "PA", method=quick, sdd_mm=500.0)
    assert bool(found.parameters.isfinite().all())


def test_a_landmark_outside_the_file_is_named_in_its_own_pixels(pair):
    with pytest.raises(
        RegtorchError, match=r"landmark at \(column, row\) \(150, 5\), expected it inside the image of 80"
    ):
        register(pair.ct, pair.radiograph, "PA", landmark_patient_mm=(0.0, 0.0, 0.0), landmark_stored=(150.0, 5.0))


def test_a_range_of_zero_freezes(pair):
    method, half = Told(), torch.tensor(SEARCH)
    half[[2, 7]] = 0
    register(pair.ct, pair.radiograph, "PA", method=method, half_range=half, free=7)
    assert method.problem.searched.free == [3, 4, 5, 6, 8]


def test_expected_errors_are_of_named_points(pair):
    found = register(pair.ct, pair.radiograph, "PA", method=SMALL, half_range=torch.tensor(HALF_RANGE))
    points = torch.tensor(list(pair.truth.targets.values()), dtype=torch.float64)
    errors = found.expected_errors_mm(points)
    assert errors.shape == (len(points),)
    assert bool((errors > 0).all())
    told = found.to_dict()
    assert 0 < told["expected_pde_mm"] < told["pde_95_mm"]
    expected, bound = found.expected_pde_mm(points)
    assert (expected, bound) == pytest.approx(
        [k * float(errors.square().mean().sqrt()) for k in (0.8862, 1.7308)], rel=1e-4
    )
    assert list(told["standard_deviations"]) == list(KEYS)
    assert found.error_rms_mm == pytest.approx(float(errors.square().mean().sqrt()), rel=1)
    without = register(pair.ct, pair.radiograph, "PA", method=Told())
    assert "expected_pde_mm" not in without.to_dict()
    assert without.expected_pde_mm(points) is None
    with pytest.raises(RegtorchError, match="no covariance"):
        without.expected_errors_mm(points)


def test_bad_seeds_and_half_ranges_are_refused(pair):
    with pytest.raises(RegtorchError, match="seed -1"):
        register(pair.ct, pair.radiograph, "PA", seed=-1)
    with pytest.raises(RegtorchError, match="everything is frozen"):
        register(pair.ct, pair.radiograph, "PA", half_range=torch.zeros(9))
    for name, wrong in (("initial", torch.nan), ("half_range", torch.inf)):
        with pytest.raises(RegtorchError, match=rf"{name} of \[{wrong}, .*\]: expected nine finite numbers"):
            register(pair.ct, pair.radiograph, "PA", **{name: torch.full((9,), wrong)})


def test_a_default_range_gives_way_and_the_result_says_so(pair):
    def at_the_end(problem):
        found, limit = Told()(problem), problem.searched.upper
        evidence = replace(found.evidence, at_limit=("z_s",) if limit[2] < 1400 else ())
        return replace(found, parameters=limit, evidence=evidence)

    moved = register(pair.ct, pair.radiograph, "PA", method=at_the_end)
    assert float(moved.parameters[2]) > 1400
    assert any(line.startswith("z_s at the limit of its default range: searched on") for line in moved.warnings)
    assert float(moved.initial[2]) == 1000
    kept = register(pair.ct, pair.radiograph, "PA", method=at_the_end, half_range=torch.tensor(SEARCH))
    assert float(kept.parameters[2]) == 1150
    assert not any("default range" in line for line in kept.warnings)
    assert [reason.code for reason in kept.reasons] == ["at_limit"]


def test_a_half_range_that_is_no_number_is_the_default(pair):
    given = torch.full((9,), torch.nan)
    given[:3] = 0
    method = Told()
    register(pair.ct, pair.radiograph, "PA", half_range=given, method=method)
    assert method.problem.searched.half_range.tolist() == pytest.approx([0, 0, 0, *SEARCH[3:]])


def test_numbers_that_are_none_are_refused(pair):
    """Readers guarantee this; images and CTs made in Python may violate it."""
    image, data = pair.radiograph.image.clone(), pair.ct.data.clone()
    image[3, 4], data[20, 20, 20] = torch.nan, torch.nan
    with pytest.raises(RegtorchError, match="pixels or weights that are NaN"):
        register(pair.ct, replace(pair.radiograph, image=image), "PA", method=Told())
    with pytest.raises(RegtorchError, match="voxels that are NaN"):
        register(pair.ct.with_data(data), pair.radiograph, "PA", method=Told())


def test_a_field_of_few_pixels_is_refused(pair):
    weight = torch.zeros_like(pair.radiograph.weight)
    weight[10:13, 10:60] = 1
    with pytest.raises(RegtorchError, match="3 x 50 pixels, expected 8 to 10000 each way"):
        register(pair.ct, replace(pair.radiograph, weight=weight), "PA")


def test_what_looks_wrong_with_the_input_is_among_the_warnings(pair):
    told = register(pair.ct, pair.radiograph, "PA", method=Told()).warnings
    assert any("voxels of 6 x 6 x 6 mm" in line for line in told)
    assert any("no source-detector distance" in line for line in told)
    assert not any(
        "no source" in line for line in register(pair.ct, pair.radiograph, sdd_mm=1e3, method=Told()).warnings
    )
