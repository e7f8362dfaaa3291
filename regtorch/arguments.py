"""The options of the command line. Bad usage ends in one line and exit code 2; nothing heavy is imported."""

import argparse
import math
import re
import sys
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

from regtorch import __version__
from regtorch.limits import LEAST_PIXELS, MOST_PIXELS

BAD_INPUT = 2

_VIEWS = ("PA", "AP", "LAT", "LLAT", "RLAT")
_VIEW_HELP = f"{', '.join(_VIEWS)} (LAT is LLAT: left side on the detector)"
_CT_HELP = "folder of one DICOM series, NIfTI, NRRD or MHA"
_TARGETS_HELP = "named points (CSV of name,x,y,z in LPS mm; .mrk.json or .fcsv of 3D Slicer)"


class Parser(argparse.ArgumentParser):
    """Tells an error in one line; argparse would print the usage as well."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self._negative_number_matcher = re.compile(r"-\.?\d")  # that of Python 3.14; until then -1e1 is an option

    def error(self, message: str) -> NoReturn:
        message = " ".join(message.split())
        print(f"{self.prog}: error: {message} (see {self.prog} --help)", file=sys.stderr)
        raise SystemExit(BAD_INPUT)


def _number(low: float | int, high: float | int, kind: type[float] | type[int] = float) -> Callable[[str], float | int]:
    """A reader of an option's value; argparse puts the option's name before the message."""

    def read(text: str) -> float | int:
        try:
            value = kind(text)
        except ValueError:
            value = math.nan
        if low <= value <= high:
            return value
        what = "a whole number" if kind is int else "a number"
        raise argparse.ArgumentTypeError(f"{text!r}, expected {what} from {low:.12g} to {high:.12g}")

    return read


def _angles(text: str) -> list[float]:
    """One for all three, or each."""
    each = [_number(0, 180)(part) for part in text.split(",")]
    if len(each) not in (1, 3):
        raise argparse.ArgumentTypeError(f"{text!r}, expected one number, or three with commas between them")
    return each * (3 // len(each))


_COORDINATE = _number(-1e5, 1e5)
_HALF_RANGE_MM = _number(0, 1e4)
_PIXEL_MM = _number(1e-3, 100)
_SDD_MM = _number(1, 1e5)
_SIDE = _number(LEAST_PIXELS, MOST_PIXELS, int)


def parser() -> argparse.ArgumentParser:
    """For ``regtorch``: ``command`` is the command's name, the rest are its options."""
    top = Parser(
        prog="regtorch",
        description="Registers one radiograph to one CT: where source, patient and detector stood, nine parameters.",
        epilog="Exit codes: 0 done; 2 bad input or usage, nothing written; 3 done, but doubtful or failed; "
        "130 interrupted, nothing written; 141 what reads the output has ended.",
    )
    top.add_argument("--version", action="version", version=f"regtorch {__version__}")
    commands = top.add_subparsers(required=True, metavar="COMMAND")
    for add_command in (_add_demo, _add_simulate, _add_register, _add_evaluate):
        add_command(commands)
    return top


def _add_demo(commands: Any) -> None:
    add = _command(commands, "demo", "simulate a radiograph of the embedded phantom and register it")
    add("--out", default="regtorch-demo", metavar="DIR", help="folder to write to (%(default)s)")
    add("--view", default="PA", choices=_VIEWS, metavar="VIEW", help=f"{_VIEW_HELP} (%(default)s)")
    _add_seed_and_threads(add)


def _add_simulate(commands: Any) -> None:
    add = _command(commands, "simulate", "make a radiograph of a CT, and the truth about it")
    add("ct", metavar="CT", help=_CT_HELP)
    add("--view", required=True, choices=_VIEWS, metavar="VIEW", help=_VIEW_HELP)
    add("--out", required=True, metavar="DIR", help="folder for radiograph.(tiff|png|dcm) and truth.json")
    add("--format", default="tiff", choices=("tiff", "png", "dcm"), help="of the radiograph (%(default)s)")
    add("--rows", type=_SIDE, default=500, metavar="N", help="of the detector (%(default)s)")
    add("--columns", type=_SIDE, default=500, metavar="N", help="of the detector (%(default)s)")
    add("--pixel-mm", type=_PIXEL_MM, default=0.7, metavar="MM", help="of the detector (%(default)s)")
    add("--sdd-mm", type=_SDD_MM, metavar="MM", help="source-detector distance, middle of its range (1000)")
    _add_ranges(add, "drawn about the protocol's", (25, 25, 50), (25, 25, 50), 5)
    add("--threshold-hu", type=_COORDINATE, metavar="HU", help="render only what is above (default: the whole CT)")
    add("--photons", type=_number(1, 1e12), metavar="N", help="per pixel of the open beam: adds quantum noise")
    add("--targets", metavar="FILE", help=f"{_TARGETS_HELP} for truth.json (default: points on the bones)")
    _add_seed_and_threads(add)


