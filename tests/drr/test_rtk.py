"""Geometry and Joseph's projector of RTK, an independent implementation, against ours.

RTK's convention, found by experiment: ``AddProjection`` takes source and detector as points and the directions along
rows and along columns of the image, all in the frame of the volume (LPS mm); ``GetMatrix`` then maps LPS mm to mm in
the detector plane from the detector's point, along the first (to the next column) and the second direction (to the
next row, so our -Y), up to sign and scale; the projection is an ITK image stack whose origin is the first pixel's
centre in those mm, and volumes keep their ITK direction.
"""

from types import ModuleType

import numpy as np
import pytest
import torch

from regtorch.drr import render
from regtorch.formats import read_volume
from regtorch.geometry import Detector, pixel_from_patient, project, world_from_ct
from regtorch.imaging import Volume, attenuation, coarsen

from .scenes import pose_of, relative

pytestmark = [pytest.mark.peers, pytest.mark.filterwarnings("ignore:builtin type:DeprecationWarning")]

ORIGIN_MM = torch.tensor([12.5, -140.0, 830.0], dtype=torch.float64)

POSES = {
    "straight": pose_of(),
    "as in the study": pose_of((20, -15, 1020), (-14, 10, 290), (4.6, -3.4, 2.9)),
    "oblique": pose_of((-30, 25, 1000), (10, -20, 300), (11.0, 40.0, 6.0)),
}


@pytest.fixture(scope="module")
def itk() -> ModuleType:
    itk = pytest.importorskip("itk")
    if not hasattr(itk, "RTK"):
        pytest.skip("itk without RTK: pip install regtorch[peers]")
    return itk


@pytest.fixture(scope="module")
def bone(data_folder) -> Volume:
    """A real CT above 100 HU at 3 mm, with air around it, because projectors treat the outermost voxels differently."""
    coarse = coarsen(attenuation(read_volume(data_folder / "fda_thorax_phantom.nii.gz")), 3.0)
    patient_from_voxel = coarse.patient_from_voxel.clone()
    patient_from_voxel[:, 3] = coarse.patient_from_voxel @ torch.tensor([-2, -2, -2, 1.0], dtype=torch.float64)
    return coarse.on_grid(torch.nn.functional.pad(coarse.data, (2,) * 6), patient_from_voxel)


def _rtk_geometry(itk: ModuleType, pose: torch.Tensor, view: str, origin_patient_mm: torch.Tensor):
    patient_from_world = torch.linalg.inv(world_from_ct(pose, view))
    patient_from_world[:3, 3] += origin_patient_mm

    def place(world: torch.Tensor) -> list[float]:
        return (patient_from_world[:3, :3] @ world + patient_from_world[:3, 3]).tolist()

    geometry = itk.RTK.ThreeDCircularProjectionGeometry.New()
    point, vector = itk.Point[itk.D, 3], itk.Vector[itk.D, 3]
    assert geometry.AddProjection(
        point(place(pose[:3])),
        point(place(pose.new_zeros(3))),
        vector(patient_from_world[:3, 0].tolist()),
        vector((-patient_from_world[:3, 1]).tolist()),
    )
    return geometry


def _rtk_joseph(itk: ModuleType, volume: Volume, pose: torch.Tensor, detector: Detector, view: str) -> torch.Tensor:
    ct = itk.image_from_array(volume.data.numpy())
    ct.SetOrigin(volume.patient_from_voxel[:3, 3].tolist())
    ct.SetSpacing(volume.spacing_mm.tolist())
    ct.SetDirection(itk.matrix_from_array((volume.patient_from_voxel[:3, :3] / volume.spacing_mm).numpy()))
    stack = itk.image_from_array(np.zeros((1, detector.rows, detector.columns), np.float32))
    stack.SetSpacing([detector.pixel_mm, detector.pixel_mm, 1])
    stack.SetOrigin([-(n - 1) / 2 * detector.pixel_mm for n in (detector.columns, detector.rows)] + [0])
    projector = itk.RTK.JosephForwardProjectionImageFilter[type(ct), type(ct)].New()
    projector.SetInput(0, stack)
    projector.SetInput(1, ct)
    projector.SetGeometry(_rtk_geometry(itk, pose, view, volume.origin_patient_mm))
    projector.Update()
    return torch.from_numpy(itk.array_from_image(projector.GetOutput())[0])


@pytest.mark.parametrize("view", ["PA", "AP", "LLAT", "RLAT"])
def test_projection_matrices_are_rtks(itk, view):
    generator = torch.Generator().manual_seed(0)
    spread = torch.tensor([60, 60, 300, 60, 60, 120, 0.6, 0.6, 0.6], dtype=torch.float64)
    poses = pose_of() + spread * (2 * torch.rand(20, 9, generator=generator, dtype=torch.float64) - 1)
    points = ORIGIN_MM + 300 * (torch.rand(30, 3, generator=generator, dtype=torch.float64) - 0.5)
    detector = Detector(500, 430, 0.7)
    ours = project(pixel_from_patient(poses, detector, view, ORIGIN_MM), points)
    middle = torch.tensor([(detector.columns - 1) / 2, (detector.rows - 1) / 2], dtype=torch.float64)
    for pose, pixels in zip(poses, ours, strict=True):
        matrix = torch.from_numpy(itk.array_from_matrix(_rtk_geometry(itk, pose, view, ORIGIN_MM).GetMatrix(0)))
        matrix = matrix * (matrix[2] @ torch.tensor([*ORIGIN_MM, 1], dtype=torch.float64)).sign()
        rtks = middle + project(matrix, points) / detector.pixel_mm
        torch.testing.assert_close(pixels, rtks, atol=1e-3, rtol=0)


@pytest.mark.parametrize("backend", ["cpu", "torch"])
@pytest.mark.parametrize("view", ["PA", "LLAT"])
@pytest.mark.parametrize("name", POSES)
def test_joseph_of_a_real_ct_is_rtks(itk, bone, name, view, backend):
    detector = Detector(125, 125, 3.2)
    rtks = _rtk_joseph(itk, bone, POSES[name], detector, view)
    assert float((rtks > 0).double().mean()) > 0.5, "the image shows the anatomy"
    assert relative(render(bone, POSES[name], detector, view, backend=backend), rtks) < 1e-3


@pytest.mark.parametrize("backend", ["cpu", "torch"])
def test_joseph_on_a_turned_grid_with_oblong_voxels_and_a_lopsided_detector_is_rtks(itk, backend):
    generator = torch.Generator().manual_seed(0)
    turn = torch.linalg.qr(torch.randn(3, 3, generator=generator, dtype=torch.float64)).Q
    turn *= torch.linalg.det(turn)
    patient_from_voxel = torch.eye(4, dtype=torch.float64)
    patient_from_voxel[:3, :3] = turn * torch.tensor([1.5, 2.5, 4.0], dtype=torch.float64)
    patient_from_voxel[:3, 3] = ORIGIN_MM
    data = torch.nn.functional.pad(torch.rand(20, 40, 50, generator=generator), (2,) * 6)
    grid = Volume.from_grid(data, patient_from_voxel)
    volume = Volume(data, grid.patient_from_voxel, grid.origin_patient_mm, "per_mm")
    detector, pose = Detector(60, 101, 2.0), POSES["oblique"]
    rtks = _rtk_joseph(itk, volume, pose, detector, "AP")
    assert bool((rtks > 0).any())
    assert relative(render(volume, pose, detector, "AP", backend=backend), rtks) < 1e-3
