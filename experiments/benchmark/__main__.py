"""Speed of this project and its peers on the same volume, poses and detector: one row per implementation and case.

    REGTORCH_DATA=FOLDER python -m experiments.benchmark [only=[value_125,gc_125]] [threads=2] [out=results/benchmark]

OUT/benchmark.csv is written after each case. Rows of a case replace its older rows on the same device.
``python -m experiments.benchmark_figures`` draws. Columns:

- per_second: images, images with Jacobians, or scored poses, by the median turn
- times_regtorch: the rate of the case's first row, regtorch's, over the rate of this row
- share_of_limit: samples per second over the reads of 16 bytes that as many threads can make. Counted are the samples
  that no tile of 8 x 16 pixels can skip, a lower bound. On a GPU: their bytes over the rate of its cache
- samples_per_second: rays x slices of the whole volume, skipped or not, per second
- relative_difference: from regtorch's images (or gradients) by the same method, by norm, before timing
- seconds, seconds_spread: one call with ``poses`` poses; slowest less fastest turn over the median
- megabytes (10^6 bytes): growth of memory at most, with the results, one number per pose
"""

import hydra
from omegaconf import DictConfig

from experiments.benchmark.table import run
from experiments.common.command import help_of_settings, told_in_one_line


@hydra.main(version_base="1.3", config_path="../../conf", config_name="benchmark")
def main(config: DictConfig) -> None:
    with told_in_one_line("benchmark"):
        run(config)


if __name__ == "__main__":
    help_of_settings(__doc__, "benchmark")
    main()
