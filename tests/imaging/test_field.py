"""The collimated field is found where it shows, and nothing is cut where there is no collimator."""

from pathlib import Path

import pytest
import torch
from kornia.filters import gaussian_blur2d
from torch.nn.functional import interpolate, pad

from regtorch.formats import read_volume
from regtorch.imaging import attenuation, coarsen
from regtorch.imaging.field import exposed_field


def torso(rows: int = 400, columns: int = 360) -> torch.Tensor:
    """Line integrals of a cylinder with a bright spine, ribs and dark lungs, cut above and below, air beside."""
    y, x = torch.meshgrid(torch.linspace(-1, 1, rows), torch.linspace(-1, 1, columns), indexing="ij")
    body = 4 * (1 - (x / 0.8) ** 2).clamp(min=0).sqrt()
    lungs = 2 * torch.exp(-(((x.abs() - 0.4) / 0.2) ** 2) - (y / 0.6) ** 2)
    spine = 2 * (x.abs() < 0.1) * (1 + 0.3 * torch.sin(40 * y))
    ribs = 0.5 * (torch.sin(25 * (y + x.abs())) > 0.6) * (x.abs() < 0.7)
    return (body - lungs + spine + ribs).clamp(min=0)


def collimated(
    image: torch.Tensor, box: tuple[int, int, int, int], beyond: float, *, noise: float = 0.03
) -> torch.Tensor:
    r0, r1, c0, c1 = box
    out = torch.full_like(image, beyond)
    out[r0:r1, c0:c1] = image[r0:r1, c0:c1]
    return out + noise * torch.randn(image.shape, generator=torch.Generator().manual_seed(0))


@pytest.mark.parametrize(
    "box",
    [
        (40, 370, 30, 320),
        (0, 400, 60, 300),
        (50, 400, 0, 360),
        (0, 400, 0, 250),
        (90, 310, 90, 270),
        (20, 260, 130, 345),
    ],
)
def test_collimator(box: tuple[int, int, int, int]) -> None:
    found = exposed_field(collimated(torso(), box, 6.5))
    for found_at, at, inwards, whole in zip(found, box, (1, -1, 1, -1), (0, 400, 0, 360), strict=True):
        assert at == whole or 0 <= (found_at - at) * inwards <= 9, (found, box)
        assert at != whole or found_at == whole, (found, box)


def test_burnt_in_shutter() -> None:
    image = torch.zeros(400, 360)
    image[40:300, 70:290] = torso()[40:300, 70:290] + 1
    assert exposed_field(image) == (40, 300, 70, 290)
    image[15:30, 20:32] = 3
    assert exposed_field(image) == (40, 300, 70, 290)


@pytest.mark.parametrize("scatter", [0.1, 0.9])
@pytest.mark.parametrize("tilt", [-7, 6])
@pytest.mark.parametrize("sharpened", [0.0, 1.5])
def test_collimator_beyond_which_scatter_falls(scatter: float, tilt: int, sharpened: float) -> None:
    """Much of the field is brighter than the area behind the collimator, and letters are brightest."""
    box = (50, 350, 40, 300)
    beam = collimated(torch.ones(400, 360), box, 0.01, noise=0)
    turned = torch.arange(400)[:, None] + torch.linspace(-tilt / 2, tilt / 2, 360).round().long()
    beam = gaussian_blur2d(beam.gather(0, turned.clamp(0, 399))[None, None], (9, 9), (1.0, 1.0))[0, 0]
    light = torch.exp(-torso()) * beam
    light = light + scatter * gaussian_blur2d(light[None, None], (241, 241), (60.0, 60.0), "constant")[0, 0]
    noise = 1 + 0.01 * torch.randn(light.shape, generator=torch.Generator().manual_seed(0))
    image = -(light * noise).log()
    image = image + sharpened * (image - gaussian_blur2d(image[None, None], (61, 61), (10.0, 10.0))[0, 0])
    image[60:75, 270:280] = image.max() + 1
    for found_at, at, inwards, rises in zip(exposed_field(image), box, (1, -1, 1, -1), (tilt, tilt, 0, 0), strict=True):
        assert abs(rises) // 2 <= (found_at - at) * inwards <= 14


@pytest.mark.parametrize("margin", [0, 100])
def test_no_collimator_no_crop(margin: int) -> None:
    """Whole, in wide air, cut through the body on one side, thresholded, upside down, nearly nothing."""
    image = torso()
    bone = (image - 4).clamp(min=0)
    dot = torch.zeros(400, 360)
    dot[200:210, 100:110] = 1
    for candidate in (image, bone, dot, image[:, :180], image[:, 180:], image[:200], image.mT, torch.zeros(400, 360)):
        padded = pad(candidate.contiguous(), (margin,) * 4)
        assert exposed_field(padded) == (0, padded.shape[0], 0, padded.shape[1])


def test_a_straight_bone_with_air_beyond_it_is_no_collimator() -> None:
    """Cut by the border, and brighter on the whole than the area beside it."""
    image = torso()
    image[:, 300:330] = 5
    image[:, 330:] = 0
    image += 0.02 * torch.randn(image.shape, generator=torch.Generator().manual_seed(0))
    assert exposed_field(image) == (0, 400, 0, 360)


def test_no_field_is_left_of_air_alone() -> None:
    image = torso()
    image[150:] = 0
    assert exposed_field(image.flip(0)) == (0, 400, 0, 360)


@pytest.mark.parametrize("beyond", ["plain, nothing left", "rich in detail"])
def test_a_straight_bright_border_need_not_be_a_collimators(beyond: str) -> None:
    """A shield over air; straight anatomy, like a spine, cut by the border beside almost nothing."""
    image = 0.01 * torch.randn((400, 360), generator=torch.Generator().manual_seed(0))
    image[:60] += 5
    if beyond == "rich in detail":
        image[60:] += torch.linspace(0, 2, 340)[:, None]
        image[:60] += torch.arange(360).div(2).sin()
    assert exposed_field(image) == (0, 400, 0, 360)


def test_small_images_are_left_alone() -> None:
    image = collimated(torso(120, 100), (20, 120, 0, 100), 6.5)
    assert exposed_field(image) == (0, 120, 0, 100)


@pytest.mark.parametrize("name", ["acrin_abdomen_pelvis.nii.gz", "totalsegmentator_pelvis_3mm.nii.gz"])
@pytest.mark.parametrize("threshold_hu", [None, 100.0])
def test_projections_of_real_cts_are_not_cropped(data_folder: Path, name: str, threshold_hu: float | None) -> None:
    ct = coarsen(attenuation(read_volume(data_folder / name), threshold_hu=threshold_hu), 3.0)
    for axis in (1, 2):
        image = interpolate(ct.data.sum(axis).flip(0)[None, None], size=(140, 130), mode="bilinear")[0, 0]
        for candidate in (image, pad(image, (40,) * 4), image[20:120, 30:100], image[:, :70], image[:, 60:]):
            candidate = candidate.contiguous()
            assert exposed_field(candidate) == (0, candidate.shape[0], 0, candidate.shape[1]), axis
