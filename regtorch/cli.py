"""Command line: demo, simulate, register, evaluate. Exit codes: 0 ok, 2 bad input, 3 doubtful or failed."""

import argparse
import json
import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

from regtorch import __version__
from regtorch.errors import RegtorchError

_VIEWS = ("PA", "AP", "LAT", "LLAT", "RLAT")
_VIEW_HELP = f"{', '.join(_VIEWS)} (LAT is LLAT: left side on the detector)"
_CT_HELP = "folder of one DICOM series, NIfTI, NRRD or MHA"
_TARGETS_HELP = "CSV of name,x,y,z (LPS mm)"
_OK, _BAD_INPUT, _NOT_SURE, _INTERRUPTED = 0, 2, 3, 130
_DEMO_PHOTONS = 2e5
_RESULTS = ("result.json", "overlay.png")
_LEAST_PIXELS, _MOST_PIXELS = 8, 10_000
"""A side of a radiograph: less shows nothing to register, more does not fit into memory."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; its exit code."""
    options = _parser().parse_args(arguments)
    try:
        return options.run(options)
    except (RegtorchError, OSError) as error:
        print(f"regtorch: error: {' '.join(str(error).split())}", file=sys.stderr)
        return _BAD_INPUT
    except KeyboardInterrupt:
        print("regtorch: interrupted, nothing written", file=sys.stderr)
        return _INTERRUPTED


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line; argparse would print the usage as well."""

    def error(self, message: str) -> NoReturn:
        message = " ".join(message.split())
        print(f"{self.prog}: error: {message} (see {self.prog} --help)", file=sys.stderr)
        raise SystemExit(_BAD_INPUT)


def _number(low: float, high: float, kind: Callable[[str], float] = float) -> Callable[[str], float]:
    """What reads an option's value; argparse puts the option's name before what this has to say."""

    def read(text: str) -> float:
        try:
            value = kind(text)
        except ValueError:
            value = math.nan
        if low <= value <= high:
            return value
        what = "a whole number" if kind is int else "a number"
        raise argparse.ArgumentTypeError(f"{text!r}, expected {what} from {low:.12g} to {high:.12g}")

    return read


_COORDINATE = _number(-1e5, 1e5)
_HALF_RANGE_MM = _number(0, 1e4)
_PIXEL_MM = _number(1e-3, 100)
_SDD_MM = _number(1, 1e5)
_SIDE = _number(_LEAST_PIXELS, _MOST_PIXELS, int)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="regtorch",
        description="Registers one radiograph to one CT: where source, patient and detector stood, nine parameters.",
        epilog="Exit codes: 0 done; 2 bad input or usage, nothing written; 3 done, but doubtful or failed.",
    )
    parser.add_argument("--version", action="version", version=f"regtorch {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    add = _command(commands, _demo, "demo", "simulate a radiograph of the embedded phantom and register it")
    add("--out", default="regtorch-demo", metavar="DIR", help="folder to write to (%(default)s)")
    add("--view", default="PA", choices=_VIEWS, metavar="VIEW", help=f"{_VIEW_HELP} (%(default)s)")
    _add_seed_and_threads(add)

    add = _command(commands, _simulate, "simulate", "make a radiograph of a CT, and the truth about it")
    add("ct", metavar="CT", help=_CT_HELP)
    add("--view", required=True, choices=_VIEWS, metavar="VIEW", help=_VIEW_HELP)
    add("--out", required=True, metavar="DIR", help="folder for radiograph.(tiff|png|dcm) and truth.json")
    add("--format", default="tiff", choices=("tiff", "png", "dcm"), help="of the radiograph (%(default)s)")
    add("--rows", type=_SIDE, default=500, metavar="N", help="of the detector (%(default)s)")
    add("--columns", type=_SIDE, default=500, metavar="N", help="of the detector (%(default)s)")
    add("--pixel-mm", type=_PIXEL_MM, default=0.7, metavar="MM", help="of the detector (%(default)s)")
    add("--sdd-mm", type=_SDD_MM, metavar="MM", help="source-detector distance, middle of its range (1000)")
    for what in ("source", "patient"):
        name, text = f"--{what}-range-mm", f"half range of the {what}'s position about the protocol's (25 25 50)"
        add(name, type=_HALF_RANGE_MM, nargs=3, default=(25, 25, 50), metavar=("X", "Y", "Z"), help=text)
    add("--rotation-range-deg", type=_number(0, 180), default=5, metavar="DEG", help="half range of each angle (5)")
    add("--threshold-hu", type=_COORDINATE, metavar="HU", help="render only what is above (default: the whole CT)")
    add("--photons", type=_number(1, 1e12), metavar="N", help="per pixel of the open beam: adds quantum noise")
    add("--targets", metavar="FILE", help=f"{_TARGETS_HELP} for truth.json (default: points on the bones)")
    _add_seed_and_threads(add)

    add = _command(commands, _register, "register", "find where source, patient and detector stood")
    add("ct", metavar="CT", help=_CT_HELP)
    add("radiograph", metavar="RADIOGRAPH", help="DICOM, 16-bit PNG or TIFF")
    add("--view", required=True, choices=_VIEWS, metavar="VIEW", help=_VIEW_HELP)
    add("--out", required=True, metavar="DIR", help="folder for result.json and overlay.png")
    add("--dof", type=int, default=9, choices=(9, 7, 6), help="what is sought: 9 all, 7 SDD and patient, 6 patient (9)")
    add("--method", default="cmaes", choices=("cmaes", "pycma"), help="the paper's, or the same by package cma (cmaes)")
    add("--pixel-mm", type=_PIXEL_MM, metavar="MM", help="pixel size; overrules the file's")
    add("--sdd-mm", type=_SDD_MM, metavar="MM", help="source-detector distance to begin with (the file's, else 1000)")
    add("--landmark-ct", type=_COORDINATE, nargs=3, metavar=("X", "Y", "Z"), help="a point of the CT, LPS mm ...")
    where = ("COLUMN", "ROW")
    add("--landmark-radiograph", type=_COORDINATE, nargs=2, metavar=where, help="... and the pixel of the file there")
    add("--intensity", default="auto", choices=("auto", "line", "counts"), help="line integrals or counts (auto)")
    add("--mirrored", default="auto", choices=("auto", "yes", "no"), help="shown as from the detector's side (auto)")
    add("--mask", metavar="FILE", help="PNG or TIFF of the radiograph's size: 0 where it is to be ignored")
    add("--threshold-hu", type=_COORDINATE, default=100, metavar="HU", help="below, the CT counts as air (%(default)s)")
    add("--targets", metavar="FILE", help=f"{_TARGETS_HELP} to show in overlay.png")
    _add_seed_and_threads(add)

    add = _command(commands, _evaluate, "evaluate", "compare a result with the truth")
    add("result", metavar="RESULT", help="result.json")
    add("truth", metavar="TRUTH", help="truth.json")
    add("--json", metavar="FILE", nargs="?", const="-", help="also write it to FILE; without FILE print it as JSON")
    return parser


def _command(commands: Any, run: Callable[[argparse.Namespace], int], name: str, text: str) -> Callable[..., Any]:
    parser = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
    parser.set_defaults(run=run)
    return parser.add_argument


def _add_seed_and_threads(add: Callable[..., Any]) -> None:
    add("--seed", type=_number(0, 2**32 - 1, int), default=0, metavar="N", help="of everything random (%(default)s)")
    add("--threads", type=int, metavar="N", help="processor threads (all)")


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
    names = ("phantom.nii.gz", "radiograph.tiff", "truth.json", *_RESULTS)
    with output_folder(options.out, names) as folder:
        print("making the phantom and its radiograph ...")
        ct, targets = make_phantom()
        middle = initial_parameters(ct, DETECTOR, options.view)
        generator = torch.Generator().manual_seed(options.seed)
        parameters = draw_parameters(middle, torch.tensor(RANGES), generator)
        simulation = simulate(ct, parameters, options.view, targets=targets, photons=_DEMO_PHOTONS, seed=options.seed)
        write_volume(folder / "phantom.nii.gz", ct)
        write_radiograph(folder / "radiograph.tiff", simulation.image, DETECTOR, view=options.view)
        _write_json(folder / "truth.json", simulation.to_dict())
        radiograph = Radiograph.from_image(simulation.image, DETECTOR)
        result = _registered(options, folder, ct, radiograph, simulation.targets, [])
    _print_result(result)
    _print_evaluation(evaluate(result.to_dict(), simulation.to_dict()))
    print(f"see {Path(options.out) / 'overlay.png'}")
    return _OK if result.status == "ok" else _NOT_SURE


def _simulate(options: argparse.Namespace) -> int:
    import torch

    from regtorch.files import output_folder
    from regtorch.geometry import Detector
    from regtorch.imaging import read_volume, write_radiograph
    from regtorch.imaging.points import read_points
    from regtorch.registration.initial import check_in_front, initial_parameters
    from regtorch.simulation import draw_parameters, simulate

    _use_threads(options.threads)
    detector = Detector(options.rows, options.columns, options.pixel_mm)
    half_range = [*options.source_range_mm, *options.patient_range_mm] + [math.radians(options.rotation_range_deg)] * 3
    name = f"radiograph.{options.format}"
    with output_folder(options.out, (name, "truth.json")) as folder:
        ct = read_volume(options.ct)
        targets = read_points(options.targets) if options.targets else None
        middle = initial_parameters(ct, detector, options.view, sdd_mm=options.sdd_mm)
        generator = torch.Generator().manual_seed(options.seed)
        parameters = draw_parameters(middle, torch.tensor(half_range), generator)
        check_in_front(ct, parameters, options.view)
        simulation = simulate(
            ct, parameters, options.view, detector=detector, threshold_hu=options.threshold_hu,
            photons=options.photons, targets=targets, seed=options.seed,
        )  # fmt: skip
        write_radiograph(folder / name, simulation.image, detector, view=options.view)
        _write_json(folder / "truth.json", simulation.to_dict())
    print(f"wrote {name} and truth.json with {len(simulation.targets)} targets to {options.out}")
    return _OK


def _register(options: argparse.Namespace) -> int:
    from regtorch.files import output_folder
    from regtorch.imaging import check_radiograph, check_volume, read_radiograph, read_volume
    from regtorch.imaging.points import read_points

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
        rows, columns = radiograph.image.shape
        if min(rows, columns) < _LEAST_PIXELS:
            raise RegtorchError(
                f"{options.radiograph}: {rows} x {columns} pixels, expected at least {_LEAST_PIXELS} each way"
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
    _print_result(result)
    print(f"wrote result.json and overlay.png to {options.out}")
    return _OK if result.status == "ok" else _NOT_SURE


def _registered(
    options: argparse.Namespace, folder: Path, ct, radiograph, targets, warnings: list[str], pycma=False, **settings
):
    """Register with a progress bar, write result.json and overlay.png."""
    from functools import partial

    from tqdm import tqdm

    from regtorch import optimization
    from regtorch.drr import render
    from regtorch.imaging import attenuation
    from regtorch.plotting import write_overlay
    from regtorch.registration import register
    from regtorch.registration.evolution import evolution

    def progress(share: float, what: str) -> None:
        while warnings:  # only now is all input known to be good
            tqdm.write(f"regtorch: warning: {warnings.pop(0)}", file=sys.stderr)
        bar.set_description(what, refresh=False)
        bar.update(round(100 * share, 1) - bar.n)

    method = partial(evolution, optimizer=optimization.pycma) if pycma else evolution
    with tqdm(total=100, disable=None, leave=False, bar_format="{desc} {bar} {elapsed} < {remaining}") as bar:
        result = register(ct, radiograph, options.view, method=method, seed=options.seed, progress=progress, **settings)
    _write_json(folder / "result.json", result.to_dict())
    bone = attenuation(ct, threshold_hu=settings.get("threshold_hu", 100.0))
    moving = render(bone, result.parameters, radiograph.detector, options.view)
    write_overlay(folder / "overlay.png", radiograph, result, moving, targets)
    return result


def _print_result(result) -> None:
    print(f"{result.status}: {result.message}")
    print(f"similarity {result.similarity:.4f}, {result.evaluations} evaluations, {result.seconds:.0f} s")
    for key, value in result.to_dict()["parameters"].items():
        print(f"  {key:10} {value:10.3f}")


def _evaluate(options: argparse.Namespace) -> int:
    from regtorch.evaluation import evaluate, read_json

    result, truth = read_json(options.result, "result"), read_json(options.truth, "truth")
    try:
        found = evaluate(result, truth)
    except RegtorchError as error:
        raise RegtorchError(f"{options.result} and {options.truth}: {error}") from None
    if options.json == "-":
        print(json.dumps(found, indent=2))
        return _OK
    if options.json:
        _write_json(Path(options.json), found)
    _print_evaluation(found)
    return _OK


def _print_evaluation(found: dict[str, Any]) -> None:
    print(
        f"pde_mm           {found['pde_mm']:.4f}   (mean over {len(found['targets'])} targets, in the detector plane)"
    )
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
