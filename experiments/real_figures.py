"""Table and figures of the study of real pairs: python -m experiments.real_figures [FOLDER] [--pairs FILE]

Writes table.md and spread.png to FOLDER, from its rows alone. With --pairs the data is read as well: FOLDER/pictures
gets an overlay and a gradient-correlation image of each pair's modal answer.
"""

from pathlib import Path

from experiments.common.command import folder_parser, tell_written, told_in_one_line
from experiments.real.figures import write


def main() -> None:
    parser = folder_parser("real_figures", __doc__, "results/real")
    parser.add_argument("--pairs", type=Path, metavar="FILE", help="YAML of the pairs, for pictures")
    options = parser.parse_args()
    with told_in_one_line("real_figures"):
        tell_written(write(options.folder))
        if options.pairs is not None:
            from experiments.real.pictures import draw

            tell_written(draw(options.folder, options.pairs))


if __name__ == "__main__":
    main()
