"""How far the answer may be off: a covariance of the parameters from how parts of the image disagree about them."""

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import pad

from regtorch.drr import render_with_jacobian
from regtorch.geometry import Detector, pixel_from_patient, project
from regtorch.registration.matcher import Matcher
from regtorch.registration.problem import Problem
from regtorch.similarity.gradients import image_gradients

_PATCHES = 16
_INFLATION = 1.9
"""What patches have in common they cannot show: errors of simulated radiographs are this many times larger.

The median over 40 realistic radiographs (two CTs, PA and LAT; at targets on vertebrae and ribs) whose seeds no table
reports.
"""

_LEAST_CURVATURE = 1e-9


def covariance(matcher: Matcher, parameters: Float[Tensor, "9"]) -> Float[Tensor, "9 9"]:
    """Of the parameters (mm, rad; 0 for those that are frozen): H^-1 (sum over patches of s s^T) H^-1.

    For what the search climbs, the sum of rho = M F over both directions' normalised gradient images, H = sum rho J^T J
    and s = J^T (rho M - F) of a patch, a sixteenth of the image's longer side wide (White 1980, clustered). Residuals
    within a patch may depend on each other as they like; what they have in common over the whole image (an organ's
    pull, a wrong voxel size) this cannot see: the result is ``_INFLATION`` squared times as large. Infinite variance
    where nothing depends on a parameter or the images do not match.
    """
    level, free = matcher.level, matcher.problem.free
    detector = level.fixed.detector
    image, jacobian = render_with_jacobian(level.volume, parameters, detector, matcher.problem.view)
    matcher.tally.evaluations += 1
    root = matcher.gradients.root
    tiny = torch.finfo(root.dtype).tiny
    total = root.square().sum().clamp_min(tiny)
    curvature, scores = 0, 0
    images = torch.cat([image[None], jacobian[free]])
    for gradient, unit in zip(image_gradients(images), matcher.gradients.unit, strict=True):
        centred = (gradient - (gradient * root.square()).sum((1, 2), keepdim=True) / total) * root
        length = centred[0].norm().clamp_min(tiny)
        moving = centred[0] / length
        rho = (moving * unit).sum()
        slopes = (centred[1:] - moving * (centred[1:] * moving).sum((1, 2), keepdim=True)) / length
        flat = slopes.flatten(1).double()
        curvature = curvature + rho.clamp_min(0) * (flat @ flat.mT)
        scores = scores + slopes * (rho * moving - unit)
    side = -(-max(detector.rows, detector.columns) // _PATCHES)
    scores = pad(scores, (0, -detector.columns % side, 0, -detector.rows % side))
    patches = scores.unfold(1, side, side).unfold(2, side, side).sum((3, 4)).flatten(1).double().cpu()
    result = torch.zeros(9, 9, dtype=torch.float64)
    level_of = curvature.cpu().diagonal()
    if not bool((level_of.isfinite() & (level_of > 0)).all()):
        result[free, free] = torch.inf
        return result
    scale = 1 / level_of.sqrt()
    values, axes = torch.linalg.eigh(curvature.cpu() * scale[:, None] * scale)
    inverse = (axes / values.clamp_min(_LEAST_CURVATURE)) @ axes.mT
    spread = inverse @ (scale[:, None] * patches)
    result[torch.tensor(free)[:, None], torch.tensor(free)] = scale[:, None] * (spread @ spread.mT) * scale
    return _INFLATION**2 * result


def projection_covariance(
    parameters: Float[Tensor, "9"],
    covariance: Float[Tensor, "9 9"],
    points_mm: Float[Tensor, "n 3"],
    detector: Detector,
    view: str,
    origin_patient_mm: Float[Tensor, "3"],
) -> Float[Tensor, "n 2 2"]:
    """Of where points (LPS mm) are projected to, in mm in the detector plane, to first order."""

    def projected(values: Float[Tensor, "9"]) -> Float[Tensor, "n 2"]:
        return project(pixel_from_patient(values, detector, view, origin_patient_mm), points_mm) * detector.pixel_mm

    slopes = torch.autograd.functional.jacobian(projected, parameters.double())
    return slopes @ covariance @ slopes.mT


def root_mean_square_mm(problem: Problem, parameters: Float[Tensor, "9"], covariance: Float[Tensor, "9 9"]) -> float:
    """Expected error of the anatomy in the image: mm in the detector plane."""
    place = problem.radiograph.detector, problem.view, problem.attenuating.origin_patient_mm
    each = projection_covariance(parameters, covariance, problem.points, *place)
    return float(each.diagonal(dim1=1, dim2=2).sum(1).nanmean().sqrt())
