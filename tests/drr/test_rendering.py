"""``render``: shapes, choice of the backend, refused input."""

import pytest
import torch

from regtorch.drr import cpu, reference, render
from regtorch.errors import RegtorchError
from regtorch.geometry import Detector
from regtorch.imaging import Volume

from .scenes import pose_of, random_volume

DETECTOR = Detector(6, 9, 2.0)
ALL = [(method, backend) for method in ("joseph", "siddon", "trilinear") for backend in ("cpu", "torch")]


@pytest.fixture
def taken(monkeypatch) -> list[str]:
    """The backends that rendered, in turn."""
    names: list[str] = []

    def spy(name, project):
        def called(*arguments):
            names.append(name)
            return project(*arguments)

        return called

    monkeypatch.setattr(cpu, "project", spy("cpu", cpu.project))
    monkeypatch.setattr(reference, "project", spy("torch", reference.project))
    return names


@pytest.mark.parametrize(("method", "backend"), ALL)
@pytest.mark.parametrize("batch", [(), (1,), (3,), (2, 3), (0,), (2, 0)], ids=str)
def test_any_batch_shape(batch, method, backend):
    volume, pose = random_volume(8, 7, 6), pose_of((1, 2, 500), (3, 4, 150), (5, 6, 7))
    images = render(volume, pose.expand(*batch, 9), DETECTOR, method=method, backend=backend)
    assert images.shape == (*batch, 6, 9)
    assert images.dtype == torch.float32
    single = render(volume, pose, DETECTOR, method=method, backend=backend)
    torch.testing.assert_close(images, single.expand(images.shape))


@pytest.mark.parametrize(("method", "backend"), ALL)
def test_poses_in_float32_are_computed_with_in_float64(method, backend):
    pose = pose_of((1, 2, 500), (3, 4, 150), (5, 6, 7)).float()
    images = [
        render(random_volume(8, 7, 6), p, DETECTOR, method=method, backend=backend) for p in (pose, pose.double())
    ]
    assert torch.equal(*images)


def test_auto_takes_the_fastest_that_can(taken):
    volume, pose = random_volume(4, 5, 6), pose_of()
    double = volume.with_data(volume.data.double())
    needs_gradient = volume.with_data(volume.data.clone().requires_grad_())
    expected = []
    for v, p, method, backend in (
        (volume, pose, "joseph", "cpu"),
        (volume, pose, "siddon", "cpu"),
        (volume, pose, "trilinear", "cpu"),
        (double, pose, "joseph", "torch"),
        (volume, pose.clone().requires_grad_(), "joseph", "cpu"),
        (needs_gradient, pose, "siddon", "cpu"),
    ):
        render(v, p, DETECTOR, method=method)
        expected.append(backend)
    with torch.no_grad():
        render(volume, pose.clone().requires_grad_(), DETECTOR)
        render(needs_gradient, pose, DETECTOR)
    assert taken == [*expected, "cpu", "cpu"]


def test_a_backend_that_is_asked_for_is_taken(taken):
    for backend in ("torch", "cpu"):
        render(random_volume(4, 5, 6), pose_of(), DETECTOR, backend=backend)
    assert taken == ["torch", "cpu"]


@pytest.mark.parametrize("backend", ["cpu", "triton"])
def test_a_backend_that_cannot_says_why_and_no_other_is_taken(backend, taken):
    with pytest.raises(RegtorchError, match=f"backend '{backend}' cannot render this: .*, expected "):
        render(random_volume(4, 5, 6, dtype=torch.float64), pose_of(), DETECTOR, backend=backend)
    assert not taken


@pytest.mark.parametrize("unknown", [{"backend": "cuda"}, {"method": "splat"}], ids=str)
def test_an_unknown_backend_or_method_is_refused(unknown, taken):
    with pytest.raises((RegtorchError, TypeError)):  # TypeError where shapes and types are checked, as here
        render(random_volume(4, 5, 6), pose_of(), DETECTOR, **unknown)
    assert not taken


def test_hu_are_not_rendered():
    ct = Volume.from_grid(torch.zeros(4, 5, 6), torch.eye(4), name="chest.nii")
    with pytest.raises(RegtorchError, match=r"chest.nii: values in HU, expected attenuation per mm"):
        render(ct, pose_of(), DETECTOR)


@pytest.mark.parametrize("value", [torch.nan, torch.inf])
@pytest.mark.parametrize("which", [0, 2, 8])
def test_poses_that_are_not_finite_are_refused(which, value):
    poses = pose_of().repeat(3, 1)
    poses[1, which] = value
    with pytest.raises(RegtorchError, match="parameters that are not finite"):
        render(random_volume(4, 5, 6), poses, DETECTOR)


@pytest.mark.parametrize("sdd_mm", [0.0, -1000.0])
def test_a_source_not_in_front_of_the_detector_is_refused(sdd_mm):
    poses = torch.stack([pose_of(), pose_of(source=(0, 0, sdd_mm))])
    with pytest.raises(RegtorchError, match=f"SDD of {sdd_mm:g} mm: expected a positive distance"):
        render(random_volume(4, 5, 6), poses, DETECTOR)
