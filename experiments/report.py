"""One HTML file of a study's folder: tables, figures, the worst cases and their pictures.

    python -m experiments.report FOLDER [--out FILE]

Any study's folder will do. The file needs no other file.
"""

from pathlib import Path

from experiments.common.command import folder_parser, tell_written, told_in_one_line
from experiments.common.report import report
from regtorch.files import write_text


def main() -> None:
    parser = folder_parser("report", __doc__)
    parser.add_argument("--out", type=Path, metavar="FILE", help="file to write (default: FOLDER/report.html)")
    options = parser.parse_args()
    out = options.out or options.folder / "report.html"
    with told_in_one_line("report"):
        write_text(out, report(options.folder))
        tell_written([out])


if __name__ == "__main__":
    main()
