"""Pictures of the worst registrations of each arm of a simulation study, made again from its rows and settings.

    python -m experiments.worst_pictures [FOLDER] [--count N]

ARM/failures/VIEW_SEED.png shows the radiograph with the edges of the bones, in blue where they are, in orange where
they were found. ``python -m experiments.report`` includes these pictures.
"""

from experiments.common.command import folder_parser, tell_written, told_in_one_line
from experiments.simulation.worst import write_pictures


def main() -> None:
    parser = folder_parser("worst_pictures", __doc__, "results/simulation")
    parser.add_argument("--count", type=int, default=10, metavar="N", help="pictures of each arm (default: 10)")
    options = parser.parse_args()
    with told_in_one_line("worst_pictures"):
        tell_written(write_pictures(options.folder, options.count))


if __name__ == "__main__":
    main()
