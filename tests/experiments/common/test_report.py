"""The report of a study is one file that needs no other, with its tables' numbers; bad input is told in one line."""

import base64
import re
import subprocess
import sys
from html import escape
from html.parser import HTMLParser
from io import BytesIO
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from experiments import report as command
from experiments.common.report import report
from tests.experiments.invented import simulation_rows

_ROOT = Path(__file__).parents[3]
_RESULTS = _ROOT / "results"
_STUDIES = sorted(
    path
    for path in (*_RESULTS.iterdir(), *(_RESULTS / "simulation_ablations").iterdir())
    if path.is_dir() and path.name != "simulation_ablations"
)


class Page(HTMLParser):
    """Content of a page: cell texts of each table row, sources of pictures, all tags and attributes."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.rows, self.sources, self.tags, self.attributes, self.open = [], [], [], [], []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.attributes += [name for name, _ in attributes]
        self.sources += [value for name, value in attributes if name == "src"]
        if tag not in ("meta", "img"):
            self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        elif tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] in ("td", "th"):
            self.rows[-1][-1] += data


def _command(*arguments: object) -> int:
    """The exit code of the command."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["report", *map(str, arguments)])
        try:
            command.main()
        except SystemExit as ended:
            return ended.code
    return 0


def _check_alone(text: str) -> Page:
    """The page refers to no other file or address."""
    page = Page(text)
    assert not re.search(r"https?:|url\(|@import", text)
    assert all(source.startswith("data:image/png;base64,") for source in page.sources)
    assert not {"script", "link", "iframe", "object"} & set(page.tags)
    assert not {"href", "srcset", "onload"} & set(page.attributes)
    return page


def _pictures(page: Page) -> list[Image.Image]:
    return [Image.open(BytesIO(base64.b64decode(source.partition(",")[2]))) for source in page.sources]


@pytest.fixture
def folder(tmp_path) -> Path:
    """A merged study with hostile texts, settings by arm, a figure, a table, and pictures of two of its worst."""
    folder = tmp_path / "a <b>study &"
    rows = simulation_rows(12, {"9-DOF": 9, "6-DOF": 6})
    rows.loc[5, ["pde_mm", "status", "message"]] = 99.0, "failed", '<script>alert("no")</script> & more'
    rows.loc[40, "pde_mm"] = np.inf
    for number, arm in enumerate(("9-DOF", "6-DOF")):
        (folder / arm / "failures").mkdir(parents=True)
        (folder / arm / "settings.yaml").write_text(f"dof: {9 - 3 * number}\nrange: {{mm: [1, 2]}}\nnone: <&>\n")
        Image.new("RGB", (7, 5 + number)).save(folder / arm / "failures" / "PA_5.png")
    Image.new("RGB", (6, 9)).save(folder / "9-DOF" / "failures" / "LAT_5.png")
    Image.new("RGB", (6, 4)).save(folder / "own.png")
    Image.new("RGB", (6, 3)).save(folder / "background_PA.png")
    (folder / "table.md").write_text("## Beside\n\n| a<b | c |\n|---|---|\n| 1 | x & y |\n\nA note\nof two lines.\n")
    rows.to_parquet(folder / "registrations.parquet")
    return folder


def test_a_report_is_one_file_with_all_that_the_folder_has(folder, capfd):
    assert _command(folder) == 0
    assert capfd.readouterr().out == f"wrote {folder}/report.html\n"
    text = (folder / "report.html").read_text()
    page = _check_alone(text)
    assert escape('<script>alert("no")</script> & more') in text
    assert "<h1>a &lt;b&gt;study &amp;</h1>" in text
    sizes = [picture.size for picture in _pictures(page)]
    assert [size for size in sizes if size[0] < 100] == [(7, 5), (6, 4)]
    assert len(sizes) == 4
    assert ["a<b", "c"] in page.rows
    assert ["1", "x & y"] in page.rows
    assert "<p>A note of two lines.</p>" in text
    assert ["dof", "6", "9"] in page.rows
    assert ["range.mm", "1, 2"] in page.rows
    assert ["none", "<&>"] in page.rows


def test_the_headline_has_the_numbers_of_the_table(folder):
    rows = pd.read_parquet(folder / "registrations.parquet")
    page = Page(report(folder))
    header, *lines = page.rows[:5]
    assert [line[:3] for line in lines] == [[a, v, "12"] for a in ("6-DOF", "9-DOF") for v in ("LAT", "PA")]
    found = dict(zip(header, lines[3], strict=True))
    pde = np.sort(rows.pde_mm[(rows.arm == "9-DOF") & (rows["view"] == "PA")].to_numpy(float))
    assert found["PDE"] == f"{np.median(pde):.3g}"
    assert found["quartiles"] == f"{pde[3]:.3g} to {pde[9]:.3g}"
    assert found["95 %"] == found["worst"] == "99"
    assert found["over 1, 5, 10 mm"] == "1, 1, 1"
    assert found["statuses"] == "11 ok, 1 failed"
    assert found["evaluations"] == "2,400"
    assert lines[0][header.index("worst")] == "∞"


