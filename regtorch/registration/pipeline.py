"""One verb: a CT and a radiograph in, a checked registration out."""

import time
from collections.abc import Callable, Iterable

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.errors import RegtorchError
from regtorch.geometry import NAMES, free_indices, pixel_from_patient, project
from regtorch.imaging import (
    BONE_HU,
    Radiograph,
    Volume,
    attenuation,
    check_radiograph,
    check_volume,
    crop_to_anatomy,
)
from regtorch.imaging.points import spread_points
from regtorch.limits import LEAST_PIXELS, MOST_PIXELS
from regtorch.registration.found import Found
from regtorch.registration.problem import Problem, Progress, Similarity
from regtorch.registration.reach import searched_on
from regtorch.registration.result import Registration
from regtorch.registration.search import hybrid
from regtorch.registration.start import SEARCH, Point2, Point3, initial_parameters
from regtorch.registration.trust.rules import judge, warnings
from regtorch.registration.unknowns import Range, Unknowns, selection
from regtorch.similarity import gradient_correlation

_POINTS = 64
"""Points spread over the anatomy, by which moves of the image are measured."""

_SEEDS = 2**32

_LEAST_SHOWN = _POINTS // 8
"""Points that the start must show in the image; with fewer, all points count."""


def register(
    ct: Volume,
    radiograph: Radiograph,
    view: str = "PA",
    *,
    method: Callable[[Problem], Found] = hybrid,
    free: int | Iterable[str] = 9,
    coordinates: Callable[[Range], Unknowns] = selection,
    initial: Float[Tensor, "9"] | None = None,
    half_range: Float[Tensor, "9"] | None = None,
    sdd_mm: float | None = None,
    landmark_patient_mm: Point3 | None = None,
    landmark_stored: Point2 | None = None,
    threshold_hu: float | None = BONE_HU,
    similarity: Similarity = gradient_correlation,
    seed: int = 0,
    progress: Progress = lambda share, what: None,
) -> Registration:
    """Find where source, patient and detector stood when a radiograph of the patient in a CT (HU) was taken.

    The same seed gives the same result. A registration that went wrong is no error: its ``status`` is ``failed`` or
    ``doubtful``, and its ``reasons`` say why. Raises ``RegtorchError`` for input that cannot be registered.

    Args:
        radiograph: Line integrals up to gain and offset, as ``read_radiograph`` makes them.
        view: How the patient stands at zero rotation: PA, AP, LLAT (or LAT), RLAT.
        method: ``hybrid``; ``cmaes``, the paper's; or a ``partial`` of either with options of its own.
        free: Parameters that may move: 9 (all), 7 (all but x_s and y_s), 6 (all but the source), or their names.
        coordinates: Numbers that the search varies: ``selection``, the free parameters, or ``detector_frame``.
        initial: The nine parameters at the start (mm, rad); unless given, ``initial_parameters`` makes them.
        half_range: How far from the start to look (mm, rad); 0 freezes. NaN or None: the default, which gives way.
        sdd_mm: Source-detector distance; unless given the radiograph's file says it, or it is 1000 mm.
        landmark_patient_mm: A point of the CT, LPS mm; ``landmark_stored`` is its (column, row) in the file.
        threshold_hu: From here on the CT is bone; None: all tissue counts as bone.
        similarity: One of ``regtorch.similarity``; ``hybrid`` takes gradient correlation alone.
        progress: Called with the share done and a short text.
    """
    began = time.perf_counter()
    _check(radiograph, seed, initial=initial, half_range=half_range)
    looks_wrong = _looks_wrong(ct, radiograph, sdd_known=not (initial is None and sdd_mm is None))
    known = sdd_mm, landmark_patient_mm, landmark_stored
    if initial is None:
        initial = _start(ct, radiograph, view, *known)
    elif known != (None, None, None):
        raise RegtorchError("initial parameters as well as an SDD or a landmark: expected either")
    attenuating, whole = _bone_and_all_tissue(ct, threshold_hu)
    problem = Problem(
        attenuating=attenuating,
        threshold_hu=threshold_hu,
        whole=whole,
        radiograph=radiograph,
        view=view,
        similarity=similarity,
        searched=_searched(initial, half_range, free_indices(free)),
        points=_points_in_image(attenuating, radiograph, initial, view),
        seed=seed,
        progress=progress,
        coordinates=coordinates,
    )
    return _judged(problem, *searched_on(method, problem, half_range), looks_wrong, began)


def _judged(problem: Problem, found: Found, moved: list[str], looks_wrong: list[str], began: float) -> Registration:
    status, message, reasons = judge(found.evidence)
    return Registration(
        parameters=found.parameters,
        initial=problem.searched.initial,
        view=problem.view,
        detector=problem.radiograph.detector,
        mirrored=problem.radiograph.mirrored,
        image_from_patient=problem.pixel_from_patient(found.parameters),
        stored_from_pixel=problem.radiograph.stored_from_pixel,
        status=status,
        message=message,
        reasons=reasons,
        evidence=found.evidence,
        warnings=(*looks_wrong, *moved, *warnings(found.evidence)),
        similarity=found.similarity,
        starts=found.starts,
        start_similarity=found.start_similarity,
        evaluations=found.evaluations,
        trace=found.trace,
        covariance=found.covariance,
        origin_patient_mm=problem.attenuating.origin_patient_mm,
        device=str(problem.attenuating.data.device),
        seed=problem.seed,
        seconds=time.perf_counter() - began,
    )


