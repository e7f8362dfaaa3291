"""Where the search begins: protocol, body against the detector, one landmark."""

import pytest
import torch

from regtorch.errors import RegtorchError
from regtorch.geometry import Detector, pixel_from_patient, project, world_from_ct
from regtorch.imaging import Volume
from regtorch.imaging.hounsfield import BODY_HU, corners_ct
from regtorch.registration import initial_parameters
from regtorch.registration.start import SDD_MM, SEARCH, check_in_front

DETECTOR = Detector(60, 90, 4.0)
VIEWS = ("PA", "AP", "LLAT", "RLAT")


@pytest.fixture
def ct() -> Volume:
    """Off the middle of 20 x 30 x 24 voxels lies a body, 3 to 8 in i, 10 to 24 in j, 5 to 20 in k."""
    data = torch.full((24, 30, 20), -1000.0)
    data[5:21, 10:25, 3:9] = 40
    patient_from_voxel = torch.diag(torch.tensor([8.0, 6.0, 10.0, 1.0], dtype=torch.float64))
    patient_from_voxel[:3, 3] = torch.tensor([-100.0, 50.0, -700.0])
    return Volume.from_grid(data, patient_from_voxel, "made-up")


def test_protocol_without_anything_known(ct):
    parameters = initial_parameters(ct, DETECTOR, "PA")
    assert parameters.dtype == torch.float64
    assert parameters[2] == SDD_MM == 1000
    assert parameters[[0, 1, 3, 4, 6, 7, 8]].tolist() == [0] * 7
    assert initial_parameters(ct, DETECTOR, "PA", sdd_mm=1500.0)[2] == 1500


def test_the_body_touches_the_detector_from_the_side_of_the_source(ct):
    voxels = (ct.data > 0).nonzero().flip(1).double()
    in_ct = voxels @ ct.patient_from_voxel[:3, :3].mT + ct.patient_from_voxel[:3, 3] - ct.origin_patient_mm
    for view in VIEWS:
        parameters = initial_parameters(ct, DETECTOR, view)
        world_from = world_from_ct(parameters, view)
        height = (in_ct @ world_from[:3, :3].mT + world_from[:3, 3])[:, 2]
        assert float(height.min()) == pytest.approx(0, abs=1e-9), view
    # The body's middle is 2 mm behind that of the CT: 15 voxels of 6 mm, so 42 mm from one face and 47 from another.
    assert float(initial_parameters(ct, DETECTOR, "PA")[5]) == pytest.approx((14.5 - 10) * 6)
    assert float(initial_parameters(ct, DETECTOR, "AP")[5]) == pytest.approx((24 - 14.5) * 6)


def test_a_ct_of_air_alone_lies_against_the_detector_as_a_whole(ct):
    air = ct.with_data(torch.full_like(ct.data, -1000.0))
    assert float(initial_parameters(air, DETECTOR, "PA")[5]) == pytest.approx(14.5 * 6)
    assert corners_ct(air, BODY_HU).abs().unique(dim=0).shape == (1, 3)


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("sdd_mm", [None, 1800.0])
def test_the_landmark_projects_exactly_to_its_pixel(ct, view, sdd_mm):
    landmark, pixel = (-50.0, 150.0, -600.0), (70.25, 8.5)
    parameters = initial_parameters(
        ct, DETECTOR, view, sdd_mm=sdd_mm, landmark_patient_mm=landmark, landmark_image=pixel
    )
    matrix = pixel_from_patient(parameters, DETECTOR, view, ct.origin_patient_mm)
    found = project(matrix, torch.tensor([landmark], dtype=torch.float64))[0]
    torch.testing.assert_close(found, torch.tensor(pixel, dtype=torch.float64), atol=1e-9, rtol=0)
    assert parameters[[0, 1, 6, 7, 8]].tolist() == [0] * 5


@pytest.mark.parametrize(
    ("landmark", "pixel", "expected"),
    [
        ((-50.0, 150.0, -600.0), (90.0, 10.0), r"\(90, 10\).*inside the image of 90 x 60 pixels"),
        ((-50.0, 150.0, -600.0), (10.0, -0.6), r"\(10, -0.6\).*inside the image"),
        ((-50.0, 150.0, -600.0), (float("nan"), 0.0), "inside the image"),
        ((-50.0, 150.0, 600.0), (10.0, 10.0), "600.0.*inside made-up"),
        ((float("nan"), 150.0, -600.0), (10.0, 10.0), "inside made-up"),
        ((-50.0, 150.0, -600.0), None, "both or in neither"),
        (None, (10.0, 10.0), "both or in neither"),
    ],
)
def test_landmarks_that_cannot_be(ct, landmark, pixel, expected):
    with pytest.raises(RegtorchError, match=expected):
        initial_parameters(ct, DETECTOR, "PA", landmark_patient_mm=landmark, landmark_image=pixel)


@pytest.mark.parametrize("sdd_mm", [0.0, -1000.0, float("nan"), float("inf")])
def test_an_sdd_that_cannot_be(ct, sdd_mm):
    with pytest.raises(RegtorchError, match=r"SDD of .* expected a positive distance"):
        initial_parameters(ct, DETECTOR, "PA", sdd_mm=sdd_mm)


def test_the_whole_patient_must_fit_in_front_of_the_source(ct):
    initial_parameters(ct, DETECTOR, "PA", sdd_mm=85.0)
    with pytest.raises(RegtorchError, match=r"SDD of 83 mm.*made-up reaches 84 mm"):
        initial_parameters(ct, DETECTOR, "PA", sdd_mm=83.0)
    parameters = initial_parameters(ct, DETECTOR, "PA", sdd_mm=100.0)
    check_in_front(ct, parameters, "PA")
    parameters[6] = 1.5  # it is turned up on its end
    with pytest.raises(RegtorchError, match="SDD of 100 mm"):
        check_in_front(ct, parameters, "PA")


def test_unknown_view(ct):
    with pytest.raises(RegtorchError, match="unknown view 'pa': expected one of PA"):
        initial_parameters(ct, DETECTOR, "pa")


def test_the_range_searched_covers_what_the_paper_starts_off_by():
    assert all(half >= off for half, off in zip(SEARCH, (25, 25, 50, 25, 25, 50, 0.0873, 0.0873, 0.0873), strict=True))
