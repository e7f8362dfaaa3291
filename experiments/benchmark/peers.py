"""Other projectors made to render regtorch's poses: RTK, nanodrr, DiffDRR and plastimatch, each if it is installed.

A peer is a function of volume, detector, view and threads, which gets ready whatever does not depend on the pose and
returns ``images(poses [b, 9]) -> [b, h, w]``. Its own options are keyword-only. It raises ``ImportError`` where it
is not installed. One with a derivative, asked for ``gradient``, returns instead ``gradient(poses, weight [h, w]) ->
[b, 9]``: of the weighted sum of each image, by a forward and a backward pass. What runs in torch's threads leaves their
number to the caller.
"""

import os
import re
import subprocess
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.geometry import Detector, cone_beam_rays
from regtorch.geometry.conventions import to_camera, to_plastimatch, to_rtk
from regtorch.imaging import Volume

Images = Callable[[Float[Tensor, "b 9"]], Float[Tensor, "b h w"]]
Gradient = Callable[[Float[Tensor, "b 9"], Float[Tensor, "h w"]], Float[Tensor, "b 9"]]

_RAYS_AT_ONCE = 1 << 15  # about the fastest for torch on a CPU: two poses at 125 x 125 pixels


def rtk(volume: Volume, detector: Detector, view: str, threads: int) -> Images:
    """RTK's Joseph projector on CPU threads, all poses as one stack; ``tests/drr/test_rtk.py`` tells its frames."""
    import itk

    if not hasattr(itk, "RTK"):
        raise ImportError("itk without RTK")
    itk.MultiThreaderBase.SetGlobalDefaultNumberOfThreads(threads)
    ct = itk.image_from_array(volume.data.cpu().numpy())
    ct.SetOrigin(volume.patient_from_voxel[:3, 3].tolist())
    ct.SetSpacing(volume.spacing_mm.tolist())
    ct.SetDirection(itk.matrix_from_array((volume.patient_from_voxel[:3, :3] / volume.spacing_mm).numpy()))
    point, vector = itk.Point[itk.D, 3], itk.Vector[itk.D, 3]
    x, y = detector.centre_mm

    def images(poses: Tensor) -> Tensor:
        geometry = itk.RTK.ThreeDCircularProjectionGeometry.New()
        for source, centre, columns, rows in zip(*to_rtk(poses, view, volume.origin_patient_mm), strict=True):
            geometry.AddProjection(
                point(source.tolist()), point(centre.tolist()), vector(columns.tolist()), vector(rows.tolist())
            )
        stack = itk.image_from_array(np.zeros((len(poses), detector.rows, detector.columns), np.float32))
        stack.SetSpacing([detector.pixel_mm, detector.pixel_mm, 1])
        stack.SetOrigin(
            [x - (detector.columns - 1) / 2 * detector.pixel_mm, -y - (detector.rows - 1) / 2 * detector.pixel_mm, 0]
        )
        projector = itk.RTK.JosephForwardProjectionImageFilter[type(ct), type(ct)].New()
        projector.SetNumberOfWorkUnits(threads)
        projector.SetInput(0, stack)
        projector.SetInput(1, ct)
        projector.SetGeometry(geometry)
        projector.Update()
        return torch.from_numpy(itk.array_from_image(projector.GetOutput()))

    return images


