"""Command line: demo, simulate, register, evaluate. Exit codes: 0 ok, 2 bad input, 3 doubtful or failed."""

import argparse
import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from regtorch import __version__
from regtorch.errors import RegtorchError

_VIEWS = ("PA", "AP", "LAT", "LLAT", "RLAT")
_OK, _BAD_INPUT, _NOT_SURE, _INTERRUPTED = 0, 2, 3, 130
_DEMO_PHOTONS = 2e5


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; its exit code."""
    options = _parser().parse_args(arguments)
    try:
        return options.run(options)
    except RegtorchError as error:
        print(f"regtorch: error: {error}", file=sys.stderr)
        return _BAD_INPUT
    except KeyboardInterrupt:
        print("regtorch: interrupted, nothing written", file=sys.stderr)
        return _INTERRUPTED


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line; argparse would print the usage as well."""

    def error(self, message: str) -> NoReturn:
        print(f"{self.prog}: error: {message} (see {self.prog} --help)", file=sys.stderr)
        raise SystemExit(_BAD_INPUT)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="regtorch",
        description="Registers one radiograph to one CT: where source, patient and detector stood, nine parameters.",
    )
    parser.add_argument("--version", action="version", version=f"regtorch {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    demo = commands.add_parser("demo", help="simulate a radiograph of the embedded phantom and register it")
    demo.add_argument("--out", default="regtorch-demo", metavar="DIR", help="folder to write to (%(default)s)")
    demo.add_argument("--view", default="PA", choices=_VIEWS, help="view (%(default)s)")
    _add_seed_and_threads(demo)
    demo.set_defaults(run=_demo)

    simulate = commands.add_parser("simulate", help="make a radiograph of a CT, and the truth about it")
    simulate.add_argument("ct", metavar="CT", help="DICOM folder, NIfTI, NRRD or MHA")
    simulate.add_argument("--view", required=True, metavar="VIEW", help=f"one of {', '.join(_VIEWS)}; LAT is LLAT")
    simulate.add_argument("--out", required=True, metavar="DIR", help="folder for radiograph and truth.json")
    simulate.add_argument("--format", default="tiff", choices=("tiff", "png", "dcm"), help="(%(default)s)")
    simulate.add_argument("--rows", type=int, default=500, help="of the detector (%(default)s)")
    simulate.add_argument("--columns", type=int, default=500, help="of the detector (%(default)s)")
    simulate.add_argument("--pixel-mm", type=float, default=0.7, help="pixel size (%(default)s)")
    simulate.add_argument("--sdd-mm", type=float, help="middle of the range of the SDD (1000)")
    for what, default in (("source", (25, 25, 50)), ("patient", (25, 25, 50))):
        simulate.add_argument(
            f"--{what}-range-mm", type=float, nargs=3, default=default, metavar=("X", "Y", "Z"),
            help=f"half range of the {what}'s position about that of the protocol (%(default)s)",
        )  # fmt: skip
    simulate.add_argument("--rotation-range-deg", type=float, default=5, help="half range of each angle (%(default)s)")
    simulate.add_argument("--threshold-hu", type=float, help="render only what is above (default: the whole CT)")
    simulate.add_argument("--photons", type=float, help="per pixel of the open beam: adds quantum noise")
    simulate.add_argument("--targets", metavar="FILE", help="CSV of name,x,y,z (LPS mm); default: points on the bones")
    _add_seed_and_threads(simulate)
    simulate.set_defaults(run=_simulate)

    register = commands.add_parser("register", help="find where source, patient and detector stood")
    register.add_argument("ct", metavar="CT", help="DICOM folder, NIfTI, NRRD or MHA")
    register.add_argument("radiograph", metavar="RADIOGRAPH", help="DICOM, 16-bit PNG or TIFF")
    register.add_argument("--view", required=True, metavar="VIEW", help=f"one of {', '.join(_VIEWS)}; LAT is LLAT")
    register.add_argument("--out", required=True, metavar="DIR", help="folder for result.json and overlay.png")
    register.add_argument("--dof", type=int, default=9, choices=(9, 7, 6), help="9: all; 7: SDD and patient; 6: patient")
    register.add_argument(
        "--method", default="cmaes", choices=("cmaes", "pycma"), help="cmaes: the paper's, batched; pycma: by package cma"
    )
    register.add_argument("--pixel-mm", type=float, help="pixel size, where the file does not tell it")
    register.add_argument("--sdd-mm", type=float, help="SDD to begin with (the file's, else 1000)")
    register.add_argument(
        "--landmark-ct", type=float, nargs=3, metavar=("X", "Y", "Z"), help="a point of the CT, LPS mm ..."
    )
    register.add_argument(
        "--landmark-radiograph", type=float, nargs=2, metavar=("COLUMN", "ROW"), help="... and where the file shows it"
    )
    register.add_argument(
        "--intensity", default="auto", choices=("auto", "line", "counts"), help="line integrals or counts (%(default)s)"
    )
    register.add_argument("--mirrored", choices=("auto", "yes", "no"), default="auto", help="as stored (%(default)s)")
    register.add_argument("--mask", metavar="FILE", help="image of the radiograph's size: 0 where it is to be ignored")
    register.add_argument("--threshold-hu", type=float, default=100, help="CT values below count as air (%(default)s)")
    register.add_argument("--targets", metavar="FILE", help="CSV of name,x,y,z (LPS mm) to show in overlay.png")
    _add_seed_and_threads(register)
    register.set_defaults(run=_register)

    evaluate = commands.add_parser("evaluate", help="compare a result with the truth")
    evaluate.add_argument("result", metavar="RESULT", help="result.json")
    evaluate.add_argument("truth", metavar="TRUTH", help="truth.json")
    evaluate.add_argument("--json", metavar="FILE", nargs="?", const="-", help="write to FILE, or print, as JSON")
    evaluate.set_defaults(run=_evaluate)
    return parser


def _add_seed_and_threads(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--seed", type=int, default=0, help="of everything random (%(default)s)")
    parser.add_argument("--threads", type=int, help="processor threads (all)")


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
    from regtorch.imaging import Radiograph, write_radiograph, write_volume
    from regtorch.phantom import make_phantom
    from regtorch.registration import initial_parameters
    from regtorch.simulation.simulate import DETECTOR, RANGES, draw_parameters, simulate

    _use_threads(options.threads)
    with output_folder(options.out) as folder:
        print("making the phantom and its radiograph ...")
        ct, targets = make_phantom()
        middle = initial_parameters(ct, DETECTOR, options.view)
        generator = torch.Generator().manual_seed(options.seed)
        parameters = draw_parameters(middle, torch.tensor(RANGES), generator)
        simulation = simulate(
            ct, parameters, options.view, targets=targets, photons=_DEMO_PHOTONS, seed=options.seed
        )
        write_volume(folder / "phantom.nii.gz", ct)
        write_radiograph(folder / "radiograph.tiff", simulation.image, DETECTOR, view=options.view)
        _write_json(folder / "truth.json", simulation.to_dict())
        radiograph = Radiograph.from_image(simulation.image, DETECTOR)
        result = _registered(options, folder, ct, radiograph, simulation.targets, [])
        _print_evaluation(evaluate(result.to_dict(), simulation.to_dict()))
    print(f"see {Path(options.out) / 'overlay.png'}")
    return _OK if result.status == "ok" else _NOT_SURE


def _simulate(options: argparse.Namespace) -> int:
    import torch

    from regtorch.files import output_folder
    from regtorch.geometry import Detector
    from regtorch.imaging import read_volume, write_radiograph
    from regtorch.imaging.points import read_points
    from regtorch.registration import initial_parameters
    from regtorch.simulation import draw_parameters, simulate

    _use_threads(options.threads)
    detector = Detector(options.rows, options.columns, options.pixel_mm)
    half_range = [*options.source_range_mm, *options.patient_range_mm] + [math.radians(options.rotation_range_deg)] * 3
    if min(half_range) < 0:
        raise RegtorchError(f"a negative range in {half_range}: expected half ranges of 0 or more")
    with output_folder(options.out) as folder:
        ct = read_volume(options.ct)
        targets = read_points(options.targets) if options.targets else None
        middle = initial_parameters(ct, detector, options.view, sdd_mm=options.sdd_mm)
        generator = torch.Generator().manual_seed(options.seed)
        parameters = draw_parameters(middle, torch.tensor(half_range), generator)
        simulation = simulate(
            ct, parameters, options.view, detector=detector, threshold_hu=options.threshold_hu,
            photons=options.photons, targets=targets, seed=options.seed,
        )  # fmt: skip
        name = f"radiograph.{options.format}"
        write_radiograph(folder / name, simulation.image, detector, view=options.view)
        _write_json(folder / "truth.json", simulation.to_dict())
    print(f"wrote {name} and truth.json with {len(simulation.targets)} targets to {options.out}")
    return _OK


def _register(options: argparse.Namespace) -> int:
    from regtorch.files import output_folder
    from regtorch.geometry import world_from_patient_axes
    from regtorch.imaging import check_radiograph, check_volume, read_radiograph, read_volume
    from regtorch.imaging.points import read_points

    _use_threads(options.threads)
    world_from_patient_axes(options.view)
    if (options.landmark_ct is None) != (options.landmark_radiograph is None):
        raise RegtorchError("only one of --landmark-ct and --landmark-radiograph: expected both or neither")
    with output_folder(options.out) as folder:
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
        warnings = [f"{options.ct}: {line}" for line in check_volume(ct)]
        warnings += [f"{options.radiograph}: {line}" for line in check_radiograph(radiograph)]
        result = _registered(
            options, folder, ct, radiograph, targets, warnings,
            free=options.dof, sdd_mm=options.sdd_mm, threshold_hu=options.threshold_hu, pycma=options.method == "pycma",
            landmark_patient_mm=options.landmark_ct and tuple(options.landmark_ct),
            landmark_stored=options.landmark_radiograph and tuple(options.landmark_radiograph),
        )  # fmt: skip
    print(f"wrote result.json and overlay.png to {options.out}")
    return _OK if result.status == "ok" else _NOT_SURE


def _registered(
    options: argparse.Namespace, folder: Path, ct, radiograph, targets, warnings: list[str], pycma=False, **settings
):
    """Register with a progress bar, write result.json and overlay.png, print the verdict."""
    from functools import partial

    from tqdm import tqdm

    from regtorch import optimization
    from regtorch.drr import render
    from regtorch.imaging import attenuation
    from regtorch.plotting import write_overlay
    from regtorch.registration import register
    from regtorch.registration.evolution import evolution

    def progress(share: float, what: str) -> None:
        for line in warnings:  # only now is all input known to be good
            print(f"regtorch: warning: {line}", file=sys.stderr)
        warnings.clear()
        bar.set_description(what, refresh=False)
        bar.update(round(100 * share, 1) - bar.n)

    method = partial(evolution, optimizer=optimization.pycma) if pycma else evolution
    with tqdm(total=100, disable=None, leave=False, bar_format="{desc} {bar} {elapsed} < {remaining}") as bar:
        result = register(
            ct, radiograph, options.view, method=method, seed=options.seed, progress=progress, **settings
        )
    _write_json(folder / "result.json", result.to_dict())
    bone = attenuation(ct, threshold_hu=settings.get("threshold_hu", 100.0))
    moving = render(bone, result.parameters, radiograph.detector, options.view)
    write_overlay(folder / "overlay.png", radiograph, result, moving, targets)
    print(f"{result.status}: {result.message}")
    print(f"similarity {result.similarity:.4f}, {result.evaluations} evaluations, {result.seconds:.0f} s")
    for key, value in result.to_dict()["parameters"].items():
        print(f"  {key:10} {value:10.3f}")
    return result


def _evaluate(options: argparse.Namespace) -> int:
    from regtorch.evaluation import evaluate, read_json

    found = evaluate(read_json(options.result, "result"), read_json(options.truth, "truth"))
    if options.json == "-":
        print(json.dumps(found, indent=2))
        return _OK
    if options.json:
        _write_json(Path(options.json), found)
    _print_evaluation(found)
    return _OK


def _print_evaluation(found: dict[str, Any]) -> None:
    print(f"pde_mm           {found['pde_mm']:.4f}   (mean over {len(found['targets'])} targets, in the detector plane)")
    print(f"target_error_mm  {found['target_error_mm']:.4f}   (in space, seen from the detector)")
    print("parameter_errors")
    for key, value in found["parameter_errors"].items():
        print(f"  {key:10} {value:+10.4f}")


def _write_json(path: Path, content: dict[str, Any]) -> None:
    try:
        path.write_text(json.dumps(content, indent=2) + "\n")
    except OSError as error:
        raise RegtorchError(f"{path}: {error.strerror}, expected a file to write to") from None


if __name__ == "__main__":
    sys.exit(main())
