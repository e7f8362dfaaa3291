"""Real radiographs registered to their CTs from random starts: one row per registration.

    python -m experiments.real pairs=FILE [starts=100] [only=[9-DOF]] [shard=0/2] [out=results/real]

FILE is YAML beside the data: the files and facts of each pair. The page on studies tells its entries.
The seed of a row draws its start about what view and protocol tell, as in the paper's cadaver study.
Each arm says which facts a registration is told, and how many parameters are free.

Rows are appended to OUT/registrations[-i].csv as they come. A second start makes the rows that no table of the folder
has. Processes of different shards may work in one folder at the same time.
``python -m experiments.real_figures`` draws.
"""

import hydra
from omegaconf import DictConfig

from experiments.common.command import help_of_settings, told_in_one_line
from experiments.real.study import run


@hydra.main(version_base="1.3", config_path="../../conf", config_name="real")
def main(config: DictConfig) -> None:
    with told_in_one_line("real"):
        run(config)


if __name__ == "__main__":
    help_of_settings(__doc__, "real")
    main()
