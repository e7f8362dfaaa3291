"""How far the answer may be off: a covariance from how parts of the image disagree about the unknowns."""

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import pad

from regtorch.geometry import Detector, pixel_from_patient, project
from regtorch.registration.problem import Problem
from regtorch.similarity.gradients import image_gradients
from regtorch.similarity.gram import FixedGradients

PATCHES = 16
"""Patches along the longer side of the image."""

INFLATION = 1.9
"""Factor on standard deviations for errors that all patches share.

It is the median over 40 realistic radiographs (two CTs, PA and LAT; at targets on vertebrae and ribs) whose seeds no
table reports.
"""

_LEAST_CURVATURE = 1e-9


def clustered_covariance(
    image: Float[Tensor, "h w"], slopes: Float[Tensor, "d h w"], fixed: FixedGradients
) -> Float[Tensor, "d d"]:
    """Covariance of d unknowns: H^-1 (sum over patches of s s^T) H^-1 (White 1980, clustered).

    ``image`` is the DRR at the answer and ``slopes`` its derivatives by the unknowns. The search climbs the sum of
    rho = M F over both directions' normalised gradient images. Its H is sum rho J^T J, and s is J^T (rho M - F) of a
    patch, a sixteenth of the image's longer side wide. Residuals within a patch may depend on each other. Errors that
    the whole image shares, an organ's pull or a wrong voxel size, stay unseen: hence ``INFLATION``. The diagonal is
    infinite where nothing depends on an unknown or the images do not match.
    """
    root = fixed.root
    tiny = torch.finfo(root.dtype).tiny
    total = root.square().sum().clamp_min(tiny)
    curvature, scores = 0, 0
    images = torch.cat([image[None], slopes])
    for gradient, unit in zip(image_gradients(images), fixed.unit, strict=True):
        centred = (gradient - (gradient * root.square()).sum((1, 2), keepdim=True) / total) * root
        length = centred[0].norm().clamp_min(tiny)
        moving = centred[0] / length
        rho = (moving * unit).sum()
        jacobian = (centred[1:] - moving * (centred[1:] * moving).sum((1, 2), keepdim=True)) / length
        flat = jacobian.flatten(1).double()
        curvature = curvature + rho.clamp_min(0) * (flat @ flat.mT)
        scores = scores + jacobian * (rho * moving - unit)
    rows, columns = image.shape
    side = -(-max(rows, columns) // PATCHES)
    scores = pad(scores, (0, -columns % side, 0, -rows % side))
    patches = scores.unfold(1, side, side).unfold(2, side, side).sum((3, 4)).flatten(1).double().cpu()
    level_of = curvature.cpu().diagonal()
    if not bool((level_of.isfinite() & (level_of > 0)).all()):
        return torch.full_like(level_of, torch.inf).diag_embed()
    scale = 1 / level_of.sqrt()
    values, axes = torch.linalg.eigh(curvature.cpu() * scale[:, None] * scale)
    inverse = (axes / values.clamp_min(_LEAST_CURVATURE)) @ axes.mT
    spread = inverse @ (scale[:, None] * patches)
    return INFLATION**2 * (scale[:, None] * (spread @ spread.mT) * scale)


def projection_covariance(
    parameters: Float[Tensor, "9"],
    covariance: Float[Tensor, "9 9"],
    points_mm: Float[Tensor, "n 3"],
    detector: Detector,
    view: str,
    origin_patient_mm: Float[Tensor, "3"],
) -> Float[Tensor, "n 2 2"]:
    """Covariance of each point's projection (points LPS mm), in mm in the detector plane, to first order."""

    def projected(values: Float[Tensor, "9"]) -> Float[Tensor, "n 2"]:
        return project(pixel_from_patient(values, detector, view, origin_patient_mm), points_mm) * detector.pixel_mm

    slopes = torch.autograd.functional.jacobian(projected, parameters.double())
    return slopes @ covariance @ slopes.mT


def root_mean_square_mm(problem: Problem, parameters: Float[Tensor, "9"], covariance: Float[Tensor, "9 9"]) -> float:
    """Expected error of the anatomy in the image: mm in the detector plane."""
    place = problem.radiograph.detector, problem.view, problem.attenuating.origin_patient_mm
    each = projection_covariance(parameters, covariance, problem.points, *place)
    return float(each.diagonal(dim1=1, dim2=2).sum(1).nanmean().sqrt())
