"""Maps between the numbers that a search varies and the nine parameters, in both directions, with Jacobians."""

from functools import partial

import pytest
import torch

from regtorch.errors import RegtorchError
from regtorch.geometry import Detector, cone_beam_rays
from regtorch.registration import cmaes, detector_frame, register, selection
from regtorch.registration.unknowns import Range, Unknowns, normal_equations_of
from regtorch.scoring import normal_equations

from .conftest import DETECTOR, HALF_RANGE, searched
from .test_search import FAR, SMALL, _pde_mm, matcher_of
from .test_search import HALF_RANGE as WIDE

ALL = list(range(9))


def _poses(initial: torch.Tensor, n: int) -> torch.Tensor:
    unit = 2 * torch.rand(n, 9, generator=torch.Generator().manual_seed(0), dtype=torch.float64) - 1
    return initial + unit * torch.tensor(HALF_RANGE, dtype=torch.float64)


@pytest.mark.parametrize("coordinates", [selection, detector_frame])
def test_there_and_back(pair, coordinates):
    unknowns = coordinates(searched(ALL, pair.initial))
    nine = _poses(pair.initial, 200)
    values = unknowns.values(nine)
    assert values.shape == (200, 9)
    back = unknowns.parameters(values)
    assert back.shape == (200, 1, 1, 9)
    torch.testing.assert_close(back[:, 0, 0], nine, atol=1e-9, rtol=1e-12)
    assert bool(((values >= unknowns.lower) & (values <= unknowns.upper)).all())


@pytest.mark.parametrize(("coordinates", "free"), [(selection, ALL), (selection, [0, 4, 7]), (detector_frame, ALL)])
def test_the_jacobian_is_that_of_small_steps(pair, coordinates, free):
    unknowns = coordinates(searched(free, pair.initial))
    values = unknowns.values(_poses(pair.initial, 3))
    found = unknowns.jacobian(values)
    assert found.shape == (3, 1, 1, len(unknowns.moved), len(unknowns.names))
    step = 1e-4
    for number in range(len(unknowns.names)):
        ahead, behind = values.clone(), values.clone()
        ahead[:, number] += step
        behind[:, number] -= step
        slope = (unknowns.parameters(ahead) - unknowns.parameters(behind))[..., unknowns.moved] / (2 * step)
        torch.testing.assert_close(found[..., number], slope, atol=1e-5, rtol=1e-6)


def test_the_detectors_frame_puts_source_and_detector_where_the_rays_have_them(pair):
    """Source and centre of the detector in the patient, against those of ``cone_beam_rays`` in voxels."""
    unknowns = detector_frame(searched(ALL, pair.initial))
    nine = _poses(pair.initial, 20)
    values = unknowns.values(nine)
    one_pixel = Detector(1, 1, 1.0)
    rays = cone_beam_rays(nine, one_pixel, "AP", torch.eye(4, dtype=torch.float64)).unflatten(-1, (4, 3))
    axes = torch.tensor([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]], dtype=torch.float64)  # AP: X left, Y superior, Z anterior
    torch.testing.assert_close(values[:, :3], rays[:, 0] @ axes.mT)
    torch.testing.assert_close(values[:, 3:6], rays[:, 1] @ axes.mT)


def test_frozen_parameters_have_no_meaning_in_the_detectors_frame(pair):
    with pytest.raises(RegtorchError, match="x_s, y_s, z_s frozen: expected nine"):
        register(pair.ct, pair.radiograph, "PA", free=6, coordinates=detector_frame)


def test_normal_equations_of_two_images_and_two_bones():
    """J^T J of the stacked residuals, for maps that couple images and bones at random."""
    generator = torch.Generator().manual_seed(1)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    n, images, bones, p, d, residuals = 2, 2, 2, 9, 5, 40
    by_pixel, jacobian = normal(n, images, residuals, bones * p), normal(n, images, bones, p, d)
    r = normal(n, images, residuals)
    jtj, jtr = by_pixel.mT @ by_pixel, (by_pixel.mT @ r[..., None])[..., 0]
    found = normal_equations_of(jacobian, jtj, jtr)
    by_unknowns = (by_pixel @ jacobian.flatten(2, 3)).flatten(1, 2)
    torch.testing.assert_close(found[0], by_unknowns.mT @ by_unknowns)
    torch.testing.assert_close(found[1], (by_unknowns.mT @ r.flatten(1)[..., None])[..., 0])


def test_a_selections_equations_are_those_of_the_free_parameters(pair):
    free = [2, 3, 8]
    problem = pair.problem(free)
    matcher = matcher_of(problem, problem.attenuating, 40)
    values = problem.unknowns.values(pair.truth.parameters[None] + 0.5)
    expected = normal_equations(
        matcher.volume, problem.parameters(values), matcher.fixed.detector, "PA", matcher.gradients, free=free
    )
    for found, part in zip(matcher._equations(values), expected, strict=True):
        assert torch.equal(found, part)


def test_a_source_on_a_rail_is_a_map_like_others(pair):
    """One number moves the source up and down, another the patient; the search accepts such a map."""

    def rail(searched: Range) -> Unknowns:
        along = torch.zeros(9, 2, dtype=torch.float64)
        along[1, 0] = along[3, 1] = 1
        limit = torch.tensor([30.0, 30.0], dtype=torch.float64)
        return Unknowns(
            ("rail", "x_obj"),
            -limit,
            limit,
            limit,
            ALL,
            lambda values: (searched.initial + values @ along.mT)[..., None, None, :],
            lambda values: along.expand(len(values), 1, 1, 9, 2),
            lambda nine: (nine - searched.initial) @ along,
        )

    off = torch.zeros(9, dtype=torch.float64)
    off[1], off[3] = 12, -15
    initial = pair.truth.parameters + off
    problem = pair.problem(ALL, initial=initial, coordinates=rail)
    climbed = matcher_of(problem, problem.attenuating, 100).climb(initial[None], 20)
    torch.testing.assert_close(climbed.parameters[0], pair.truth.parameters, atol=0.3, rtol=0)


def test_registrations_in_either_coordinates_end_at_the_same_matrix(pair):
    settings = {"initial": pair.truth.parameters + FAR, "half_range": WIDE, "method": SMALL}
    one, other = (
        register(pair.ct, pair.radiograph, "PA", coordinates=c, **settings) for c in (selection, detector_frame)
    )
    assert one.status == other.status == "ok"
    assert _pde_mm(pair, one.parameters) < 0.5
    assert _pde_mm(pair, other.parameters) < 0.5
    assert abs(one.similarity - other.similarity) < 1e-4


def test_the_papers_method_takes_the_papers_alternative(pair):
    quick = partial(cmaes, starts=8, generations=20, pixels=(24, 40), survivors=2, finalists=1, final_generations=60)
    settings = {"half_range": torch.tensor(HALF_RANGE), "method": quick, "coordinates": detector_frame}
    found = register(pair.ct, pair.radiograph, "PA", **settings)
    assert _pde_mm(pair, found.parameters) < 2
    assert found.detector == DETECTOR
