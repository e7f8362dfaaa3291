"""Table and figures of the simulation study, from its rows alone.

    python -m experiments.simulation_figures [FOLDER] [--only figure4]

- figure2: where the searches begin, before background_PA.png and background_LAT.png if the study left them
- figure4: errors of the parameters, PDE before and after
- coupling: errors of the patient that follow errors of the source in 6-DOF
- pde: PDE after against before
- table: the numbers beside the paper's
"""

from experiments.common.command import folder_parser, tell_written, told_in_one_line
from experiments.simulation.figures import NAMES, write


def main() -> None:
    parser = folder_parser("simulation_figures", __doc__, "results/simulation")
    parser.add_argument("--only", choices=NAMES, help="write one of these alone")
    options = parser.parse_args()
    with told_in_one_line("simulation_figures"):
        tell_written(write(options.folder, options.only))


if __name__ == "__main__":
    main()
