"""Figures and tables of the simulation study and of sweeps show what the merged table holds, and need it alone."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from PIL import Image

from experiments.common import ablation
from experiments.common.coupling import slopes
from experiments.common.registrations import PARAMETERS, read_rows
from experiments.common.statistics import median_interval
from experiments.common.style import plain_logarithmic
from experiments.simulation import figures
from experiments.simulation.start_figure import start_figure
from regtorch.errors import RegtorchError
from tests.experiments.invented import simulation_rows

_ROOT = Path(__file__).parents[3]
_ARMS = {"9-DOF": 9, "6-DOF": 6}


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A table of the study, with one lost registration and one target behind the source."""
    folder = tmp_path_factory.mktemp("simulation")
    rows = simulation_rows(40, _ARMS)
    rows.loc[3, "pde_mm"], rows.loc[90, "pde_mm"] = 12.5, np.inf
    rows.astype({"arm": "category"}).to_parquet(folder / "registrations.parquet")
    figures.write(folder)
    return folder


def _is_drawn(path: Path) -> bool:
    grey = np.asarray(Image.open(path).convert("L"))
    return grey.shape[1] > 900 and all((half < 200).mean() > 0.005 for half in np.array_split(grey, 2, axis=1))


def _cells(text: str, title: str) -> list[list[str]]:
    """The lines of the table below a heading."""
    block = text.split(f"## {title}\n\n")[1].split("\n\n")[0]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in block.splitlines()]


@pytest.mark.parametrize("name", ["figure2", "figure4", "coupling", "pde"])
def test_each_figure_is_written_and_not_blank(folder, name):
    assert _is_drawn(folder / f"{name}.png")


def test_one_figure_alone_needs_no_torch(folder, tmp_path):
    (tmp_path / "registrations.parquet").write_bytes((folder / "registrations.parquet").read_bytes())
    code = "import runpy, sys; sys.argv[1:] = [sys.argv[1], '--only', 'figure4']; "
    code += "runpy.run_module('experiments.simulation_figures', run_name='__main__'); "
    code += "assert not {'torch', 'numba', 'kornia'} & sys.modules.keys()"
    subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=True, cwd=_ROOT)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["figure4.png", "registrations.parquet"]


def test_the_headline_has_our_numbers_beside_the_papers(folder):
    rows, text = read_rows(folder), (folder / "table.md").read_text()
    header, _, *lines = _cells(text, "Beside the paper")
    assert header == ["", "9-DOF", "9-DOF, paper", "6-DOF", "6-DOF, paper"]
    found = {line[0]: line[1:] for line in lines}
    nine, six = (rows[rows.arm == arm] for arm in _ARMS)
    low, high = median_interval(nine.pde_mm)
    assert found["PDE"][0] == f"{np.median(nine.pde_mm):.3g} [{low:.3g}, {high:.3g}]"
    assert found["PDE, LAT"][2].startswith(f"{np.median(six.pde_mm[six['view'] == 'LAT']):.3g} [")
    assert found["quartiles of PDE"][0] == "{0[20]:.3g} to {0[60]:.3g}".format(np.sort(nine.pde_mm))
    assert found["over 1 mm"] == ["1 of 80", "1 of 2000", f"{(six.pde_mm > 1).sum()} of 80", "725 of 2000"]
    assert found["over 10 mm"] == ["1 of 80", "0 of 2000", "1 of 80", "1 of 2000"]
    assert [found["worst PDE"][0], found["worst PDE"][2]] == ["12.5", "∞"]
    assert found["mean evaluations"] == ["2,400", "687,701", "2,400", "233,851"]
    errors = {tuple(line[:2]): line[2:] for line in _cells(text, "Errors of the parameters")}
    some = rows[(rows.arm == "6-DOF") & (rows["view"] == "PA")]
    expected = [f"{np.median(np.abs(some[f'error_{key}'])):.3g}" for key in PARAMETERS]
    assert errors["6-DOF", "PA"][:9] == expected


def test_figure_4_has_the_papers_panels_and_the_medians_of_the_table(folder):
    rows = read_rows(folder)
    figure = figures.error_figure(rows)
    titles = [axes.get_title() for axes in figure.axes]
    assert titles == [
        f"({letter}) {view}, {arm}, n = 40"
        for letter, (arm, view) in zip("abcd", [(a, v) for a in _ARMS for v in ("LAT", "PA")], strict=True)
    ]
    for axes, (arm, view) in zip(figure.axes, [(a, v) for a in _ARMS for v in ("LAT", "PA")], strict=True):
        some = rows[(rows.arm == arm) & (rows["view"] == view)]
        values = [some[f"error_{key}"].abs() for key in PARAMETERS] + [some.initial_pde_mm, some.pde_mm]
        level = [set(line.get_ydata()) for line in axes.lines]
        drawn = [ys.pop() for ys in level if len(ys) == 1]
        for value in values:
            middle = np.sort(value)[19:21]
            expected = np.sqrt(middle[0] * middle[1])  # of logarithms
            assert np.isclose(drawn, expected, rtol=1e-6).any()


