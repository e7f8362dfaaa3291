"""Gathers the tables of a simulation study's arms into one Parquet file, FOLDER/registrations.parquet.

    python -m experiments.merge [FOLDER]

Rows are sorted by arm, view and seed, so that the same rows make the same file whoever made them.
"""

from experiments.common.command import folder_parser, tell_written, told_in_one_line
from experiments.common.registrations import MERGED
from experiments.simulation.merge import merge


def main() -> None:
    folder = folder_parser("merge", __doc__, "results/simulation").parse_args().folder
    with told_in_one_line("merge"):
        merged = merge(folder)
    for arm, of_arm in merged.groupby("arm"):
        versions = of_arm["version"].nunique() if "version" in of_arm else 1
        print(f"{arm}: {len(of_arm)} registrations" + (f", of {versions} versions" if versions > 1 else ""))
    tell_written([folder / MERGED])


if __name__ == "__main__":
    main()
