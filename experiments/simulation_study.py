"""The paper's simulation study (section 2.3.1): random geometries registered from one default; one row for each.

    python -m experiments.simulation_study [data=ct data.path=FILE] [seeds=1000] [views=[PA]] [dof=6] [shard=0/8]
    python -m experiments.simulation_study -m dof=9,6 shard=0/2,1/2 hydra/launcher=joblib
    python -m experiments.simulation_study study=threshold

A process registers one arm, or a shard of it. Rows are appended to OUT/ARM/registrations[-i].csv as they come. A second
start makes the rows that no table of the arm has. ``python -m experiments.merge`` gathers the arms. Columns, besides
parameters, errors, verdict and cost:

- redrawn: geometries drawn before this one that put bone behind the detector or too few targets into the image
- targets: targets in the image; PDE is the mean over them
- marker_*, corner*: the squares of figure 2; empty where the CT has no such target
"""

import hydra
from omegaconf import DictConfig

from experiments.common.command import help_of_settings, told_in_one_line
from experiments.simulation.study import run


@hydra.main(version_base="1.3", config_path="../conf", config_name="simulation_study")
def main(config: DictConfig) -> None:
    with told_in_one_line("simulation_study"):
        run(config)


if __name__ == "__main__":
    help_of_settings(__doc__, "simulation_study")
    main()