def nanodrr(
    volume: Volume,
    detector: Detector,
    view: str,
    threads: int,
    *,
    samples: int | None = None,
    at_once: int | None = None,
    backend: str = "torch",
    gradient: bool = False,
) -> Images | Gradient:
    """nanodrr, trilinear with ``samples`` along each ray (500 is its default); None: one per slice, as Joseph has.

    The gradient goes back through its extrinsic and intrinsic matrices to all nine parameters.
    """
    render = _nanodrr(volume, detector, view, samples, backend)
    at_once = at_once or max(1, _RAYS_AT_ONCE // (detector.rows * detector.columns))
    return partial(_gradient if gradient else _without_gradient, render, at_once=at_once)


def diffdrr(
    volume: Volume,
    detector: Detector,
    view: str,
    threads: int,
    *,
    renderer: str = "trilinear",
    samples: int | None = None,
    at_once: int | None = None,
    gradient: bool = False,
) -> Images | Gradient:
    """DiffDRR's renderers on rays in voxels, so that no way of its own from pose to rays is on the clock.

    ``trilinear`` takes ``samples`` along each ray, by default its own 500; ``siddon`` takes none.
    """
    render = _diffdrr(volume, detector, view, renderer, samples)
    at_once = at_once or max(1, _RAYS_AT_ONCE // (detector.rows * detector.columns))
    return partial(_gradient if gradient else _without_gradient, render, at_once=at_once)


def plastimatch(volume: Volume, detector: Detector, view: str, threads: int, *, algorithm: str = "exact") -> Images:
    """plastimatch's command, one process per pose, on the CPU; ``exact`` is Siddon's method.

    By experiment, what its help calls (row, column) is (column, row).
    ``images.seconds`` gets the time that the last call's processes say they spent on projecting, so that starting
    them and reading the volume is not on the clock.
    """
    import plastimatch as installed
    import SimpleITK

    program = Path(installed.__file__).parent / "bin" / "plastimatch"
    folder = tempfile.TemporaryDirectory()
    image = SimpleITK.GetImageFromArray(volume.data.cpu().numpy())
    image.SetOrigin(volume.patient_from_voxel[:3, 3].tolist())
    image.SetSpacing(volume.spacing_mm.tolist())
    image.SetDirection((volume.patient_from_voxel[:3, :3] / volume.spacing_mm).flatten().tolist())
    SimpleITK.WriteImage(image, f"{folder.name}/volume.mha")
    settings = {
        "--threading": "cpu",
        "--algorithm": algorithm,
        "--hu-conversion": "none",
        "--intensity-scale": "10",  # it integrates over centimetres
        "--dim": f"{detector.columns} {detector.rows}",
        "--detector-size": f"{detector.columns * detector.pixel_mm} {detector.rows * detector.pixel_mm}",
        "--output-format": "raw",
        "--output": f"{folder.name}/image_",
    }
    environment = os.environ | {"OMP_NUM_THREADS": str(threads)}

    def images(poses: Tensor) -> Tensor:
        found, images.seconds = [], 0.0
        for seen in zip(*to_plastimatch(poses, detector, view, volume.origin_patient_mm), strict=True):
            normal, up, isocenter, distance, image_center = map(_words, seen)
            own = {
                "--nrm": normal,
                "--vup": up,
                "--isocenter": isocenter,
                "--sad": distance,
                "--sid": distance,
                "--image-center": image_center,
            }
            options = [word for pair in (settings | own).items() for word in pair]
            command = [program, "drr", *options, f"{folder.name}/volume.mha"]
            said = subprocess.run(command, check=True, capture_output=True, text=True, env=environment).stdout
            times = {what: float(t) for what, t in re.findall(r"(I/O|Total) time: ([\d.e+-]+) sec", said)}
            images.seconds += times["Total"] - times["I/O"]
            found.append(np.fromfile(f"{folder.name}/image_0000.raw", np.float32))
        return torch.from_numpy(np.stack(found)).unflatten(1, (detector.rows, detector.columns))

    images.folder = folder  # removed with the function
    return images


def _nanodrr(volume: Volume, detector: Detector, view: str, samples: int | None, backend: str) -> Images:
    """Its camera sits in the source: x along columns, y along rows, z to the detector; its world is LPS mm here."""
    from nanodrr.data import Subject
    from nanodrr.drr import render

    data, device = volume.data[None, None], volume.data.device
    place = volume.patient_from_voxel.to(device)
    own = [m.float() for m in (place, torch.linalg.inv(place), Subject._make_voxel_to_grid(data.shape).to(device))]
    subject = Subject(data, torch.zeros_like(data), *own, torch.zeros(3, device=device), 0, convert_to_mu=False)
    samples = samples or max(volume.data.shape)

    def images(poses: Tensor) -> Tensor:
        camera = to_camera(poses, detector, view, volume.origin_patient_mm)
        inverse = torch.linalg.inv(camera.pixel_from_camera)
        rest = [part.float() for part in (inverse, camera.patient_from_camera, poses[:, 2])]
        return render(subject, *rest, detector.rows, detector.columns, samples, backend=backend)[:, 0]

    return images


def _diffdrr(volume: Volume, detector: Detector, view: str, renderer: str, samples: int | None) -> Images:
    from diffdrr.renderers import Siddon, Trilinear

    integral = Siddon() if renderer == "siddon" else partial(Trilinear(), n_points=samples or 500)
    data = volume.data.permute(2, 1, 0)
    columns = torch.arange(detector.columns, dtype=torch.float64, device=data.device)
    rows = torch.arange(detector.rows, dtype=torch.float64, device=data.device)[:, None]

    def images(poses: Tensor) -> Tensor:
        rays = cone_beam_rays(poses, detector, view, volume.voxel_from_ct)
        source, first, column_step, row_step = (part[:, None, None] for part in rays.unflatten(-1, (4, 3)).unbind(1))
        target = (first + columns[..., None] * column_step + rows[..., None] * row_step).flatten(1, 2)
        source = source[:, 0]
        length = ((target - source) * volume.spacing_mm.to(target)).norm(dim=-1)[:, None]
        found = integral(data, source.float(), target.float(), length.float())
        return found.reshape(len(poses), detector.rows, detector.columns)

    return images


def _without_gradient(render: Images, poses: Tensor, *, at_once: int) -> Tensor:
    with torch.no_grad():
        return torch.cat([render(some) for some in poses.split(at_once)])


def _gradient(render: Images, poses: Tensor, weight: Tensor, *, at_once: int) -> Tensor:
    found = []
    for some in poses.split(at_once):
        some = some.detach().requires_grad_()
        found.append(torch.autograd.grad((render(some) * weight).sum(), some)[0])
    return torch.cat(found)


def _words(numbers: Tensor) -> str:
    return " ".join(f"{value:.9g}" for value in numbers.flatten().tolist())