def test_the_worst_come_first_with_their_own_pictures(folder):
    page = Page(report(folder))
    start = next(number for number, row in enumerate(page.rows) if "picture" in row)
    worst = page.rows[start + 1 : start + 11]
    assert [row[:3] for row in worst[:2]] == [["6-DOF", "LAT", "4"], ["9-DOF", "PA", "5"]]
    assert worst[1][3:5] == ["failed", '<script>alert("no")</script> & more']
    assert worst[1][6] == "99"
    assert page.rows[start + 11] != worst[0]


def test_pictures_are_of_the_rows_own_arm_ct_view_kind_and_seed(tmp_path):
    rows = simulation_rows(1, {"hybrid": 9}, ("PA",)).drop(columns="arm").assign(kind="matched")
    for number, arm in enumerate(("hybrid", "hybrid_bone")):
        pictures = tmp_path / arm / "failures"
        pictures.mkdir(parents=True)
        cts = pd.concat([rows.assign(ct=name) for name in ("ct.nii.gz", "other_ct.nii.gz")])
        cts.to_csv(tmp_path / arm / "registrations.csv", index=False)
        Image.new("RGB", (30, 8 + number)).save(pictures / "other_ct_PA_matched_0.png")
        Image.new("RGB", (30, 6)).save(pictures / "ct_PA_matched_10.png")
    Image.new("RGB", (30, 5)).save(tmp_path / "hybrid_bone" / "failures" / "ct_PA_matched_0.png")

    def heights(folder: Path) -> list[int]:
        return sorted(picture.height for picture in _pictures(Page(report(folder))) if picture.width == 30)

    assert heights(tmp_path) == [5, 8, 9]
    assert heights(tmp_path / "hybrid") == [8]


@pytest.mark.parametrize("study", _STUDIES, ids=lambda path: str(path.relative_to(_RESULTS)))
def test_every_study_of_the_project_has_a_report(study):
    page = _check_alone(report(study))
    assert page.sources or page.rows


def test_groups_are_those_that_a_study_has():
    header, *lines = Page(report(_RESULTS / "search")).rows[:9]
    assert header[:3] == ["ct", "view", "kind"]
    assert lines[0][:3] == ["acrin_abdomen_pelvis", "LAT", "matched"]


def test_decoys_have_no_pde_and_no_figures():
    page = Page(report(_RESULTS / "decoys"))
    assert page.sources == []
    assert page.rows[1][page.rows[0].index("PDE")] == ""


def test_a_report_needs_no_torch(folder):
    code = "import sys; from experiments.report import main; main(); "
    code += "assert not {'torch', 'numba', 'kornia', 'hydra'} & sys.modules.keys()"
    subprocess.run([sys.executable, "-c", code, str(folder)], check=True, cwd=_ROOT)


def _without(path: Path, column: str) -> None:
    simulation_rows(2, {"9-DOF": 9}).drop(columns=column).to_csv(path, index=False)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda folder: folder.rmdir(), "no such folder, expected one of a study"),
        (lambda folder: None, "no tables of registrations, *.png or table.md, expected a study's folder"),
        (lambda folder: (folder / "registrations.csv").write_text(""), "tables without rows, expected registrations"),
        (lambda folder: (folder / "registrations.csv").write_bytes(b"\xff\xfe\n"), "registrations.csv: cannot be"),
        (lambda folder: (folder / "registrations.csv").write_text("a\n1\n"), "no column 'view', expected a table"),
        (lambda folder: _without(folder / "registrations.csv", "pde_mm"), "no column 'pde_mm'"),
        (lambda folder: (folder / "registrations.parquet").write_text("no"), "registrations.parquet: cannot be"),
        (
            lambda folder: simulation_rows(1, {"a": 9}).assign(pde_mm="far").to_csv(folder / "registrations.csv"),
            "pde_mm is not of numbers",
        ),
        (lambda folder: _without(folder / "table.md", "arm") or _settings(folder, "a: [1"), "settings.yaml: cannot"),
        (lambda folder: _without(folder / "table.md", "arm") or _settings(folder, "a"), "a str at the top"),
    ],
)
def test_bad_input_is_told_in_one_line(tmp_path, capfd, make, message):
    folder = tmp_path / "study"
    folder.mkdir()
    make(folder)
    assert _command(folder) == 2
    out, err = capfd.readouterr()
    assert out == ""
    assert err.startswith("report: error: ")
    assert message in err
    assert err.count("\n") == 1
    assert not (folder / "report.html").exists()


def _settings(folder: Path, text: str) -> None:
    (folder / "settings.yaml").write_text(text)


def test_where_to_write_can_be_told(folder, tmp_path, capfd):
    assert _command(folder, "--out", tmp_path / "other.html") == 0
    assert (tmp_path / "other.html").read_text().startswith("<!doctype html>")
    assert _command(folder, "--out", tmp_path / "none" / "other.html") == 2
    assert "expected a file to write to" in capfd.readouterr().err