def test_squares_of_figure_2_lie_about_the_vertebra(folder):
    rows = read_rows(folder)
    axes = start_figure(rows, folder).axes[1]
    some = rows[(rows.arm == "9-DOF") & (rows["view"] == "LAT")]
    (circle,) = [patch for patch in axes.patches if isinstance(patch, Circle)]
    middle = [np.median(some.marker_x_mm), np.median(some.marker_y_mm)]
    assert circle.center == pytest.approx(middle)
    (squares,) = [one for one in axes.collections if isinstance(one, PolyCollection)]
    assert len(squares.get_paths()) == 40
    first = squares.get_paths()[0].vertices[:4] - middle
    assert first.ravel().tolist() == pytest.approx(some.iloc[0].filter(like="corner").tolist(), rel=1e-5)


def test_figure_2_shows_a_background_if_there_is_one(folder, tmp_path):
    rows = read_rows(folder)
    Image.new("L", (50, 40), 90).save(tmp_path / "background_PA.png")
    assert [len(axes.images) for axes in start_figure(rows, tmp_path).axes] == [0, 0]
    (tmp_path / "9-DOF").mkdir()
    (tmp_path / "9-DOF" / "settings.yaml").write_text("detector: {rows: 400, columns: 500, pixel_mm: 0.7}")
    panels = start_figure(rows, tmp_path).axes
    assert [len(axes.images) for axes in panels] == [1, 0]
    assert panels[0].images[0].get_extent() == [-175, 175, -140, 140]


def test_figure_2_is_of_the_rows_that_know_their_marker(tmp_path):
    rows = simulation_rows(6, _ARMS)
    places = list(rows.filter(regex="marker|corner"))
    rows.loc[rows.seed < 2, places] = np.nan
    (squares,) = [one for one in start_figure(rows, tmp_path).axes[0].collections if isinstance(one, PolyCollection)]
    assert len(squares.get_paths()) == 4
    rows[places] = np.nan
    rows.to_parquet(tmp_path / "registrations.parquet")
    figures.write(tmp_path)
    assert sorted(path.stem for path in tmp_path.glob("*.png")) == ["coupling", "figure4", "pde"]
    with pytest.raises(RegtorchError, match="no row with 'marker_x_mm'"):
        figures.write(tmp_path, "figure2")


def test_arms_may_have_other_views(tmp_path):
    rows = simulation_rows(5, _ARMS)
    rows = rows[(rows.arm == "9-DOF") | (rows["view"] == "PA")]
    rows.to_parquet(tmp_path / "registrations.parquet")
    figures.write(tmp_path, "table")
    found = {line[0]: line[1:] for line in _cells((tmp_path / "table.md").read_text(), "Beside the paper")}
    assert found["PDE, LAT"][0]
    assert found["PDE, LAT"][2:] == ["", "0.566"]


@pytest.mark.parametrize(("low", "high"), [(6.2, 9.1), (0.021, 0.045), (0.3, 70.0)])
def test_a_logarithmic_axis_tells_what_it_spans_however_little_that_is(low, high):
    axes = Figure().subplots()
    axes.plot([low, high])
    plain_logarithmic(axes)
    bottom, top = axes.get_ylim()
    assert bottom <= low < high <= top
    ticks = [tick for tick in axes.get_yticks() if bottom <= tick <= top]
    told = axes.yaxis.get_major_formatter().format_ticks(ticks)
    assert len(told) >= 2
    assert [float(text) for text in told] == pytest.approx(ticks)


def test_slopes_leave_out_what_was_not_found():
    rows = simulation_rows(30, {"6-DOF": 6}, ("PA",)).astype({"error_x_s_mm": float})
    rows["pde_mm"] = 0.5
    rows["error_x_obj_mm"] = 0.25 * rows.error_x_s_mm + 1
    rows.loc[0, ["error_x_obj_mm", "pde_mm"]] = 400, 80
    assert slopes(rows, "x") == pytest.approx((0.3, 0.25))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda rows: rows.assign(arm="T=0"), "expected the simulation study's"),
        (lambda rows: rows.drop(columns="corner2_y_mm"), "no column 'corner2_y_mm'"),
        (lambda rows: rows.iloc[:0], "expected registrations"),
    ],
)
def test_another_table_is_refused(tmp_path, change, message):
    change(simulation_rows(3, _ARMS)).to_parquet(tmp_path / "registrations.parquet")
    with pytest.raises(RegtorchError, match=message):
        figures.write(tmp_path)


