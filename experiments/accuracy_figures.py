"""Table and figures of the accuracy study: python -m experiments.accuracy_figures [FOLDER]

Writes table.md, accuracy.png and coupling.png to FOLDER, from its rows alone.
"""

from experiments.accuracy.figures import write
from experiments.common.command import folder_parser, tell_written, told_in_one_line


def main() -> None:
    options = folder_parser("accuracy_figures", __doc__, "results/accuracy").parse_args()
    with told_in_one_line("accuracy_figures"):
        tell_written(write(options.folder))


if __name__ == "__main__":
    main()
