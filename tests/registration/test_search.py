"""Screening finds shifts; the hybrid search finds the truth from far away, any subset of parameters, the same twice."""

import math
from dataclasses import replace
from functools import partial

import pytest
import torch

from regtorch.drr import render
from regtorch.evaluation import projection_distances
from regtorch.geometry import Detector, pixel_from_patient
from regtorch.imaging import Radiograph
from regtorch.registration import Settings, Stage, hybrid, register
from regtorch.registration.search import driver
from regtorch.registration.search.candidates import evolved
from regtorch.registration.search.matcher import Matcher
from regtorch.registration.search.refinement import End, best_edges_px, explained, robust_gain
from regtorch.registration.search.screening import _peaks, screen
from regtorch.registration.trace import Trace
from regtorch.simulation import simulate

from .conftest import DETECTOR

FAR = torch.tensor([20.0, -15, 60, 90, -70, 60, *map(math.radians, (5, -6, 4))], dtype=torch.float64)
HALF_RANGE = torch.tensor([75.0, 75, 150, 150, 150, 150, *[math.radians(12)] * 3], dtype=torch.float64)
SETTINGS = Settings(
    poses=400, levels=(Stage(40, 24, 12), Stage(60, 8, 12), Stage(80, 2, 10)), finest_pixels=100, finest_steps=8
)


def small(**changes) -> partial:
    """The search on few pixels."""
    return partial(hybrid, settings=replace(SETTINGS, **changes))


SMALL = small()


def matcher_of(problem, volume, pixels, **changes) -> Matcher:
    return Matcher.of(problem, replace(SETTINGS, least_averaging=1.0, **changes), volume, pixels, Trace())


def looks(found) -> list[str]:
    return [step.name for step in found.trace]


def _pde_mm(pair, parameters) -> float:
    points = torch.tensor(list(pair.truth.targets.values()), dtype=torch.float64)
    place = DETECTOR, "PA", pair.ct.origin_patient_mm
    matrices = [pixel_from_patient(p, *place) for p in (parameters, pair.truth.parameters)]
    return float(projection_distances(*matrices, points, DETECTOR.pixel_mm).nanmean())


def test_screening_finds_a_shift_in_the_plane_of_the_detector(pair):
    """Only the patient's x and y are wrong, so the shift alone must bring the anatomy back."""
    off = torch.zeros(9, dtype=torch.float64)
    off[3:5] = torch.tensor([70.0, -55.0])
    tiny = torch.full((9,), 1e-6, dtype=torch.float64)
    tiny[3:5] = 100
    problem = pair.problem(list(range(9)), initial=pair.truth.parameters + off, half_range=tiny)
    level = matcher_of(problem, problem.attenuating, 40)
    found = screen(level, poses=2, seed=0)
    assert found.similarity[0] > 0.7
    assert bool((found.similarity.diff() <= 0).all())
    pixel_in_patient_mm = level.pixel_mm / 1.2
    assert float((found.parameters[0] - pair.truth.parameters)[3:5].abs().max()) < pixel_in_patient_mm


