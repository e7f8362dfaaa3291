"""How often the search finds the place from far off, and whether its verdict knows: one row per registration.

    REGTORCH_DATA=FOLDER python -m experiments.search [seeds=200] [kinds=[matched]] [shard=0/2] [out=results/search]

Each seed draws a geometry and a rough start. Each CT, view and kind of radiograph is registered from this start.
``decoys`` adds images that fit nowhere; their rows have the kind ``decoy_NAME`` and no errors.

Rows are appended to OUT/registrations[-i].csv as they come. A second start makes the rows that no table of the folder
has. Processes of different shards may work in one folder at the same time. OUT/failures shows registrations that went
wrong, and those whose verdict did. ``python -m experiments.search_figures`` draws.
"""

import hydra
from omegaconf import DictConfig

from experiments.common.command import help_of_settings, told_in_one_line
from experiments.search.study import run


@hydra.main(version_base="1.3", config_path="../../conf", config_name="search")
def main(config: DictConfig) -> None:
    with told_in_one_line("search"):
        run(config)


if __name__ == "__main__":
    help_of_settings(__doc__, "search")
    main()
