"""Speed of this project and its peers on the same volume, poses and detector: one row per implementation and case.

    REGTORCH_DATA=... python -m experiments.benchmark [only=[value_125,gc_125]] [threads=2] [out=results/benchmark]

Writes ``benchmark.csv`` after each case, where rows of a case replace those that it had on the same device.
``experiments.benchmark_figures`` draws. Columns:

- per_second: images (for Jacobians: images with theirs; for scores: poses), by the median turn
- times_regtorch: the rate of the case's first row, regtorch's, over this row's
- share_of_limit: for regtorch, samples that no tile of 8 x 16 pixels can skip (``limits.samples_needed``, a lower
  bound of those taken) per second, over the reads of 16 bytes that as many threads can make
  (``limits.gathers_per_second``); on a GPU, their bytes over what its cache can deliver
- samples_per_second: rays x slices of the whole volume, skipped or not, per second
- relative_difference: of images (or gradients) from regtorch's by the same method, by norm, before anything was timed
- seconds, seconds_spread: of one call with ``poses`` poses; slowest less fastest turn over the median
- megabytes (10^6 bytes): by which memory grew at most, what is returned (one number per pose) with it
"""

from pathlib import Path
from typing import Any

import hydra
import pandas as pd
from hydra.utils import instantiate
from omegaconf import DictConfig
from tqdm import tqdm

import regtorch
from experiments.benchmark_cases import Bench
from experiments.benchmark_scene import Scenes
from experiments.command import told_in_one_line
from experiments.rows import code_version
from experiments.table import keep
from regtorch.errors import RegtorchError

COLUMNS = [
    "case", "implementation", "device", "threads", "per_second", "times_regtorch", "share_of_limit",
    "samples_per_second", "relative_difference", "seconds", "seconds_spread", "poses", "pixels", "voxel_mm", "voxels",
    "megabytes", "version",
]  # fmt: skip

NOT_MEASURED = "not measured"


@hydra.main(version_base="1.3", config_path="../conf", config_name="benchmark")
def main(config: DictConfig) -> None:
    with told_in_one_line("benchmark"):
        run(config)


def run(config: DictConfig) -> None:
    out, cases = Path(config.out), chosen(config)
    keep(config, out, ("only", "out"))
    bench = bench_of(config, tqdm.write)
    with tqdm(cases.items(), unit="case") as bar:
        for name, case in bar:
            bar.set_postfix_str(name)
            write(out / "benchmark.csv", measured(bench, name, case))


def bench_of(config: DictConfig, say: Any = print) -> Bench:
    peers = {name: instantiate(peer) for name, peer in config.peers.items()}
    return Bench(config, Scenes(config), peers, say)


def chosen(config: DictConfig) -> dict[str, Any]:
    names = list(config.cases) if config.only is None else list(config.only)
    if missing := [name for name in names if name not in config.cases]:
        raise RegtorchError(f"only={missing[0]}: expected of {', '.join(config.cases)}")
    return {name: instantiate(config.cases[name]) for name in names}


def measured(bench: Bench, name: str, case: Any) -> pd.DataFrame:
    version = code_version(Path(regtorch.__file__).parent)
    rows = [{"case": name, "version": version} | row for row in case(bench)]
    digits = [{key: f"{v:.6g}" if isinstance(v, float) else v for key, v in row.items()} for row in rows]
    return pd.DataFrame(digits, columns=COLUMNS, dtype=object)


def write(table: Path, rows: pd.DataFrame) -> None:
    """Rows take the place of older ones of the same case and device, and of what was not measured."""
    if table.exists():
        old = pd.read_csv(table, dtype=object)
        again = old["case"].isin(rows["case"]) & (
            old["device"].isin(rows["device"]) | (old["per_second"] == NOT_MEASURED)
        )
        kept = old[~again]
        rows = pd.concat([kept, rows])
    rows.to_csv(table, index=False)


if __name__ == "__main__":
    main()
