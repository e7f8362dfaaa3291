"""Derives the limits of the verdict from studies' rows: which values are as good, and what each rule is worth.

    python -m experiments.calibration results/search results/decoys [--out results/calibration]

Cases are right below a PDE of 2 mm, wrong above 5 mm; decoys are always wrong. The limits stand in
``regtorch/registration/trust/limits.py``. A test holds them within the intervals of ``results/calibration/limits.csv``.
"""

from pathlib import Path

from experiments.calibration.figure import write
from experiments.common.command import command_parser, tell_written, told_in_one_line


def main() -> None:
    parser = command_parser("calibration", __doc__)
    parser.add_argument("folders", nargs="+", type=Path, metavar="FOLDER", help="folders of studies")
    parser.add_argument("--out", type=Path, default=Path("results/calibration"), metavar="DIR")
    options = parser.parse_args()
    with told_in_one_line("calibration"):
        tell_written(write(options.folders, options.out))


if __name__ == "__main__":
    main()
