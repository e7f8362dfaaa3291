"""Tables and figures of the search study: python -m experiments.search_figures [FOLDER]

Writes table.md, pde.png and calibration.png to FOLDER, from its rows alone.
"""

from experiments.common.command import folder_parser, tell_written, told_in_one_line
from experiments.search.figures import write


def main() -> None:
    options = folder_parser("search_figures", __doc__, "results/search").parse_args()
    with told_in_one_line("search_figures"):
        tell_written(write(options.folder))


if __name__ == "__main__":
    main()
