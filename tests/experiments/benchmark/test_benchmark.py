"""A tiny run of the benchmark on the embedded phantom, and peers that render the same images."""

import sys
from pathlib import Path

import pandas as pd
import pytest
import torch
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf

from experiments.benchmark import figures
from experiments.benchmark import table as benchmark
from experiments.benchmark.cases import Bench, relative
from experiments.benchmark.limits import gathers_per_second, samples_all, samples_needed
from regtorch.drr import render, render_with_jacobian
from regtorch.geometry import Detector
from regtorch.imaging import Volume

pytestmark = pytest.mark.filterwarnings(
    "ignore:builtin type:DeprecationWarning", "ignore:.torch.jit.script. is deprecated:DeprecationWarning"
)

_CONF = Path(__file__).parents[3] / "conf"
_NAMED = ["case", "implementation", "device", "threads", "per_second", "times_regtorch", "share_of_limit"]
_SMALL = {"pixels": 16, "voxel_mm": 12.0, "poses": 3}
_PEERS = OmegaConf.load(_CONF / "benchmark.yaml").peers
_AWAY_FROM_THE_DETECTOR = torch.tensor([0, 0, 0, 0, 0, 150, 0, 0, 0])  # behind which DiffDRR's Siddon counts on
_WITH_GRADIENT = [name for name, peer in _PEERS.items() if "gradient" in peer]


def _config(*overrides: str) -> DictConfig:
    tiny = ["ct=null", "phantom_spacing_mm=6", "poses=3", "threads=1", "repeats=2", "least_s=0", "most_s=0.01"]
    with initialize_config_dir(str(_CONF), version_base="1.3"):
        return compose("benchmark", [*tiny, *overrides])


@pytest.fixture(scope="module")
def bench() -> Bench:
    config = _config()
    config.peers = {}
    return benchmark.bench_of(config)


@pytest.fixture(scope="module")
def table(bench) -> pd.DataFrame:
    """The configured cases, but small; without cases that need processes of their own or a GPU."""
    tables = []
    for name, case in benchmark.chosen(bench.config).items():
        small = {key: value for key, value in _SMALL.items() if key in case.keywords}
        if name.startswith("sweep"):
            ((over, _),) = case.keywords["over"].items()
            small = {"over": {over: [_SMALL[over], 2 * _SMALL[over]]}} | small
        if name not in ("limits", "memory"):
            tables.append(benchmark.measured(bench, name, lambda it, run=case, own=small: run(it, **own)))
    return pd.concat(tables)


def test_table_has_all_cases_and_the_columns_named(table, bench):
    assert list(table.columns)[: len(_NAMED)] == _NAMED
    assert set(table["case"]) == set(bench.config.cases) - {"limits", "memory"}
    assert bool(table["device"].notna().all())


def test_ratios_are_those_of_the_rates(table):
    for name, rows in table[~table["case"].str.startswith(("sweep", "gpu"))].groupby("case"):
        rates, times = pd.to_numeric(rows.per_second), pd.to_numeric(rows.times_regtorch)
        first = rates.iloc[-1] if name == "threads" else rates.iloc[0]
        assert rows.implementation.iloc[0] == "regtorch"
        assert (rates * times).to_numpy() == pytest.approx(first, rel=1e-4)


def test_two_classes_add_up_to_all_tissue(table):
    (difference,) = table[table.implementation == "regtorch two classes"].relative_difference
    assert float(difference) < 1e-5


def test_cases_for_a_gpu_say_when_nothing_was_measured(table):
    rows = table[table["case"].str.startswith("gpu")]
    if not torch.cuda.is_available():
        assert set(rows.per_second) == {benchmark.NOT_MEASURED}