def test_an_ablation_has_a_figure_and_compares_with_its_reference(tmp_path):
    rows = simulation_rows(25, {"T=100": 9, "T=0": 9, "T=50": 9})
    rows.loc[rows.arm == "T=50", "pde_mm"] = 3 * rows.loc[rows.arm == "T=100", "pde_mm"].to_numpy()
    rows.loc[rows.index[(rows.arm == "T=0") & (rows["view"] == "PA")][:5], "pde_mm"] = [2, 3, 6, 7, 8]
    rows.to_parquet(tmp_path / "registrations.parquet")
    ablation.write(tmp_path, "T=100")
    assert _is_drawn(tmp_path / "ablation.png")
    text = (tmp_path / "table.md").read_text()
    alone = {tuple(line[:2]): line[2:] for line in _cells(text, "Arms")}
    assert list(alone)[2:] == [(arm, view) for arm in ("T=0", "T=50", "T=100") for view in ("LAT", "PA")]
    assert alone["T=0", "PA"][2:4] == ["80 [60.9, 91.1]", "88 [70, 95.8]"]
    against = {line[0]: line[1:] for line in _cells(text, "Against T=100")[2:]}
    assert list(against) == ["T=0", "T=50"]
    assert against["T=50"][:2] == ["50", "3"]
    assert float(against["T=50"][3]) == pytest.approx(2 * float(against["T=50"][2]), rel=0.1)


def test_an_ablation_may_be_of_folders(tmp_path):
    for number, arm in enumerate(("hybrid", "hybrid_bone")):
        (tmp_path / arm).mkdir()
        rows = simulation_rows(6 - number, {arm: 9}).drop(columns="arm")
        rows.to_csv(tmp_path / arm / "registrations.csv", index=False)
    ablation.write(tmp_path)
    assert "| hybrid_bone | 10 |" in (tmp_path / "table.md").read_text()


def test_arms_of_other_views_are_not_compared(tmp_path):
    views = {"a": "PA", "b": "LAT", "c": "PA"}
    rows = simulation_rows(9, dict.fromkeys(views, 9))
    rows[rows["view"] == rows.arm.map(views)].to_parquet(tmp_path / "registrations.parquet")
    ablation.write(tmp_path)
    against = {line[0]: line[1:] for line in _cells((tmp_path / "table.md").read_text(), "Against a")[2:]}
    assert against["b"] == ["0", "", "", ""]
    assert against["c"][0] == "9"
    assert against["c"][2] == against["c"][3]


def test_an_ablation_needs_two_arms_and_a_reference_of_them(tmp_path):
    simulation_rows(3, {"T=0": 9}).to_parquet(tmp_path / "registrations.parquet")
    with pytest.raises(RegtorchError, match=r"arms \[T=0\], expected two or more"):
        ablation.write(tmp_path)
    simulation_rows(3, {"T=0": 9, "T=50": 9}).to_parquet(tmp_path / "registrations.parquet")
    with pytest.raises(RegtorchError, match="--reference T=1: expected one of T=0, T=50"):
        ablation.write(tmp_path, "T=1")


def test_a_table_may_lie_in_shards_that_a_kill_cut_short(tmp_path):
    rows = simulation_rows(4, {"a": 9}, ("PA",))
    text = rows.to_csv(index=False).splitlines(keepends=True)
    (tmp_path / "registrations-0.csv").write_text("".join(text[:3]) + text[3].split(" starts")[0])
    (tmp_path / "registrations-1.csv").write_text(text[0] + text[3][:200] + "\n" + "".join(text[3:]))
    found = read_rows(tmp_path).sort_values("seed")
    assert found.seed.tolist() == [0, 1, 2, 3]
    assert found.pde_mm.tolist() == pytest.approx(rows.pde_mm.tolist())


def test_a_table_may_be_empty(tmp_path):
    rows = simulation_rows(4, {"a": 9}, ("PA",))
    for arm in ("a", "b"):
        (tmp_path / arm).mkdir()
        (tmp_path / arm / "registrations-0.csv").touch()
    rows.to_csv(tmp_path / "a" / "registrations-1.csv", index=False)
    found = read_rows(tmp_path)
    assert found.seed.tolist() == [0, 1, 2, 3]
    assert found.pde_mm.dtype == "float64"


def test_an_arm_may_be_named_like_a_number_or_a_missing_value(tmp_path):
    for arm in ("0010", "2", "NA"):
        (tmp_path / arm).mkdir()
        simulation_rows(4, {arm: 9}).to_csv(tmp_path / arm / "registrations.csv", index=False)
    assert set(read_rows(tmp_path).arm) == {"0010", "2", "NA"}
    ablation.write(tmp_path, "NA")
    against = [line[0] for line in _cells((tmp_path / "table.md").read_text(), "Against NA")[2:]]
    assert against == ["2", "0010"]


@pytest.mark.parametrize(("arms", "views"), [({"9-DOF": 9}, ("PA",)), ({"6-DOF": 6}, ("LAT", "PA"))])
def test_a_part_of_the_study_can_be_drawn(tmp_path, arms, views):
    simulation_rows(5, arms, views).to_parquet(tmp_path / "registrations.parquet")
    figures.write(tmp_path)
    assert len(list(tmp_path.glob("*.png"))) == 4
    assert (tmp_path / "table.md").read_text().count("## ") == (4 if 6 in arms.values() else 3)
