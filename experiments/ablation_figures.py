"""Table and figure of a sweep, from its rows alone: accuracy and cost of each arm, and tests against a reference.

    python -m experiments.ablation_figures FOLDER [--reference ARM]

The folder of any study with two arms or more will do. Arms are compared over the cases that both have.
"""

from experiments.common.ablation import write
from experiments.common.command import folder_parser, tell_written, told_in_one_line


def main() -> None:
    parser = folder_parser("ablation_figures", __doc__)
    parser.add_argument("--reference", metavar="ARM", help="compare the others with ARM (default: the first)")
    options = parser.parse_args()
    with told_in_one_line("ablation_figures"):
        tell_written(write(options.folder, options.reference))


if __name__ == "__main__":
    main()