def test_rows_replace_their_own_and_tables_and_figure_are_made_of_them(table, tmp_path):
    benchmark.write(tmp_path / "benchmark.csv", table)
    benchmark.write(tmp_path / "benchmark.csv", table[table["case"] == "threads"])
    again = pd.read_csv(tmp_path / "benchmark.csv")
    assert len(again) == len(table)
    assert set(again["case"]) == set(table["case"])
    figures.write(tmp_path)
    assert "| value_125 | regtorch |" in (tmp_path / "table.md").read_text()
    assert (tmp_path / "cost.png").stat().st_size > 10_000


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells and resets a process's peak memory")
def test_memory_is_measured_in_a_process_of_its_own(bench):
    case = benchmark.chosen(bench.config)["memory"]
    rows = benchmark.measured(bench, "memory", lambda it: case(it, counts=[100]))
    assert 0 <= float(rows.megabytes.iloc[0]) < 1000


def test_a_limit_is_a_rate():
    assert gathers_per_second(1, repeats=1) > 1e6


def test_samples_of_a_full_volume_are_all_needed_and_of_a_slice_its_own(bench):
    scene = bench.scenes.scene(**_SMALL)
    grid, poses = scene.volume, bench.scenes.start(scene.detector)[None]
    data = torch.ones(40, 30, 40)
    full = Volume(data, _about(grid, data), grid.origin_patient_mm, "per_mm")
    detector = Detector(32, 32, 1.0)
    place = poses, detector, "PA"
    assert samples_needed(full, *place) == samples_all(full, *place) == 32 * 32 * 30
    slice_alone = torch.zeros_like(data)
    slice_alone[:, 7] = 1
    assert samples_needed(full.with_data(slice_alone), *place) == 32 * 32
    halves = full.with_data(data)
    object.__setattr__(halves, "data", torch.stack([slice_alone, data - slice_alone]))
    assert samples_needed(halves, *place) == 32 * 32 * 30


@pytest.mark.peers
@pytest.mark.parametrize("shape", [(40, 40), (30, 44)])
@pytest.mark.parametrize("name", _PEERS)
def test_images_of_peers_are_ours(bench, name, shape):
    scene = bench.scenes.scene(40, 8.0, 3)
    detector = Detector(*shape, 9.0, (0.0, 0.0) if shape[0] == shape[1] else (20.0, -10.0))
    peer = instantiate(_PEERS[name])
    for view in ("PA", "RLAT"):
        try:
            images = peer["images"](scene.volume, detector, view, 1)
        except ImportError as error:
            pytest.skip(f"{name} is not installed ({error}): the README says how")
        poses = scene.poses + _AWAY_FROM_THE_DETECTOR
        ours = render(scene.volume, poses, detector, view, method=peer["method"])
        assert relative(images(poses), ours) < 0.05


@pytest.mark.peers
@pytest.mark.parametrize("name", _WITH_GRADIENT)
def test_gradients_of_peers_are_ours(bench, name):
    scene = bench.scenes.scene(40, 8.0, 3)
    data = scene.volume.data[None]
    for _ in range(2):  # smooth, as trilinear and bilinear values have different slopes
        data = torch.nn.functional.avg_pool3d(data, 5, 1, 2)
    volume, poses = scene.volume.with_data(data[0]), scene.poses + _AWAY_FROM_THE_DETECTOR
    at = torch.linspace(-1, 1, 40)
    weight = torch.exp(-3 * ((at[:, None] - 0.2) ** 2 + (at + 0.1) ** 2))
    try:
        gradient = instantiate(_PEERS[name])["gradient"](volume, scene.detector, scene.view, 1)
    except ImportError as error:
        pytest.skip(f"{name} is not installed ({error}): the README says how")
    jacobian = render_with_jacobian(volume, poses, scene.detector, scene.view)[1]
    ours = (jacobian.double() * weight).sum(dim=(-2, -1))
    scale = ours.square().mean(dim=0).sqrt()
    assert relative(gradient(poses, weight) / scale, ours / scale) < 0.01


def _about(grid: Volume, data: torch.Tensor) -> torch.Tensor:
    """Voxels of 4 mm about the origin of the CT."""
    place = torch.diag(torch.tensor([4.0, 4.0, 4.0, 1.0], dtype=torch.float64))
    last = torch.tensor([n - 1.0 for n in reversed(data.shape)], dtype=torch.float64)
    place[:3, 3] = grid.origin_patient_mm - 2 * last
    return place
