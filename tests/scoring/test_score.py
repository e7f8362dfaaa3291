"""Fused scoring against projection, similarity and autograd done one after another."""

import numba
import pytest
import torch
from drr.scenes import pose_of, relative, smooth_volume

from regtorch.drr import render
from regtorch.errors import RegtorchError
from regtorch.geometry import Detector
from regtorch.imaging import Volume
from regtorch.scoring import gradient_correlations, normal_equations
from regtorch.similarity import gradient_correlation
from regtorch.similarity.gram import fixed_gradients

OBLIQUE = pose_of((12, -20, 1000), (5, -3, 300), (4, -7, 3))
SPREAD = torch.tensor([5, 5, 5, 3, 3, 3, 0.03, 0.03, 0.03], dtype=torch.float64)


def _poses(n: int) -> torch.Tensor:
    return OBLIQUE + torch.randn(n, 9, generator=torch.Generator().manual_seed(0), dtype=torch.float64) * SPREAD


def _case(detector: Detector, weighted: bool) -> tuple[Volume, torch.Tensor, torch.Tensor | None]:
    generator = torch.Generator().manual_seed(3)
    volume = smooth_volume()
    volume = volume.with_data(volume.data.float())
    fixed = render(volume, OBLIQUE, detector)
    fixed = fixed + 0.1 * fixed.max() * torch.randn(fixed.shape, generator=generator)
    return volume, fixed, (torch.rand(fixed.shape, generator=generator) > 0.2).float() if weighted else None


@pytest.mark.parametrize("weighted", [False, True], ids=["all pixels", "weighted"])
@pytest.mark.parametrize(
    "detector",
    [Detector(61, 45, 2.0), Detector(150, 40, 1.0), Detector(8, 16, 8.0), Detector(3, 2, 30.0), Detector(20, 300, 1.0)],
    ids=str,
)
def test_scores_are_those_of_rendering_and_comparing(detector, weighted):
    volume, fixed, weight = _case(detector, weighted)
    poses = _poses(5)
    exact = volume.with_data(volume.data.double()), None if weight is None else weight.double()
    moving = poses.clone().requires_grad_()
    images = render(exact[0], moving, detector, backend="torch")
    expected = gradient_correlation(images, fixed.double(), weight=exact[1])
    (slope,) = torch.autograd.grad(expected.sum(), moving)
    found = gradient_correlations(volume, poses, detector, "PA", fixed, weight=weight)
    torch.testing.assert_close(found, expected.detach(), atol=2e-6, rtol=0)
    fused = normal_equations(volume, poses, detector, "PA", fixed, weight=weight)
    plain = normal_equations(exact[0], poses, detector, "PA", fixed.double(), weight=exact[1], backend="torch")
    for part, exactly in zip(fused, plain, strict=True):
        assert relative(part, exactly) < 1e-4
    # |r|^2 / 2 = 2 (1 - similarity), so J^T r = -2 d similarity.
    assert relative(plain.jtr, -2 * slope) < 1e-9
    assert relative(fused.jtr, -2 * slope) < 1e-4


def test_j_t_j_is_the_product_of_the_residuals_jacobian():
    volume, fixed, _ = _case(Detector(12, 9, 8.0), False)
    volume, fixed = volume.with_data(volume.data.double()), fixed.double()
    unit = fixed_gradients(fixed, None).unit

    def residuals(pose):
        image = render(volume, pose, Detector(12, 9, 8.0), backend="torch")
        return fixed_gradients(image, None).unit - unit

    jacobian = torch.autograd.functional.jacobian(residuals, OBLIQUE).flatten(0, -2)
    found = normal_equations(volume, OBLIQUE, Detector(12, 9, 8.0), "PA", fixed, backend="torch")
    torch.testing.assert_close(found.jtj, jacobian.mT @ jacobian)
    torch.testing.assert_close(found.jtr, jacobian.mT @ residuals(OBLIQUE).flatten())


def test_a_subset_of_parameters_gives_that_part():
    detector = Detector(40, 30, 3.0)
    volume, fixed, _ = _case(detector, False)
    whole = normal_equations(volume, OBLIQUE, detector, "PA", fixed)
    part = normal_equations(volume, OBLIQUE, detector, "PA", fixed, free=[3, 4, 8])
    torch.testing.assert_close(part.similarity, whole.similarity)
    torch.testing.assert_close(part.jtj, whole.jtj[[3, 4, 8]][:, [3, 4, 8]])
    torch.testing.assert_close(part.jtr, whole.jtr[[3, 4, 8]])


@pytest.mark.parametrize("batch", [(), (1,), (2, 3), (0,)], ids=str)
def test_any_batch_shape_and_a_fixed_image_prepared_once(batch):
    detector = Detector(20, 30, 4.0)
    volume, fixed, weight = _case(detector, True)
    prepared = fixed_gradients(fixed, weight)
    found = normal_equations(volume, OBLIQUE.expand(*batch, 9), detector, "PA", prepared)
    single = normal_equations(volume, OBLIQUE, detector, "PA", fixed, weight=weight)
    for part, one in zip(found, single, strict=True):
        assert part.shape == (*batch, *one.shape)
        torch.testing.assert_close(part, one.expand(part.shape))
    scores = gradient_correlations(volume, OBLIQUE.expand(*batch, 9), detector, "PA", prepared)
    torch.testing.assert_close(scores, single.similarity.expand(batch), atol=1e-6, rtol=0)


def test_the_same_bits_with_any_number_of_threads():
    detector = Detector(100, 90, 1.2)
    volume, fixed, _ = _case(detector, False)
    first = normal_equations(volume, _poses(3), detector, "PA", fixed)
    threads = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        again = normal_equations(volume, _poses(3), detector, "PA", fixed)
    finally:
        numba.set_num_threads(threads)
    assert all(torch.equal(a, b) for a, b in zip(first, again, strict=True))


def test_an_image_without_contrast_has_no_similarity_and_no_slope():
    detector = Detector(20, 30, 4.0)
    volume, fixed, _ = _case(detector, False)
    aside = pose_of((0, 0, 1000), (900, 0, 300))
    for image, pose in ((fixed, aside), (torch.ones_like(fixed), OBLIQUE)):
        found = normal_equations(volume, pose, detector, "PA", image)
        assert float(found.similarity) == 0
        assert bool((found.jtr == 0).all())


def test_what_cannot_be_compared_is_refused():
    detector = Detector(20, 30, 4.0)
    volume, fixed, _ = _case(detector, False)
    with pytest.raises((RegtorchError, TypeError)):
        gradient_correlations(volume, OBLIQUE, detector, "PA", fixed[1:])
    with pytest.raises((RegtorchError, TypeError)):  # TypeError where shapes are checked, as here
        gradient_correlations(volume, OBLIQUE, detector, "PA", fixed, weight=fixed[1:])
    classes = Volume(torch.stack([volume.data] * 2), volume.patient_from_voxel, volume.origin_patient_mm, "per_mm")
    with pytest.raises(RegtorchError, match="2 classes of tissue"):
        gradient_correlations(classes, OBLIQUE, detector, "PA", fixed)
