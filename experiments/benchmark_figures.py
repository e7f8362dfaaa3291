"""Tables and figure of the benchmark: python -m experiments.benchmark_figures [FOLDER]

Writes table.md and cost.png to FOLDER, from its rows alone.
"""

from experiments.benchmark.figures import write
from experiments.common.command import folder_parser, tell_written, told_in_one_line


def main() -> None:
    options = folder_parser("benchmark_figures", __doc__, "results/benchmark").parse_args()
    with told_in_one_line("benchmark_figures"):
        tell_written(write(options.folder))


if __name__ == "__main__":
    main()
