"""Command line: demo, simulate, register, evaluate. Exit codes: 0 ok, 2 bad input, 3 doubtful or failed,
130 interrupted, 141 not read to the end."""

import argparse
import math
import os
import signal
import sys
import threading
from collections.abc import Sequence
from pathlib import Path

from regtorch.arguments import BAD_INPUT, parser
from regtorch.errors import RegtorchError
from regtorch.files import one_line
from regtorch.output import print_evaluation, print_result, progress_bar, to_json, write_json

_OK, _NOT_SURE, _INTERRUPTED, _BROKEN_PIPE = 0, 3, 130, 141
_DEMO_PHOTONS = 2e5
_RESULTS = ("result.json", "overlay.png")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; its exit code."""
    options = parser().parse_args(arguments)
    run = {"demo": _demo, "simulate": _simulate, "register": _register, "evaluate": _evaluate}
    code = _BROKEN_PIPE
    before = (
        signal.signal(signal.SIGTERM, _interrupt) if threading.current_thread() is threading.main_thread() else None
    )
    try:
        code = run[options.command](options)
        sys.stdout.flush()
    except BrokenPipeError:  # whatever reads this has read enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (RegtorchError, OSError) as error:
        print(f"regtorch: error: {' '.join(str(error).split())}", file=sys.stderr)
        return BAD_INPUT
    except (MemoryError, RuntimeError) as error:
        if not (isinstance(error, MemoryError) or "allocate" in str(error)):  # as torch says it
            raise
        print(f"regtorch: error: out of memory: expected smaller input ({one_line(error)})", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print("regtorch: interrupted, nothing written", file=sys.stderr)
        return _INTERRUPTED
    finally:
        if before is not None:
            signal.signal(signal.SIGTERM, before)
    return code


def _interrupt(*_: object) -> None:
    """SIGTERM, which batch systems and ``timeout`` send, ends the program as Ctrl-C does."""
    raise KeyboardInterrupt


def _use_threads(threads: int | None) -> None:
    import numba
    import torch

    if threads is None:
        return
    if not 1 <= threads <= numba.config.NUMBA_NUM_THREADS:
        raise RegtorchError(f"--threads {threads}: expected 1 to {numba.config.NUMBA_NUM_THREADS}")
    torch.set_num_threads(threads)
    numba.set_num_threads(threads)


def _demo(options: argparse.Namespace) -> int:
    import torch

    from regtorch.evaluation import evaluate
    from regtorch.files import output_folder
    from regtorch.formats import read_radiograph, write_radiograph, write_volume
    from regtorch.phantom import make_phantom
    from regtorch.registration import initial_parameters
    from regtorch.simulation.simulator import DETECTOR, RANGES, draw_geometry, simulate

    _use_threads(options.threads)
    names = ("phantom.nii.gz", "radiograph.tiff", "truth.json", *_RESULTS)
    with output_folder(options.out, names) as folder:
        print("making the phantom and its radiograph ...")
        ct, targets = make_phantom()
        middle = initial_parameters(ct, DETECTOR, options.view)
        generator = torch.Generator().manual_seed(options.seed)
        parameters = draw_geometry(ct, middle, torch.tensor(RANGES), options.view, generator)
        simulation = simulate(ct, parameters, options.view, targets=targets, photons=_DEMO_PHOTONS, seed=options.seed)
        write_volume(folder / "phantom.nii.gz", ct)
        write_radiograph(folder / "radiograph.tiff", simulation.image, DETECTOR, view=options.view)
        write_json(folder / "truth.json", simulation.to_dict())
        radiograph = read_radiograph(folder / "radiograph.tiff", view=options.view)
        result = _registered(options, folder, ct, radiograph, simulation.targets)
    print_result(result)
    print_evaluation(evaluate(result.to_dict(), simulation.to_dict()))
    print(f"see {Path(options.out) / 'overlay.png'}")
    return _OK if result.status == "ok" else _NOT_SURE


def _simulate(options: argparse.Namespace) -> int:
    import torch

    from regtorch.files import output_folder
    from regtorch.formats import read_points, read_volume, write_radiograph
    from regtorch.geometry import Detector
    from regtorch.registration import initial_parameters
    from regtorch.simulation import draw_geometry, simulate

    _use_threads(options.threads)
    detector = Detector(options.rows, options.columns, options.pixel_mm)
    name = f"radiograph.{options.format}"
    with output_folder(options.out, (name, "truth.json")) as folder, progress_bar("reading the CT") as progress:
        ct = read_volume(options.ct)
        targets = read_points(options.targets) if options.targets else None
        middle = initial_parameters(ct, detector, options.view, sdd_mm=options.sdd_mm)
        generator = torch.Generator().manual_seed(options.seed)
        parameters = draw_geometry(ct, middle, _half_range(options), options.view, generator)
        progress(0.15, "rendering the radiograph")
        simulation = simulate(
            ct, parameters, options.view, detector=detector, threshold_hu=options.threshold_hu,
            photons=options.photons, targets=targets, seed=options.seed,
        )  # fmt: skip
        progress(0.95, "writing it")
        write_radiograph(folder / name, simulation.image, detector, view=options.view)
        write_json(folder / "truth.json", simulation.to_dict())
    print(f"wrote {name} and truth.json with {len(simulation.targets)} targets to {options.out}")
    return _OK


def _half_range(options: argparse.Namespace):
    """Nine numbers, mm and rad."""
    import torch

    rotation = map(math.radians, options.rotation_range_deg)
    return torch.tensor([*options.source_range_mm, *options.patient_range_mm, *rotation], dtype=torch.float64)


def _register(options: argparse.Namespace) -> int:
    from regtorch.files import output_folder
    from regtorch.formats import read_points, read_radiograph, read_volume

    _use_threads(options.threads)
    if (options.landmark_ct is None) != (options.landmark_radiograph is None):
        raise RegtorchError("only one of --landmark-ct and --landmark-radiograph: expected both or neither")
    with output_folder(options.out, _RESULTS) as folder:
        radiograph = read_radiograph(
            options.radiograph,
            view=options.view,
            pixel_mm=options.pixel_mm,
            intensity=options.intensity,
            mirrored={"auto": None, "yes": True, "no": False}[options.mirrored],
            mask=options.mask,
        )
        targets = read_points(options.targets) if options.targets else {}
        if options.landmark_ct is not None:
            targets = {**targets, "landmark": tuple(options.landmark_ct)}
        ct = read_volume(options.ct)
        result = _registered(
            options, folder, ct, radiograph, targets,
            free=options.dof, half_range=_half_range(options), sdd_mm=options.sdd_mm,
            threshold_hu=options.threshold_hu, method=options.method, device=options.device,
            parameters=options.parameters,
            landmark_patient_mm=options.landmark_ct and tuple(options.landmark_ct),
            landmark_stored=options.landmark_radiograph and tuple(options.landmark_radiograph),
        )  # fmt: skip
    print_result(result)
    print(f"wrote result.json and overlay.png to {options.out}")
    return _OK if result.status == "ok" else _NOT_SURE


def _registered(
    options: argparse.Namespace,
    folder: Path,
    ct,
    radiograph,
    targets,
    method="hybrid",
    parameters="patient",
    device="cpu",
    **settings,
):
    """Register with a progress bar, write result.json and overlay.png."""
    from functools import partial

    from regtorch import optimization
    from regtorch.imaging import BONE_HU, attenuation, crop_to_anatomy
    from regtorch.plotting import write_overlay
    from regtorch.registration import COORDINATES, cmaes, hybrid, register

    methods = {"hybrid": hybrid, "cmaes": cmaes, "pycma": partial(cmaes, optimizer=optimization.pycma)}
    with progress_bar() as progress:
        result = register(
            ct.to(device),
            radiograph,
            options.view,
            method=methods[method],
            coordinates=COORDINATES[parameters],
            seed=options.seed,
            progress=progress,
            **settings,
        )
    write_json(folder / "result.json", result.to_dict() | _expected_errors(result, targets))
    threshold_hu = settings.get("threshold_hu", BONE_HU)
    bone = attenuation(crop_to_anatomy(ct, threshold_hu=threshold_hu), threshold_hu=threshold_hu)
    write_overlay(folder / "overlay.png", bone, radiograph, result, targets)
    return result


def _expected_errors(result, targets) -> dict[str, dict[str, float]]:
    """Of where each target is projected to, mm in the detector plane; not finite where that cannot be told."""
    import torch

    if result.covariance is None or not targets:
        return {}
    errors = result.expected_errors_mm(torch.tensor(list(targets.values()), dtype=torch.float64)).tolist()
    return {"expected_target_errors_mm": dict(zip(targets, errors, strict=True))}


def _evaluate(options: argparse.Namespace) -> int:
    from regtorch.evaluation import evaluate, read_json

    result, truth = read_json(options.result, "result"), read_json(options.truth, "truth")
    try:
        found = evaluate(result, truth)
    except RegtorchError as error:
        raise RegtorchError(f"{options.result} and {options.truth}: {error}") from None
    if options.json == "-":
        print(to_json(found))
        return _OK
    if options.json:
        write_json(Path(options.json), found)
    print_evaluation(found)
    return _OK


if __name__ == "__main__":
    sys.exit(main())
