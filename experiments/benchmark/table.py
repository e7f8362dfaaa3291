"""The table of the benchmark: cases are measured one after the other, and their rows replace older ones."""

from pathlib import Path
from typing import Any

import pandas as pd
from hydra.utils import instantiate
from omegaconf import DictConfig
from tqdm import tqdm

import regtorch
from experiments.benchmark.cases import Bench
from experiments.benchmark.scene import Scenes
from experiments.common.columns import code_version
from experiments.common.settings import keep
from regtorch.errors import RegtorchError

COLUMNS = [
    "case", "implementation", "device", "threads", "per_second", "times_regtorch", "share_of_limit",
    "samples_per_second", "relative_difference", "seconds", "seconds_spread", "poses", "pixels", "voxel_mm", "voxels",
    "megabytes", "version",
]  # fmt: skip

NOT_MEASURED = "not measured"


def run(config: DictConfig) -> None:
    """Measures the chosen cases."""
    out, cases = Path(config.out), chosen(config)
    keep(config, out, ("only", "out"))
    table = out / "benchmark.csv"
    bench = bench_of(config, tqdm.write)
    with tqdm(cases.items(), unit="case") as bar:
        for name, case in bar:
            bar.set_postfix_str(name)
            write(table, measured(bench, name, case))
    print(f"wrote {len(cases)} cases to {table}")


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
    """Replaces older rows of the same case and device, and rows of the case that were not measured."""
    if table.exists():
        old = pd.read_csv(table, dtype=object)
        again = old["case"].isin(rows["case"]) & (
            old["device"].isin(rows["device"]) | (old["per_second"] == NOT_MEASURED)
        )
        kept = old[~again]
        rows = pd.concat([kept, rows])
    rows.to_csv(table, index=False)
