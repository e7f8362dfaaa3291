"""Scores and normal equations by the GPU's kernels against plain torch in float64."""

import pytest
import torch
from drr.scenes import pose_of, random_volume, relative
from interpreted import DEVICE, needs_triton

from regtorch.drr import render
from regtorch.geometry import Detector
from regtorch.scoring import gradient_correlations, normal_equations, triton

pytestmark = needs_triton

DETECTOR = Detector(11, 18, 3.0)
POSES = torch.stack([pose_of((12, -20, 1000), (5, -3, 300), (4, -7 + 3 * n, 3)) for n in range(3)])


@pytest.mark.parametrize("method", ["joseph", "siddon"])
def test_scores_are_those_of_rendering_and_comparing(method, monkeypatch):
    monkeypatch.setattr(triton, "_PIXELS_AT_ONCE", 1500)  # a few poses at a time
    volume = random_volume(9, 10, 8, spacing=(3.0, 4.0, 2.0))
    exact = volume.with_data(volume.data.double())
    fixed = render(exact, POSES[0] + 0.01, DETECTOR, backend="torch")
    weight = (torch.rand(fixed.shape, generator=torch.Generator().manual_seed(1)) > 0.1).double()
    free = [0, 3, 4, 5, 6, 8]
    here = volume.with_data(volume.data.to(DEVICE)), POSES.to(DEVICE), DETECTOR, "PA", fixed.float().to(DEVICE)
    options = {"method": method, "backend": "triton", "weight": weight.float().to(DEVICE)}
    plain = {"method": method, "backend": "torch", "weight": weight, "free": free}
    expected = normal_equations(exact, POSES, DETECTOR, "PA", fixed, **plain)
    found = normal_equations(*here, **options, free=free)
    for one, right in zip(found, expected, strict=True):
        assert relative(one.cpu(), right) < 1e-4
    for one, other in zip(found, normal_equations(*here, **options, free=free), strict=True):
        assert torch.equal(one, other)
    torch.testing.assert_close(gradient_correlations(*here, **options).cpu(), expected.similarity, atol=2e-6, rtol=0)
