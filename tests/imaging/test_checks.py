"""Sound images give no warning; each fault gives its own."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from regtorch.formats import read_volume
from regtorch.geometry import Detector
from regtorch.imaging import Radiograph, Volume, attenuation, check_radiograph, check_volume, coarsen

from .test_field import torso


def made_ct(spacing: tuple[float, float, float] = (1.0, 1.0, 2.0), thickness: float | None = None) -> Volume:
    """Air around soft tissue and fat with bone in it."""
    data = torch.full((30, 40, 50), -1000.0)
    data[:, 5:35, 5:45] = -100
    data[:, 8:32, 8:42] = 40
    data[:, 15:20, 20:28] = 700
    return Volume.from_grid(data, torch.diag(torch.tensor([*spacing, 1.0])).double(), "made", thickness)


def radiograph(image: torch.Tensor, sdd_mm: float | None = 1000.0, pixel_mm: float = 1.0) -> Radiograph:
    image = image.contiguous()
    return Radiograph.from_image(image, Detector(*image.shape, pixel_mm), sdd_mm=sdd_mm)


def test_sound_ct() -> None:
    assert check_volume(made_ct()) == []
    assert check_volume(made_ct(thickness=5.0)) == [], "overlapping slices are in order"


def test_faults_of_a_ct() -> None:
    sound = made_ct()
    nothing = sound.with_data(torch.full((30, 40, 50), -1000.0))
    nothing.data[0, :5, :5] = 40
    faults = {
        "no HU offset": sound.with_data(sound.data + 1024),
        "nearly no air": sound.with_data(sound.data.clamp(min=-150)),
        "nearly empty": nothing,
        "no bone": sound.with_data(sound.data.clamp(max=60)),
        "voxels of 1 x 1 x 8 mm": made_ct((1.0, 1.0, 8.0)),
        "the body is cut at a side (100 %": sound.on_grid(sound.data[:, :, 8:], sound.patient_from_voxel),
        "gaps between slices: 1.25 mm thick but 2 mm apart": made_ct(thickness=1.25),
    }
    for message, volume in faults.items():
        found = check_volume(volume)
        assert len(found) == 1, (message, found)
        assert found[0].startswith(message), (message, found)


def test_sound_radiographs() -> None:
    image = torso()
    noise = torch.randn(image.shape, generator=torch.Generator().manual_seed(0))
    for candidate in (image, image + 0.2 * noise, image[:, 60:300], (image - 4).clamp(min=0), image[:, :200]):
        assert check_radiograph(radiograph(candidate)) == []


def test_faults_of_a_radiograph() -> None:
    image = torso()
    hot = torch.zeros(400, 360)
    hot[200, 100] = 1
    mostly_masked = replace(radiograph(image), weight=torch.zeros(400, 360).index_fill_(0, torch.arange(60), 1))
    faults = {
        "inverted or not log": radiograph(-image),
        "inverted or not logarithmic? ": radiograph(torch.exp(-image)),
        "not logarithmic": radiograph(-torch.exp(-0.7 * image)),
        "empty: every pixel": radiograph(torch.zeros(400, 360)),
        "nearly empty": radiograph(hot),
        "only 16 grey levels": radiograph((image / image.max() * 15.4).round()),
        "grey range cut off": radiograph(image.clamp(max=4.5)),
        "no source-detector distance": radiograph(image, sdd_mm=None),
        "source-detector distance (SDD) of 20 mm": radiograph(image, sdd_mm=20.0),
        "pixels of 10 mm make a detector of 3600 x 4000 mm": radiograph(image, pixel_mm=10.0),
        "pixels of 0.01 mm": radiograph(image, pixel_mm=0.01),
        "only 15 % of the image counts": mostly_masked,
        "what reading found": replace(radiograph(image), warnings=("what reading found",)),
    }
    for message, candidate in faults.items():
        found = check_radiograph(candidate)
        assert len(found) == 1, (message, found)
        assert found[0].startswith(message), (message, found)


def test_what_is_masked_is_not_judged() -> None:
    image, weight = torso(), torch.ones(400, 360)
    image[:, :40], weight[:, :40] = 50, 0
    assert check_radiograph(replace(radiograph(image), weight=weight)) == []


@pytest.mark.parametrize(
    "name", ["acrin_abdomen_pelvis.nii.gz", "totalsegmentator_pelvis_3mm.nii.gz", "ct_slices_dicom"]
)
def test_real_cts_and_their_projections(data_folder: Path, name: str) -> None:
    ct = read_volume(data_folder / name)
    assert check_volume(ct) == []
    if name != "ct_slices_dicom":  # a slab
        for threshold_hu in (None, 100.0):
            volume = coarsen(attenuation(ct, threshold_hu=threshold_hu), 3.0)
            for axis in (1, 2):
                assert check_radiograph(radiograph(volume.data.sum(axis).flip(0), pixel_mm=3.0)) == []