def _add_register(commands: Any) -> None:
    add = _command(commands, "register", "find where source, patient and detector stood")
    add("ct", metavar="CT", help=_CT_HELP)
    add("radiograph", metavar="RADIOGRAPH", help="DICOM, or grey PNG or TIFF, best with 16 bits")
    add("--view", required=True, choices=_VIEWS, metavar="VIEW", help=_VIEW_HELP)
    add("--out", required=True, metavar="DIR", help="folder for result.json and overlay.png")
    add("--dof", type=int, default=9, choices=(9, 7, 6), help="what is sought: 9 all, 7 SDD and patient, 6 patient (9)")
    text = "hybrid; or the paper's, cmaes; or that by package cma, pycma (%(default)s)"
    add("--method", default="hybrid", choices=("hybrid", "cmaes", "pycma"), help=text)
    text = "numbers that the search varies: source and patient against the detector, or source and detector against "
    text += "the patient, which needs --dof 9 (%(default)s)"
    add("--parameters", default="patient", choices=("patient", "detector"), help=text)
    add("--pixel-mm", type=_PIXEL_MM, metavar="MM", help="pixel size; overrules the file's")
    add("--sdd-mm", type=_SDD_MM, metavar="MM", help="source-detector distance to begin with (the file's, else 1000)")
    what = "searched about the start, 0 to freeze; unless given it goes on where the search ends at its limit"
    _add_ranges(add, what, (75, 75, 150), (150, 150, 150), 12, gives_way=True)
    add("--landmark-ct", type=_COORDINATE, nargs=3, metavar=("X", "Y", "Z"), help="a point of the CT, LPS mm ...")
    where = ("COLUMN", "ROW")
    add("--landmark-radiograph", type=_COORDINATE, nargs=2, metavar=where, help="... and the pixel of the file there")
    add("--intensity", default="auto", choices=("auto", "line", "counts"), help="line integrals or counts (auto)")
    add("--mirrored", default="auto", choices=("auto", "yes", "no"), help="shown as from the detector's side (auto)")
    add("--mask", metavar="FILE", help="PNG or TIFF of the radiograph's size: 0 where it is to be ignored")
    add(
        "--threshold-hu",
        type=_COORDINATE,
        default=100.0,
        metavar="HU",
        help="from where on it is bone; hybrid looks at all tissue as well (%(default)g)",
    )
    add("--targets", metavar="FILE", help=f"{_TARGETS_HELP} to show in overlay.png and tell the error to expect at")
    add("--device", default="cpu", metavar="NAME", help="where DRRs are made: cpu, or cuda, a GPU (%(default)s)")
    _add_seed_and_threads(add)


def _add_evaluate(commands: Any) -> None:
    add = _command(commands, "evaluate", "compare a result with the truth")
    add("result", metavar="RESULT", help="result.json")
    add("truth", metavar="TRUTH", help="truth.json")
    add("--json", metavar="FILE", nargs="?", const="-", help="also write it to FILE; without FILE print it as JSON")


def _command(commands: Any, name: str, text: str) -> Callable[..., Any]:
    parser = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
    parser.set_defaults(command=name)
    return parser.add_argument


def _add_ranges(
    add: Callable[..., Any],
    what: str,
    source: Sequence[int],
    patient: Sequence[int],
    deg: int,
    *,
    gives_way: bool = False,
) -> None:
    """Ranges that give way are NaN unless given."""
    unless_given = 3 * (math.nan,)
    for name, default in (("source", source), ("patient", patient)):
        text = f"half range of the {name}'s position {what} ({' '.join(map(str, default))})"
        kind = {"type": _HALF_RANGE_MM, "nargs": 3, "metavar": ("X", "Y", "Z")}
        add(f"--{name}-range-mm", **kind, default=unless_given if gives_way else default, help=text)
    text = f"half range of each angle, or of eta, theta and phi, {what} ({deg})"
    angles = unless_given if gives_way else str(deg)
    add("--rotation-range-deg", type=_angles, default=angles, metavar="DEG[,DEG,DEG]", help=text)


def _add_seed_and_threads(add: Callable[..., Any]) -> None:
    add("--seed", type=_number(0, 2**32 - 1, int), default=0, metavar="N", help="of everything random (%(default)s)")
    add("--threads", type=int, metavar="N", help="processor threads (all)")