@pytest.mark.parametrize("size", [(31, 40), (1, 40), (31, 1), (2, 2), (1, 1)], ids=str)
def test_peaks_are_the_highest_and_not_their_flanks(size):
    score = torch.zeros(2, *size)
    highest = [(size[0] - 1, size[1] // 4), (size[0] // 3, size[1] - 1)]
    for pose, (row, column) in enumerate(highest):
        score[pose, row, column] = 1
        score[pose, max(row - 1, 0), column] += 0.5
        score[pose, row, max(column - 1, 0)] += 0.5
    other = size[0] // 2, size[1] // 2 + 1
    if size == (31, 40):
        score[:, other[0], other[1]] = 0.25
    value, at = _peaks(score, 2)
    assert at[:, 0].tolist() == [list(place) for place in highest]
    assert torch.equal(value[:, 0], score.flatten(1).amax(1).double())
    if size == (31, 40):
        assert at[:, 1].tolist() == [list(other)] * 2


def test_frozen_parameters_stay_in_screening(pair):
    problem = pair.problem([0, 3, 7])
    found = screen(matcher_of(problem, problem.attenuating, 40), poses=5, seed=0)
    rest = [1, 2, 4, 5, 6, 8]
    assert torch.equal(found.parameters[:, rest], pair.initial[rest].expand(len(found.parameters), 6))
    assert bool((found.parameters[:, [0, 3, 7]] <= problem.unknowns.upper).all())
    assert bool((found.parameters[:, [0, 3, 7]] >= problem.unknowns.lower).all())


@pytest.mark.parametrize("threshold_hu", [100.0, None], ids=["bone", "all tissue"])
def test_the_truth_is_found_from_far_away(pair, threshold_hu):
    truth = simulate(pair.ct, pair.truth.parameters, "PA", detector=DETECTOR, threshold_hu=threshold_hu)
    radiograph = Radiograph.from_image(truth.image, DETECTOR)
    initial = pair.truth.parameters + FAR
    assert _pde_mm(pair, initial) > 80
    found = register(pair.ct, radiograph, "PA", method=SMALL, initial=initial, half_range=HALF_RANGE)
    assert _pde_mm(pair, found.parameters) < 0.5
    assert found.status == "ok", found.message
    assert found.evaluations < 4000


def test_one_candidate_goes_on_where_the_first_level_convinces(pair):
    settings = {"initial": pair.truth.parameters + FAR, "half_range": HALF_RANGE}
    found = register(pair.ct, pair.radiograph, "PA", method=SMALL, **settings)
    assert [(step.pixels, step.candidates) for step in found.trace if step.name == "refine"][1] == (80, 1)
    assert "widen" not in looks(found)
    assert found.evidence.looks == 1


def test_voxels_of_siddons_method_have_edges_narrower_than_themselves(pair):
    """At the true pose the search finds the edges of Siddon's voxels, though voxels are smaller than a pixel."""
    detector, truth = Detector(44, 36, 8.0), pair.truth.parameters
    attenuating = pair.problem(list(range(9))).attenuating
    edges = {}
    for method in ("siddon", "joseph"):
        drr = render(attenuating, truth, detector, "PA", method=method)
        problem = pair.problem(list(range(9)), radiograph=Radiograph.from_image(drr, detector))
        matcher = matcher_of(problem, attenuating, 44, voxel_per_pixel=1e-3)
        assert 0.8 < matcher.voxel_px < 1
        edges[method], linear = best_edges_px(matcher, truth)
        assert linear.volume.sharpness == (1, 1, 1)
    assert edges == {"siddon": pytest.approx(0.8 * matcher.voxel_px), "joseph": math.inf}


def test_robust_weights_gain_much_where_the_residual_is_confined(pair):
    """No gain if all is explained, a large gain if a quarter of the image is spoilt, a small one if all of it is."""
    truth, image = pair.truth.parameters, pair.radiograph.image
    spoils = 0.5 * image.max() * torch.rand(image.shape, generator=torch.Generator().manual_seed(0))
    quarter = torch.zeros_like(spoils)
    quarter[:50, :40] = 1
    gains = []
    for added in (0 * spoils, 4 * quarter * spoils, spoils):
        problem = pair.problem(list(range(9)), radiograph=Radiograph.from_image(image + added, DETECTOR))
        plain = matcher_of(problem, problem.attenuating, 100)
        robust = plain.robust(truth)
        end = End(truth, float(robust.similarity(truth[None])[0]), robust)
        gains.append(robust_gain(plain, end))
    assert gains[0] is None
    assert gains[1] > 1.5
    assert gains[2] < 1.2


def test_what_bone_does_not_explain_may_be_soft_tissue(pair):
    """All tissue explains a radiograph of the whole CT at the true pose, but not at a wrong one."""
    truth = pair.truth.parameters
    image = simulate(pair.ct, truth, "PA", detector=DETECTOR, threshold_hu=None).image
    problem = pair.problem(list(range(9)), radiograph=Radiograph.from_image(image, DETECTOR))
    plain, whole = (matcher_of(problem, volume, 100) for volume in (problem.attenuating, problem.whole))
    for off_mm, known in ((0.0, True), (20.0, False)):
        place = truth + off_mm * torch.eye(9, dtype=torch.float64)[4]
        end = End(place, float(plain.similarity(place[None])[0]), plain)
        assert robust_gain(plain, end) == 1
        assert explained(whole, end) is known


@pytest.mark.parametrize(("threshold_hu", "tissue"), [(100.0, "bone"), (None, "all tissue")])
def test_the_evidence_names_the_tissue_that_answered(pair, threshold_hu, tissue):
    image = simulate(pair.ct, pair.truth.parameters, "PA", detector=DETECTOR, threshold_hu=threshold_hu).image
    settings = {"initial": pair.truth.parameters + FAR / 4, "half_range": HALF_RANGE}
    found = register(pair.ct, Radiograph.from_image(image, DETECTOR), "PA", method=SMALL, **settings)
    assert found.evidence.tissue == tissue


def test_bone_no_denser_than_the_threshold_is_found(pair):
    """Such bone has no contrast to soft tissue that is only slightly less dense."""
    hu = pair.ct.data
    ct = pair.ct.with_data(torch.where(hu >= 100, 100.0, torch.where(hu > -300, 0.0, -1000.0)))
    truth = simulate(ct, pair.truth.parameters, "PA", detector=DETECTOR, threshold_hu=100.0)
    radiograph = Radiograph.from_image(truth.image, DETECTOR)
    found = register(ct, radiograph, "PA", method=SMALL, initial=pair.initial, half_range=HALF_RANGE)
    assert _pde_mm(pair, found.parameters) < 1


def test_more_poses_are_looked_at_where_the_first_do_not_convince(pair):
    """A single candidate has no other candidate to confirm it."""
    method = small(poses=40, levels=(Stage(40, 24, 12), Stage(60, 1, 12), Stage(80, 1, 10)))
    settings = {"initial": pair.initial, "half_range": HALF_RANGE}
    lonely = register(pair.ct, pair.radiograph, "PA", method=method, **settings)
    assert len(lonely.starts) == 2
    assert "widen" in looks(lonely)
    assert lonely.evidence.looks > 1


def test_more_poses_are_looked_at_where_the_answer_does_not_convince(pair, monkeypatch):
    """Even if the first starts agree, a small gain from robust weights indicates a wrong place."""
    monkeypatch.setattr(driver, "robust_gain", lambda *given: 1.25)
    settings = {"initial": pair.truth.parameters + FAR, "half_range": HALF_RANGE}
    found = register(pair.ct, pair.radiograph, "PA", method=SMALL, **settings)
    assert looks(found)[:8] == ["screen", "screen", "screen", "rank", "refine", "refine", "screen", "widen"]
    ranked = next(step for step in found.trace if step.name == "rank")
    assert len(found.starts) > ranked.candidates
    assert _pde_mm(pair, found.parameters) < 0.5


@pytest.mark.parametrize(("known", "status"), [(True, "ok"), (False, "doubtful")])
def test_an_answer_that_all_tissue_explains_is_not_doubted_for_what_bone_does_not(pair, monkeypatch, known, status):
    monkeypatch.setattr(driver, "robust_gain", lambda *given: 1.0)
    monkeypatch.setattr(driver, "explained", lambda *given: known)
    settings = {"initial": pair.truth.parameters + FAR, "half_range": HALF_RANGE}
    found = register(pair.ct, pair.radiograph, "PA", method=small(poses=100), **settings)
    assert _pde_mm(pair, found.parameters) < 0.5
    assert found.status == status


def test_the_rescue_climbs_without_slopes(pair):
    """Starts up to 40 mm off: each has its own end, and no end has a lower similarity than its start."""
    problem = pair.problem(list(range(9)), initial=pair.truth.parameters, half_range=HALF_RANGE)
    matcher = matcher_of(problem, problem.attenuating, 40)
    places = pair.truth.parameters + torch.stack([FAR / 4, FAR])
    ends = evolved(matcher, places)
    assert bool((matcher.similarity(ends) > matcher.similarity(places)).all())
    assert _pde_mm(pair, ends[0]) < 2 < 20 < _pde_mm(pair, places[0])
    assert matcher.trace.evaluations > 1000
    frozen = pair.problem([3, 4], initial=pair.truth.parameters, half_range=HALF_RANGE)
    moved = evolved(matcher_of(frozen, frozen.attenuating, 40, generations=5), places)[0] != pair.truth.parameters
    assert moved.nonzero().flatten().tolist() == [3, 4]


def test_the_rescue_confirms_nothing(pair):
    """The end of the rescue does not count as a second start that agrees, however good it is."""
    method = small(poses=2, levels=(Stage(40, 1, 12), Stage(60, 1, 12), Stage(80, 1, 10)))
    settings = {"initial": pair.initial, "half_range": HALF_RANGE}
    upside_down = Radiograph.from_image(pair.radiograph.image.flip(0), DETECTOR)
    found = register(pair.ct, upside_down, "PA", method=method, **settings)
    assert len(found.starts) == 2
    assert found.evidence.looks == 3
    assert found.status != "ok"


def test_what_was_computed_twice_confirms_nothing(pair):
    """If only the shifts are free, there is one pose to screen, whatever the number requested."""
    method = small(levels=(Stage(40, 1, 12), Stage(60, 1, 12), Stage(80, 1, 10)))
    found = register(
        pair.ct, pair.radiograph, "PA", method=method, free=["x_obj", "y_obj"], initial=pair.truth.parameters
    )
    assert len(found.starts) == 1
    assert found.status == "doubtful"


def test_a_mirrored_radiograph_is_recognised(pair):
    mirrored = Radiograph.from_image(pair.radiograph.image.flip(1), DETECTOR)
    settings = {"method": SMALL, "initial": pair.initial, "half_range": HALF_RANGE}
    found = register(pair.ct, mirrored, "PA", **settings)
    assert found.status == "doubtful"
    right = register(pair.ct, pair.radiograph, "PA", **settings)
    assert right.status == "ok", right.message


@pytest.mark.parametrize(("free", "moving"), [(6, [3, 4, 5, 6, 7, 8]), (["x_obj", "eta", "z_s"], [2, 3, 6])], ids=str)
def test_what_is_frozen_stays(pair, free, moving):
    settings = {"initial": pair.initial, "half_range": HALF_RANGE}
    found = register(pair.ct, pair.radiograph, "PA", method=SMALL, free=free, **settings)
    assert (found.parameters != pair.initial).nonzero().flatten().tolist() == moving


def test_a_frozen_source_that_is_wrong_is_found_out(pair):
    """The source of the pair's start is wrong, so the expected error must include its effect on the image."""
    half_range = torch.tensor([40.0, 40, 80, 40, 40, 60, *[0.1] * 3], dtype=torch.float64)
    right, wrong = (
        register(pair.ct, pair.radiograph, "PA", method=SMALL, free=6, initial=initial, half_range=half_range)
        for initial in (torch.cat([pair.truth.parameters[:3], pair.initial[3:]]), pair.initial)
    )
    assert right.status == "ok"
    assert _pde_mm(pair, right.parameters) < 0.5
    assert right.to_dict()["expected_pde_mm"] < 0.5
    assert (right.covariance.diagonal()[:3].sqrt() < 20).all()
    assert _pde_mm(pair, wrong.parameters) < wrong.to_dict()["pde_95_mm"]
    error = (pair.truth.parameters - wrong.parameters).abs()[:3]
    assert (wrong.covariance.diagonal()[:3].sqrt() > error / 2).all()


@pytest.mark.parametrize(
    "without",
    [
        {"soft_tissue": False},
        {"contrast": False},
        {"all_shifts": False},
        {"derivatives": False, "poses": 50, "levels": (Stage(30, 3, 6), *SETTINGS.levels[1:])},
    ],
    ids=["soft tissue", "contrast", "shifts", "derivatives"],
)
def test_each_ingredient_can_be_left_out(pair, without):
    """From a near start; studies measure the value of each ingredient from distant starts."""
    half_range = torch.tensor([20.0, 20, 30, 20, 20, 30, *[math.radians(3)] * 3], dtype=torch.float64)
    method = small(**without)
    found = register(
        pair.ct, pair.radiograph, "PA", method=method, initial=pair.truth.parameters + FAR / 8, half_range=half_range
    )
    assert _pde_mm(pair, found.parameters) < 1
    assert 0 < found.covariance.diagonal().max() < 1e4


def test_the_same_seed_gives_the_same_result(pair):
    one, same = (register(pair.ct, pair.radiograph, "PA", method=SMALL, initial=pair.initial, seed=3) for _ in range(2))
    assert torch.equal(one.parameters, same.parameters)
    assert one.evaluations == same.evaluations
