"""Accuracy on one real CT: radiographs simulated from it, registered from a rough start; one row per registration.

    REGTORCH_DATA=FOLDER python -m experiments.accuracy [seeds=10] [views=[PA]] [out=results/accuracy]

Rows are appended to OUT/registrations.csv as they come. A second start makes the missing rows.
``python -m experiments.accuracy_figures`` draws.
"""

import hydra
from omegaconf import DictConfig

from experiments.accuracy.study import run
from experiments.common.command import help_of_settings, told_in_one_line


@hydra.main(version_base="1.3", config_path="../../conf", config_name="accuracy")
def main(config: DictConfig) -> None:
    with told_in_one_line("accuracy"):
        run(config)


if __name__ == "__main__":
    help_of_settings(__doc__, "accuracy")
    main()
