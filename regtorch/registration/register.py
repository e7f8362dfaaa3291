"""One verb: a CT and a radiograph in, a checked registration out."""

import time
from collections.abc import Callable, Iterable
from math import nan

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.errors import RegtorchError
from regtorch.geometry import free_indices, pixel_from_patient, project
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
from regtorch.registration.hybrid import hybrid
from regtorch.registration.initial import SEARCH, Point2, Point3, initial_parameters
from regtorch.registration.objective import Similarity
from regtorch.registration.problem import Found, Problem, Progress
from regtorch.registration.result import Registration
from regtorch.registration.uncertainty import root_mean_square_mm
from regtorch.registration.verdict import judge, warnings
from regtorch.similarity import gradient_correlation

_POINTS = 64


def register(
    ct: Volume,
    radiograph: Radiograph,
    view: str = "PA",
    *,
    method: Callable[[Problem], Found] = hybrid,
    free: int | Iterable[str] = 9,
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
    """Find where source, patient and detector stood when a radiograph of the patient in a CT was taken.

    ``free`` names the parameters that may move, or says 9 (all), 7 (all but x_s and y_s) or 6 (all but the source);
    the others keep their values of ``initial``, which is made from view and protocol unless given
    (``initial_parameters``). The SDD comes from ``sdd_mm``, else from the radiograph's file, else is 1000 mm. A
    landmark is a point of the CT (LPS mm) and the (column, row) of the file where it is seen. ``half_range`` is how
    far from ``initial`` to look (mm, rad); 0 freezes. From ``threshold_hu`` on it is bone, and the rest counts as air
    (None: all counts); ``hybrid`` looks at all tissue as well. ``method`` is ``hybrid``, which always takes gradient
    correlation, or ``evolution``, the paper's, or a ``partial`` of either; ``similarity`` is one of
    ``regtorch.similarity``: how good a match is can be told of gradient correlation alone.

    The same seed gives the same result. Raises ``RegtorchError`` for input that cannot be registered; a registration
    that went wrong is no error but has the status ``failed`` or ``doubtful``, and says why.
    """
    began = time.perf_counter()
    if not 0 <= seed < 2**32:
        raise RegtorchError(f"seed {seed}: expected a whole number from 0 to {2**32 - 1}")
    detector = radiograph.detector
    _check_pixels(radiograph)
    for name, given in (("initial", initial), ("half_range", half_range)):
        if given is not None and not (given.shape == (9,) and bool(given.isfinite().all())):
            raise RegtorchError(f"{name} of {given.tolist()}: expected nine finite numbers")
    moving = free_indices(free)
    if detector.centre_mm != (0.0, 0.0):
        raise RegtorchError(
            f"{radiograph.name}: centred on {detector.centre_mm} mm, expected the whole detector's image"
        )
    if initial is not None and not (sdd_mm is landmark_patient_mm is landmark_stored is None):
        raise RegtorchError("initial parameters as well as an SDD or a landmark: expected either")
    sdd_known = not (initial is None and sdd_mm is None)
    looks_wrong = [f"{ct.name}: {line}" for line in check_volume(ct)]
    looks_wrong += [f"{radiograph.name}: {line}" for line in check_radiograph(radiograph, sdd_known=sdd_known)]
    if initial is None:
        landmark = None if landmark_stored is None else _unstored(radiograph, landmark_stored)
        initial = initial_parameters(
            ct,
            detector,
            view,
            sdd_mm=radiograph.sdd_mm if sdd_mm is None else sdd_mm,
            landmark_patient_mm=landmark_patient_mm,
            landmark_image=landmark,
        )
    attenuating, whole = (
        attenuation(crop_to_anatomy(ct, threshold_hu=least), threshold_hu=least) for least in (threshold_hu, None)
    )
    if not bool(whole.data.sum().isfinite()):
        raise RegtorchError(f"{ct.name}: voxels that are NaN or infinite, expected HU everywhere")
    half_range = torch.tensor(SEARCH) if half_range is None else half_range
    if not bool((half_range >= 0).all()):
        raise RegtorchError(f"half range {half_range.tolist()}: expected numbers from 0 (frozen) on")
    moving = [index for index in moving if half_range[index] > 0]
    if not moving:
        raise RegtorchError(f"half range {half_range.tolist()}: everything is frozen, expected something to find")
    problem = Problem(
        attenuating=attenuating,
        threshold_hu=threshold_hu,
        whole=whole,
        radiograph=radiograph,
        view=view,
        similarity=similarity,
        initial=initial.double(),
        half_range=half_range.double(),
        free=moving,
        points=_points_in_image(attenuating, radiograph, initial, view),
        seed=seed,
        progress=progress,
    )
    found = method(problem)
    status, message = judge(problem, found)
    error = nan if found.covariance is None else root_mean_square_mm(problem, found.parameters, found.covariance)
    return Registration(
        parameters=found.parameters,
        initial=problem.initial,
        view=view,
        detector=detector,
        mirrored=radiograph.mirrored,
        image_from_patient=pixel_from_patient(found.parameters, detector, view, ct.origin_patient_mm),
        stored_from_pixel=radiograph.stored_from_pixel,
        status=status,
        message=message,
        warnings=(*looks_wrong, *warnings(problem, found)),
        similarity=found.similarity,
        starts=found.starts,
        start_similarity=found.start_similarity,
        evaluations=found.evaluations,
        covariance=found.covariance,
        error_rms_mm=error,
        origin_patient_mm=ct.origin_patient_mm,
        seconds=time.perf_counter() - began,
        device=str(attenuating.data.device),
        seed=seed,
    )


def _check_pixels(radiograph: Radiograph) -> None:
    """Of what counts: where all is masked, or outside the field, the pyramid says so."""
    if not bool(radiograph.image.isfinite().all() and radiograph.weight.isfinite().all()):
        raise RegtorchError(
            f"{radiograph.name}: pixels or weights that are NaN or infinite, expected numbers everywhere"
        )
    sides = [int(radiograph.weight.amax(dim).count_nonzero()) for dim in (1, 0)]
    if 0 < min(sides) < LEAST_PIXELS or max(radiograph.image.shape) > MOST_PIXELS:
        shape = " x ".join(map(str, sides if min(sides) < LEAST_PIXELS else radiograph.image.shape))
        raise RegtorchError(f"{radiograph.name}: {shape} pixels, expected {LEAST_PIXELS} to {MOST_PIXELS} each way")


def _unstored(radiograph: Radiograph, stored: Point2) -> Point2:
    """Where the image seen from the source has a pixel of the file."""
    size = torch.tensor([radiograph.detector.columns, radiograph.detector.rows], dtype=torch.float64)
    columns, rows = (radiograph.stored_from_pixel[:2, :2].abs() @ size).int().tolist()
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
    """Points of the anatomy that the initial parameters put into the image; all of them where it shows too few."""
    points = spread_points(attenuating, _POINTS)
    detector = radiograph.detector
    matrix = pixel_from_patient(initial.double(), detector, view, attenuating.origin_patient_mm)
    limit = torch.tensor([detector.columns - 0.5, detector.rows - 0.5], dtype=torch.float64)
    pixels = project(matrix, points)
    seen = ((pixels > -0.5) & (pixels < limit)).all(1)
    if not bool(pixels.isfinite().all(1).any()):
        raise RegtorchError("the start puts the patient behind the source: expected it between source and detector")
    return points[seen] if int(seen.sum()) >= _POINTS // 8 else points[pixels.isfinite().all(1)]