def _bone_and_all_tissue(ct: Volume, threshold_hu: float | None) -> tuple[Volume, Volume]:
    bone, whole = (
        attenuation(crop_to_anatomy(ct, threshold_hu=least), threshold_hu=least) for least in (threshold_hu, None)
    )
    if not bool(whole.data.sum().isfinite()):
        raise RegtorchError(f"{ct.name}: voxels that are NaN or infinite, expected HU everywhere")
    return bone, whole


def _start(
    ct: Volume,
    radiograph: Radiograph,
    view: str,
    sdd_mm: float | None,
    landmark_patient_mm: Point3 | None,
    landmark_stored: Point2 | None,
) -> Float[Tensor, "9"]:
    return initial_parameters(
        ct,
        radiograph.detector,
        view,
        sdd_mm=radiograph.sdd_mm if sdd_mm is None else sdd_mm,
        landmark_patient_mm=landmark_patient_mm,
        landmark_image=None if landmark_stored is None else _unstored(radiograph, landmark_stored),
    )


def _searched(initial: Float[Tensor, "9"], half_range: Float[Tensor, "9"] | None, moving: list[int]) -> Range:
    """The range of the parameters in ``moving``; the others are frozen."""
    default = torch.tensor(SEARCH, dtype=torch.float64)
    half_range = default if half_range is None else torch.where(half_range.isnan(), default, half_range.double())
    if not bool((half_range >= 0).all()):
        raise RegtorchError(f"half range {half_range.tolist()}: expected numbers from 0 (frozen) on")
    given = half_range.double()
    half_range = torch.zeros_like(given)
    half_range[moving] = given[moving]
    if not bool(half_range.any()):
        raise RegtorchError(f"half range {given.tolist()}: everything is frozen, expected something to find")
    return Range(initial.double(), half_range)


def _looks_wrong(ct: Volume, radiograph: Radiograph, *, sdd_known: bool) -> list[str]:
    """One line each, for a result's warnings."""
    lines = [f"{ct.name}: {line}" for line in check_volume(ct)]
    return lines + [f"{radiograph.name}: {line}" for line in check_radiograph(radiograph, sdd_known=sdd_known)]


def _check(radiograph: Radiograph, seed: int, **given: Float[Tensor, "9"] | None) -> None:
    if not 0 <= seed < _SEEDS:
        raise RegtorchError(f"seed {seed}: expected a whole number from 0 to {_SEEDS - 1}")
    _check_radiograph(radiograph)
    for name, numbers in given.items():
        if numbers is None:
            continue
        fits = numbers.isfinite() | numbers.isnan() if name == "half_range" else numbers.isfinite()
        if numbers.shape != (len(NAMES),) or not bool(fits.all()):
            raise RegtorchError(f"{name} of {numbers.tolist()}: expected nine finite numbers")


def _check_radiograph(radiograph: Radiograph) -> None:
    """A whole detector's image, of finite numbers and of a size that can be registered."""
    detector = radiograph.detector
    if not bool(radiograph.image.isfinite().all() and radiograph.weight.isfinite().all()):
        raise RegtorchError(
            f"{radiograph.name}: pixels or weights that are NaN or infinite, expected numbers everywhere"
        )
    sides = [int(radiograph.weight.amax(dim).count_nonzero()) for dim in (1, 0)]
    if 0 < min(sides) < LEAST_PIXELS or max(radiograph.image.shape) > MOST_PIXELS:
        shape = " x ".join(map(str, sides if min(sides) < LEAST_PIXELS else radiograph.image.shape))
        raise RegtorchError(f"{radiograph.name}: {shape} pixels, expected {LEAST_PIXELS} to {MOST_PIXELS} each way")
    if detector.centre_mm != (0.0, 0.0):
        raise RegtorchError(
            f"{radiograph.name}: centred on {detector.centre_mm} mm, expected the whole detector's image"
        )


def _unstored(radiograph: Radiograph, stored: Point2) -> Point2:
    """(column, row) of the image seen from the source, from (column, row) of the file."""
    columns, rows = radiograph.stored_size
    if not (-0.5 <= stored[0] <= columns - 0.5 and -0.5 <= stored[1] <= rows - 0.5):
        raise RegtorchError(
            f"{radiograph.name}: landmark at (column, row) ({stored[0]:g}, {stored[1]:g}), "
            f"expected it inside the image of {columns} x {rows} pixels"
        )
    pixel = torch.linalg.solve(radiograph.stored_from_pixel, torch.tensor([*stored, 1.0], dtype=torch.float64))
    return float(pixel[0]), float(pixel[1])


def _points_in_image(
    attenuating: Volume, radiograph: Radiograph, initial: Float[Tensor, "9"], view: str
) -> Float[Tensor, "n 3"]:
    """Points of the anatomy that the start puts into the image; all of them where it shows too few."""
    points = spread_points(attenuating, _POINTS)
    detector = radiograph.detector
    matrix = pixel_from_patient(initial.double(), detector, view, attenuating.origin_patient_mm)
    limit = torch.tensor([detector.columns - 0.5, detector.rows - 0.5], dtype=torch.float64)
    pixels = project(matrix, points)
    seen = ((pixels > -0.5) & (pixels < limit)).all(1)
    if not bool(pixels.isfinite().all(1).any()):
        raise RegtorchError("the start puts the patient behind the source: expected it between source and detector")
    return points[seen] if int(seen.sum()) >= _LEAST_SHOWN else points[pixels.isfinite().all(1)]
