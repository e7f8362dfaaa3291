"""The command line: what it writes, its exit codes, and one line on stderr with nothing written for bad input."""

import json
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import pydicom
import pytest
import SimpleITK
import tifffile
import torch
from PIL import Image
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import ComputedRadiographyImageStorage, CTImageStorage, ExplicitVRLittleEndian

from regtorch import optimization
from regtorch.cli import main
from regtorch.imaging import read_volume, write_volume
from regtorch.phantom import make_phantom
from regtorch.registration import evolution as evolution_module
from regtorch.registration import hybrid as hybrid_module
from regtorch.registration.problem import Found

SIZE = "--rows 100 --columns 80 --pixel-mm 3.5"
PARAMETERS = ["x_s_mm", "y_s_mm", "z_s_mm", "x_obj_mm", "y_obj_mm", "z_obj_mm", "eta_deg", "theta_deg", "phi_deg"]
SHARED = {"parameters", "view", "mirrored", "detector", "pixel_from_patient"}


class Method:
    """Stands in for the search: remembers the problem and answers with the start, or runs a tiny search."""

    def __init__(self) -> None:
        self.problems, self.similarity, self.search = [], 0.5, None

    def __call__(self, problem, **options):
        self.problems.append(problem)
        problem.progress(0.1, "searching")
        if self.search is not None:
            return self.search(problem, **options)
        starts = problem.initial.repeat(3, 1)
        return Found(problem.initial, self.similarity, starts, torch.full((3,), self.similarity).double(), 3)


@pytest.fixture
def method(monkeypatch) -> Method:
    stub = Method()
    stub.tiny = partial(
        evolution_module.evolution, starts=3, generations=2, pixels=(16, 24), survivors=1, final_generations=2
    )
    monkeypatch.setattr(evolution_module, "evolution", stub)
    monkeypatch.setattr(hybrid_module, "hybrid", stub)
    return stub


@pytest.fixture(scope="session")
def inputs(tmp_path_factory) -> Path:
    """A CT and a radiograph of it that are in order (``ct.nii.gz``, ``good/``) among much that is not."""
    folder = tmp_path_factory.mktemp("inputs")
    ct, _ = make_phantom(6.0)
    write_volume(folder / "ct.nii.gz", ct)
    assert main(f"simulate {folder}/ct.nii.gz --view PA {SIZE} --out {folder}/good".split()) == 0
    answer = _result_of(folder / "good" / "truth.json")
    (folder / "good" / "result.json").write_text(json.dumps(answer))
    _bad_volumes(folder)
    _bad_radiographs(folder)
    _bad_texts(folder, json.loads((folder / "good" / "truth.json").read_text()))
    (folder / "taken" / "result.json").mkdir(parents=True)
    (folder / "taken" / "truth.json").mkdir()
    return folder


def _result_of(truth: Path) -> dict:
    content = json.loads(truth.read_text())
    del content["targets_patient_mm"]
    return content | {"status": "ok", "message": "", "similarity": 0.5, "evaluations": 1, "seconds": 1, "device": "cpu"}


def _bad_volumes(folder: Path) -> None:
    (folder / "empty").mkdir()
    (folder / "nothing.nii.gz").write_bytes(b"")
    (folder / "cut.nii.gz").write_bytes((folder / "ct.nii.gz").read_bytes()[:5000])
    image = SimpleITK.ReadImage(str(folder / "ct.nii.gz"))
    soft = image * 0 - 500
    SimpleITK.WriteImage(soft, str(folder / "soft.mha"))
    for suffix in ("nii.gz", "mha"):
        image[3, 4, 5] = float("nan")
        SimpleITK.WriteImage(image, str(folder / f"nan.{suffix}"))
    heights = {
        "gap": [0, 2, 4, 8, 10],
        "uneven": [0, 2, 4, 6.6, 8.6],
        "twice": [0, 2, 2, 4, 6],
        "two_series": [0, 2, 4, 6, 8],
    }
    for name, at in heights.items():
        (folder / name).mkdir()
        for number, z in enumerate(at):
            _dicom_slice(folder / name / f"{number}.dcm", z, f"1.2.{int(name == 'two_series' and number > 2)}")


def _dicom_slice(path: Path, z: float, series: str) -> None:
    d = Dataset()
    d.SOPClassUID, d.SOPInstanceUID, d.SeriesInstanceUID = CTImageStorage, f"1.2.3.{z}", series
    d.Modality, d.ImageOrientationPatient, d.ImagePositionPatient = "CT", [1, 0, 0, 0, 1, 0], [0, 0, z]
    d.PixelSpacing, d.RescaleSlope, d.RescaleIntercept = [1, 1], 1, -1024
    _save(d, path, np.full((6, 6), 1500, np.uint16))


def _save(d: Dataset, path: Path, stored: np.ndarray, **changes: object) -> None:
    d.Rows, d.Columns = stored.shape[-2:]
    d.SamplesPerPixel, d.PhotometricInterpretation = 1, "MONOCHROME2"
    d.BitsAllocated, d.BitsStored, d.HighBit, d.PixelRepresentation = 16, 16, 15, 0
    d.PixelData = stored.tobytes()
    for keyword, value in changes.items():
        setattr(d, keyword, value)
    d.file_meta = FileMetaDataset()
    d.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    d.save_as(path, enforce_file_format=True)


def _bad_radiographs(folder: Path) -> None:
    good = tifffile.imread(folder / "good" / "radiograph.tiff")
    tifffile.imwrite(folder / "unsized.tiff", good)
    Image.fromarray(good).save(folder / "unsized.png")
    (folder / "nothing.tiff").write_bytes(b"")
    (folder / "cut.tiff").write_bytes((folder / "good" / "radiograph.tiff").read_bytes()[:3000])
    tifffile.imwrite(folder / "rgb.tiff", np.zeros((20, 20, 3), np.uint8))
    tifffile.imwrite(folder / "frames.tiff", np.zeros((4, 20, 20), np.uint16), photometric="minisblack")
    tifffile.imwrite(folder / "nan.tiff", np.full((20, 20), np.nan, np.float32))
    tifffile.imwrite(folder / "tiny.tiff", np.arange(42, dtype=np.uint16).reshape(6, 7))
    tifffile.imwrite(folder / "mask_small.tiff", np.ones((10, 10), np.uint8))
    tifffile.imwrite(folder / "mask_none.tiff", np.zeros((100, 80), np.uint8))
    for name, stored, changes in (
        ("unsized.dcm", good, {}),
        ("frames.dcm", np.stack([good, good]), {"NumberOfFrames": 2, "ImagerPixelSpacing": [3.5, 3.5]}),
        ("rgb.dcm", good, {"SamplesPerPixel": 3, "PhotometricInterpretation": "RGB", "ImagerPixelSpacing": [1, 1]}),
        ("zero.dcm", good, {"ImagerPixelSpacing": [0, 0]}),
    ):
        d = Dataset()
        d.SOPClassUID, d.SOPInstanceUID, d.Modality = ComputedRadiographyImageStorage, "1.2.3", "CR"
        _save(d, folder / name, stored, **changes)


def _bad_texts(folder: Path, truth: dict) -> None:
    (folder / "a_file").write_text("text")
    (folder / "short.csv").write_text("name,x,y,z\nfirst,1,2,3\nsecond,4,5\n")
    (folder / "words.csv").write_text("first,one,two,three\n")
    (folder / "empty.csv").write_text("")
    (folder / "list.json").write_text("[1, 2]")
    (folder / "cut.json").write_text(json.dumps(truth)[:200])
    (folder / "other.json").write_text('{"patients": []}')
    detector = truth["detector"] | {"rows": 50}
    for name, change in (
        ("ap", {"view": "AP"}),
        ("detector", {"detector": detector}),
        ("unknown_view", {"view": "pa"}),
        ("no_targets", {"targets_patient_mm": {}}),
        ("matrix", {"pixel_from_patient": [[1, 2], [3, 4]]}),
        ("nan", {"parameters": truth["parameters"] | {"x_s_mm": float("nan")}}),
    ):
        (folder / f"truth_{name}.json").write_text(json.dumps(truth | change))


def _disk(*folders: Path) -> dict[str, bytes | None]:
    return {str(p): p.read_bytes() if p.is_file() else None for folder in folders for p in folder.rglob("*")}


def _run(arguments: str) -> int:
    try:
        return main(arguments.split())
    except SystemExit as error:
        return int(error.code or 0)


REGISTER = "register {i}/ct.nii.gz {i}/good/radiograph.tiff --view PA --out {o}/new/deep"
SIMULATE = f"simulate {{i}}/ct.nii.gz --view PA --out {{o}}/new {SIZE}"
LANDMARK = "--landmark-ct 0 0 150"
EVALUATE = "evaluate {i}/good/result.json"

BAD = [
    # usage
    ("", "COMMAND"),
    ("frobnicate", "'frobnicate'"),
    ("register {i}/ct.nii.gz", "RADIOGRAPH, --view, --out"),
    ("simulate --view PA --out {o}/new", "CT"),
    ("evaluate {i}/good/result.json", "TRUTH"),
    (f"{REGISTER} --frobnicate", "--frobnicate"),
    (f"{REGISTER} --dof 8", "8"),
    (f"{REGISTER} --method simplex", "'simplex'"),
    (f"{REGISTER} --intensity log", "'log'"),
    (f"{SIMULATE} --format bmp", "'bmp'"),
    *((f"{command} --view {view}", f"'{view}'") for command in (REGISTER, SIMULATE, "demo") for view in ("XX", "pa")),
    *((f"{command} --threads {n}", n) for command in (REGISTER, SIMULATE) for n in ("0", "-1", "100000", "x")),
    *((f"{command} --pixel-mm {n}", f"'{n}'") for command in (REGISTER, SIMULATE) for n in ("0", "-1", "nan", "inf")),
    *((f"{command} --sdd-mm {n}", f"'{n}'") for command in (REGISTER, SIMULATE) for n in ("0", "-1000", "nan", "x")),
    *((f"{command} --seed {n}", f"'{n}'") for command in (REGISTER, SIMULATE, "demo") for n in ("-1", "4294967296")),
    *((f"{command} --threshold-hu {n}", n) for command in (REGISTER, SIMULATE) for n in ("nan", "5000")),
    *((f"{SIMULATE} --rows {n}", f"'{n}'") for n in ("0", "-1", "1.5", "1000000")),
    *((f"{SIMULATE} --photons {n}", f"'{n}'") for n in ("0", "-5", "nan", "1e30")),
    (f"{SIMULATE} --source-range-mm 1 -1 1", "'-1', expected a number from 0"),
    (f"{SIMULATE} --rotation-range-deg nan", "'nan'"),
    # CT
    *(
        (f"{command} {rest}", f"{{i}}/{name}: {what}")
        for name, what in (
            ("none.nii", "no such file or folder"),
            ("empty", "no DICOM image in this folder"),
            ("two_series", "2 series, expected one"),
            ("gap", "1 slice(s) missing between 2.dcm and 3.dcm"),
            ("uneven", "2.60 mm between 2.dcm and 3.dcm"),
            ("twice", "1.dcm and 2.dcm both lie at 2.00 mm"),
            ("nothing.nii.gz", "no NIfTI header"),
            ("cut.nii.gz", "cannot be read"),
            ("nan.nii.gz", "1 voxel(s) are NaN"),
            ("nan.mha", "1 voxel(s) are NaN"),
            ("good/radiograph.tiff", "not a CT"),
            ("gap/0.dcm", "a single DICOM file, expected the folder"),
            ("a_file", "not a CT"),
        )
        for command, rest in (
            (f"register {{i}}/{name}", "{i}/good/radiograph.tiff --view PA --out {o}/new"),
            (f"simulate {{i}}/{name}", "--view PA --out {o}/new"),
        )
    ),
    ("register {i}/soft.mha {i}/good/radiograph.tiff --view PA --out {o}/new", "soft.mha: no voxel over 100 HU"),
    ("simulate {i}/soft.mha --view PA --out {o}/new", "soft.mha: no voxel over 100 HU"),
    (f"{REGISTER} --sdd-mm 200", "SDD of 200 mm: in this PA view ct.nii.gz reaches"),
    (f"{SIMULATE} --sdd-mm 200", "SDD of 200 mm: in this PA view ct.nii.gz reaches"),
    (f"{SIMULATE} --sdd-mm 240 --source-range-mm 0 0 0 --patient-range-mm 0 0 200", "SDD of 240 mm"),
    # radiograph
    *(
        (f"register {{i}}/ct.nii.gz {{i}}/{name} --view PA --out {{o}}/new", f"{{i}}/{name}: {what}")
        for name, what in (
            ("none.tiff", "no such file"),
            ("good", "a folder, expected a radiograph"),
            ("ct.nii.gz", "not a radiograph"),
            ("gap/0.dcm", "Modality CT"),
            ("rgb.tiff", "colour image"),
            ("frames.tiff", "4 images in one file"),
            ("rgb.dcm", "PhotometricInterpretation RGB, 3 channel(s)"),
            ("frames.dcm", "2 frames, expected a single radiograph"),
            ("unsized.tiff", "no pixel size in the file, expected the detector's by --pixel-mm"),
            ("unsized.png", "no pixel size in the file"),
            ("unsized.dcm", "no pixel size in the file"),
            ("zero.dcm", "no pixel size in the file (ImagerPixelSpacing is 0"),
            ("nothing.tiff", "cannot be read"),
            ("cut.tiff", "cannot be read"),
            ("a_file", "not a radiograph"),
        )
    ),
    ("register {i}/ct.nii.gz {i}/nan.tiff --pixel-mm 1 --view PA --out {o}/new", "nan.tiff: pixels that are NaN"),
    ("register {i}/ct.nii.gz {i}/tiny.tiff --pixel-mm 1 --view PA --out {o}/new", "tiny.tiff: 6 x 7 pixels, expected"),
    # what goes with them
    (f"{REGISTER} --landmark-ct 0 0 150", "only one of --landmark-ct and --landmark-radiograph"),
    (f"{REGISTER} --landmark-radiograph 3 4", "only one of --landmark-ct and --landmark-radiograph"),
    (f"{REGISTER} {LANDMARK} --landmark-radiograph 80 4", "(80, 4), expected it inside the image of 80 x 100 pixels"),
    (f"{REGISTER} {LANDMARK} --landmark-radiograph nan 4", "'nan'"),
    (f"{REGISTER} --landmark-ct 0 0 9999 --landmark-radiograph 3 4", "9999.0) mm (LPS): expected it inside ct.nii.gz"),
    (f"{REGISTER} --mask {{i}}/none.png", "{i}/none.png: no such file"),
    (f"{REGISTER} --mask {{i}}/mask_small.tiff", "{i}/mask_small.tiff: mask of 10 x 10 pixels, expected 100 x 80"),
    (f"{REGISTER} --mask {{i}}/mask_none.tiff", "every pixel is masked"),
    (f"{REGISTER} --mask {{i}}/rgb.tiff", "{i}/rgb.tiff: colour image"),
    *(
        (f"{command} --targets {{i}}/{name}", f"{{i}}/{name}: {what}")
        for command in (REGISTER, SIMULATE)
        for name, what in (
            ("none.csv", "No such file"),
            ("short.csv", "line 3 is ['second', '4', '5']"),
            ("words.csv", "line 1 is"),
            ("empty.csv", "no points"),
        )
    ),
    # output
    *(
        (command.replace("{o}/new/deep", path).replace("{o}/new", path), f"{named or path}: {what}")
        for command, name in ((REGISTER, "result.json"), (SIMULATE, "truth.json"))
        for path, named, what in (
            ("{i}/a_file", "", "File exists, expected a folder to write to"),
            ("{i}/a_file/below", "", "Not a directory, expected a folder to write to"),
            ("{i}/taken", f"{{i}}/taken/{name}", "a folder, expected a file to write"),
            ("{o}/" + 300 * "x", "", "File name too long, expected a folder to write to"),
        )
    ),
    # evaluate
    ("evaluate {i}/good/truth.json {i}/good/truth.json", "truth.json: no 'status', expected a result.json"),
    (f"{EVALUATE} {{i}}/good/result.json", "result.json: no 'targets_patient_mm', expected a truth.json"),
    (f"{EVALUATE} {{i}}/none.json", "{i}/none.json: no such file, expected a truth.json"),
    (f"{EVALUATE} {{i}}/empty", "{i}/empty: cannot be read"),
    (f"{EVALUATE} {{i}}/ct.nii.gz", "{i}/ct.nii.gz: cannot be read as JSON"),
    (f"{EVALUATE} {{i}}/list.json", "{i}/list.json: a list at the top"),
    (f"{EVALUATE} {{i}}/cut.json", "{i}/cut.json: cannot be read as JSON"),
    (f"{EVALUATE} {{i}}/other.json", "{i}/other.json: no 'parameters'"),
    (f"{EVALUATE} {{i}}/truth_unknown_view.json", "{i}/truth_unknown_view.json: unknown view 'pa'"),
    (f"{EVALUATE} {{i}}/truth_no_targets.json", "{i}/truth_no_targets.json: targets_patient_mm"),
    (f"{EVALUATE} {{i}}/truth_matrix.json", "{i}/truth_matrix.json: pixel_from_patient"),
    (f"{EVALUATE} {{i}}/truth_nan.json", "{i}/truth_nan.json: parameters"),
    (f"{EVALUATE} {{i}}/truth_ap.json", "{i}/good/result.json and {i}/truth_ap.json: view PA"),
    (f"{EVALUATE} {{i}}/truth_detector.json", "{i}/good/result.json and {i}/truth_detector.json: detector"),
    (f"{EVALUATE} {{i}}/good/truth.json --json {{o}}/none/out.json", "/none/out.json: No such file or directory"),
    (f"{EVALUATE} {{i}}/good/truth.json --json {{i}}/empty", "{i}/empty: Is a directory"),
]


@pytest.mark.parametrize(("arguments", "expected"), BAD, ids=[f"{n}-{case[1][:40]}" for n, case in enumerate(BAD)])
def test_bad_input_ends_with_2_and_one_line_and_writes_nothing(
    arguments, expected, inputs, tmp_path, method, capfd, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    before = _disk(inputs, tmp_path)
    assert _run(arguments.format(i=inputs, o=tmp_path)) == 2
    out, err = capfd.readouterr()
    assert out == ""
    assert len(err.splitlines()) == 1, err
    assert err.startswith("regtorch")
    assert expected.format(i=inputs, o=tmp_path) in err
    assert _disk(inputs, tmp_path) == before
    assert not method.problems


def test_a_folder_that_the_system_does_not_let_write_to(inputs, capfd):
    if not Path("/proc/self").exists():
        pytest.skip("no folder here that even root cannot write to")
    for command in (REGISTER, SIMULATE):
        arguments = command.replace("{o}/new/deep", "/proc/new").replace("{o}", "/proc")
        assert _run(arguments.format(i=inputs)) == 2
        assert capfd.readouterr().err.startswith("regtorch: error: /proc/new: No such file or directory, expected")


def test_an_empty_name_is_not_the_current_folder(inputs, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    ct, image = f"{inputs}/ct.nii.gz", f"{inputs}/good/radiograph.tiff"
    assert main(["register", ct, image, "--view", "PA", "--out", ""]) == 2
    assert capfd.readouterr().err == "regtorch: error: empty name, expected a folder to write to\n"
    assert not list(tmp_path.iterdir())


def test_a_name_with_a_line_break_does_not_break_the_line(inputs, tmp_path, capfd):
    assert main(["register", f"{inputs}/ct.nii.gz", "a\nb.tiff", "--view", "PA", "--out", str(tmp_path)]) == 2
    assert capfd.readouterr().err.splitlines() == [
        "regtorch: error: a b.tiff: no such file, expected a radiograph (DICOM, PNG or TIFF)"
    ]


def test_other_files_in_the_output_folder_stay(inputs, tmp_path, method):
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "result.json").write_text("of an earlier run")
    bad = f"register {inputs}/ct.nii.gz {inputs}/unsized.tiff --view PA --out {tmp_path}"
    before = _disk(tmp_path)
    assert _run(bad) == 2
    assert _disk(tmp_path) == before
    assert (tmp_path / "result.json").read_text() == "of an earlier run"
    assert _run(f"{bad} --pixel-mm 3.5") == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == ["notes.txt", "overlay.png", "result.json"]
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert json.loads((tmp_path / "result.json").read_text())["status"] == "ok"


def test_interrupting_ends_with_130_and_leaves_nothing(inputs, tmp_path, method, capfd):
    def interrupted(problem):
        raise KeyboardInterrupt

    method.search = interrupted
    assert _run(REGISTER.format(i=inputs, o=tmp_path)) == 130
    assert capfd.readouterr().err.splitlines()[-1] == "regtorch: interrupted, nothing written"
    assert not list(tmp_path.iterdir())


def test_control_c_of_a_running_registration_leaves_nothing(inputs, tmp_path):
    # Whoever runs the tests in the background may have them ignore the signal.
    program = "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler)"
    program += "; from regtorch.cli import main; sys.exit(main(sys.argv[1:]))"
    arguments = REGISTER.format(i=inputs, o=tmp_path).split()
    with subprocess.Popen([sys.executable, "-c", program, *arguments], stderr=subprocess.PIPE, text=True) as process:
        while not (tmp_path / "new" / "deep").exists() and process.poll() is None:
            time.sleep(0.02)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=120)
    assert process.returncode == 130, err
    assert err.splitlines()[-1] == "regtorch: interrupted, nothing written"
    assert not list(tmp_path.iterdir())


def test_help_describes_every_command_and_loads_nothing_heavy():
    program = """
import contextlib, sys
from regtorch.cli import main
for words in ([], ["demo"], ["simulate"], ["register"], ["evaluate"], None):
    with contextlib.suppress(SystemExit):
        main(["--version"] if words is None else [*words, "--help"])
heavy = {"torch", "numpy", "numba", "SimpleITK", "matplotlib", "pandas", "cma"} & set(sys.modules)
sys.exit(f"loads {heavy}" if heavy else 0)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    for word in ("Exit codes: 0", "demo", "--landmark-radiograph COLUMN ROW", "--targets FILE", "truth.json", "0.1.0"):
        assert word in done.stdout


def test_simulate_writes_a_radiograph_and_the_truth_of_the_contract(inputs):
    assert sorted(p.name for p in (inputs / "good").iterdir()) == ["radiograph.tiff", "result.json", "truth.json"]
    truth = json.loads((inputs / "good" / "truth.json").read_text())
    assert set(truth) >= SHARED | {"targets_patient_mm"}
    assert list(truth["parameters"]) == PARAMETERS
    assert (truth["view"], truth["mirrored"]) == ("PA", False)
    assert truth["detector"] == {"rows": 100, "columns": 80, "pixel_mm": 3.5}
    assert np.shape(truth["pixel_from_patient"]) == (3, 4)
    assert all(len(point) == 3 for point in truth["targets_patient_mm"].values())


def test_simulate_repeats_itself_by_seed_and_does_what_it_is_told(inputs, tmp_path):
    (tmp_path / "targets.csv").write_text("name,x,y,z\nupper,0,0,200\nlower,10,0,100\n")
    told = f"simulate {inputs}/ct.nii.gz --view LAT {SIZE} --photons 1000 --threshold-hu 100"
    told += f" --targets {tmp_path}/targets.csv --sdd-mm 1200 --rotation-range-deg 0"
    told += " --source-range-mm 0 0 0 --patient-range-mm 0 0 0"
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        assert _run(f"{told} --seed {seed} --out {tmp_path / name}") == 0
    a, b, c = ((tmp_path / name / "radiograph.tiff").read_bytes() for name in "abc")
    assert a == b != c
    truth = json.loads((tmp_path / "a" / "truth.json").read_text())
    assert truth["targets_patient_mm"] == {"upper": [0, 0, 200], "lower": [10, 0, 100]}
    values = truth["parameters"]
    assert values["z_s_mm"] == 1200
    assert values["z_obj_mm"] > 0
    assert [values[key] for key in PARAMETERS if key not in ("z_s_mm", "z_obj_mm")] == [0] * 7


def test_register_writes_the_result_of_the_contract_and_an_overlay(inputs, tmp_path, method, capfd):
    assert _run(REGISTER.format(i=inputs, o=tmp_path)) == 0
    out, err = capfd.readouterr()
    folder = tmp_path / "new" / "deep"
    assert sorted(p.name for p in folder.iterdir()) == ["overlay.png", "result.json"]
    result = json.loads((folder / "result.json").read_text())
    assert set(result) >= SHARED | {
        "status",
        "message",
        "similarity",
        "evaluations",
        "seconds",
        "device",
        "seed",
        "version",
    }
    assert list(result["parameters"]) == PARAMETERS
    assert result["detector"] == {"rows": 100, "columns": 80, "pixel_mm": 3.5}
    assert np.shape(result["pixel_from_patient"]) == (3, 4)
    assert Image.open(folder / "overlay.png").size[0] > 500
    assert out.startswith("ok: all 3 starts agree")
    assert all(line.startswith("regtorch: warning: ") for line in err.splitlines())
    assert "6 x 6 x 6 mm" in err


@pytest.mark.parametrize(("similarity", "status", "code"), [(0.5, "ok", 0), (0.01, "failed", 3)])
def test_exit_code_tells_whether_the_result_can_be_trusted(inputs, tmp_path, method, similarity, status, code):
    method.similarity = similarity
    assert _run(REGISTER.format(i=inputs, o=tmp_path)) == code
    assert json.loads((tmp_path / "new" / "deep" / "result.json").read_text())["status"] == status


def test_the_same_seed_gives_the_same_result_but_for_the_seconds(inputs, tmp_path, method):
    method.search = method.tiny
    results = []
    for name in "ab":
        _run(REGISTER.format(i=inputs, o=tmp_path / name) + " --seed 3")
        results.append(json.loads((tmp_path / name / "new" / "deep" / "result.json").read_text()))
        del results[-1]["seconds"]
    assert results[0] == results[1]
    assert results[0]["seed"] == 3


def test_six_dof_keep_the_source_at_its_start(inputs, tmp_path, method):
    method.search = method.tiny
    _run(REGISTER.format(i=inputs, o=tmp_path) + " --dof 6 --sdd-mm 1100")
    values = json.loads((tmp_path / "new" / "deep" / "result.json").read_text())["parameters"]
    assert [values[key] for key in PARAMETERS[:3]] == [0, 0, 1100]
    assert all(values[key] != 0 for key in PARAMETERS[3:])


def test_a_range_is_searched_and_zero_freezes(inputs, tmp_path, method):
    _run(REGISTER.format(i=inputs, o=tmp_path) + " --source-range-mm 0 0 40 --rotation-range-deg 3")
    problem = method.problems[-1]
    assert problem.free == [2, 3, 4, 5, 6, 7, 8]
    assert problem.half_range[:6].tolist() == [0, 0, 40, 75, 75, 150]
    assert torch.rad2deg(problem.half_range[6:]).tolist() == pytest.approx([3, 3, 3])


def test_what_a_search_knows_of_its_errors_is_printed_and_written(inputs, tmp_path, method, capsys):
    def found(problem):
        spread = torch.diag(torch.tensor([0, 0, 50.0**2, 1, 1, 1, 0, 0, 0], dtype=torch.float64))
        starts = problem.initial.repeat(3, 1)
        return Found(problem.initial, 0.5, starts, torch.full((3,), 0.5).double(), 3, spread)

    method.search = found
    (tmp_path / "targets.csv").write_text("name,x,y,z\nT8,0,0,0\n")
    _run(REGISTER.format(i=inputs, o=tmp_path) + f" --targets {tmp_path}/targets.csv")
    told = json.loads((tmp_path / "new" / "deep" / "result.json").read_text())
    assert told["standard_deviations"]["z_s_mm"] == pytest.approx(50)
    assert list(told["expected_target_errors_mm"]) == ["T8"]
    assert told["expected_pde_mm"] > 1
    printed = capsys.readouterr().out
    assert "warning: SDD and ODD can hardly be told apart: SDD +- 50 mm" in printed
    assert "+- 50.000" in printed


def test_method_pycma_searches_by_the_package(inputs, tmp_path, method, monkeypatch):
    calls = []

    def counted(*arguments, **options):
        calls.append(options["seed"])
        return pycma(*arguments, **options)

    pycma = optimization.pycma
    monkeypatch.setattr(optimization, "pycma", counted)
    method.search = method.tiny
    _run(REGISTER.format(i=inputs, o=tmp_path))
    assert not calls
    _run(REGISTER.format(i=inputs, o=tmp_path) + " --method pycma --seed 7")
    assert calls == [7, 7, 7]


def test_threads_are_those_asked_for(inputs, tmp_path, method):
    import numba

    before = torch.get_num_threads(), numba.get_num_threads()
    try:
        assert _run(REGISTER.format(i=inputs, o=tmp_path) + " --threads 1") == 0
        assert (torch.get_num_threads(), numba.get_num_threads()) == (1, 1)
    finally:
        torch.set_num_threads(before[0])
        numba.set_num_threads(before[1])


def test_the_mask_takes_pixels_out(inputs, tmp_path, method):
    mask = np.full((100, 80), 255, np.uint8)
    mask[20:40, :30] = 0
    Image.fromarray(mask).save(tmp_path / "mask.png")
    assert _run(REGISTER.format(i=inputs, o=tmp_path) + f" --mask {tmp_path}/mask.png") == 0
    weight = method.problems[0].radiograph.weight
    assert torch.equal(weight == 0, torch.from_numpy(mask == 0))


def test_the_settings_reach_the_registration(inputs, tmp_path, method):
    told = " --threshold-hu 400 --sdd-mm 1300 --dof 7 --seed 5 --pixel-mm 3"
    assert _run(REGISTER.format(i=inputs, o=tmp_path) + told) == 0
    problem = method.problems[0]
    assert float(problem.initial[2]) == 1300
    assert problem.free == [2, 3, 4, 5, 6, 7, 8]
    assert problem.seed == 5
    assert problem.radiograph.detector.pixel_mm == 3
    assert float(problem.attenuating.data[problem.attenuating.data > 0].min()) >= 0.02 * 1.4 - 1e-6


def test_tiff_png_and_dicom_register_alike(inputs, tmp_path, method):
    method.search = method.tiny
    results = []
    for kind in ("tiff", "png", "dcm"):
        assert _run(f"simulate {inputs}/ct.nii.gz --view PA --out {tmp_path}/{kind} --format {kind} {SIZE}") == 0
        _run(
            f"register {inputs}/ct.nii.gz {tmp_path}/{kind}/radiograph.{kind} --view PA --out {tmp_path}/{kind}/result"
        )
        results.append(json.loads((tmp_path / kind / "result" / "result.json").read_text()))
        del results[-1]["seconds"]
    assert results[0] == results[1] == results[2]


def test_a_mirrored_dicom_is_registered_alike_and_mapped_to_its_own_pixels(inputs, tmp_path, method):
    assert _run(f"simulate {inputs}/ct.nii.gz --view PA --out {tmp_path}/plain --format dcm {SIZE}") == 0
    plain = tmp_path / "plain" / "radiograph.dcm"
    d = pydicom.dcmread(plain)
    d.PixelData = np.ascontiguousarray(d.pixel_array[:, ::-1]).tobytes()
    d.PatientOrientation = ["L", "F"]
    d.save_as(tmp_path / "mirrored.dcm")
    method.search = method.tiny
    point = np.array([15.0, 5.0, 180.0, 1.0])
    results = []
    for name, file, column in (("a", plain, 30), ("b", tmp_path / "mirrored.dcm", 79 - 30)):
        landmark = f"--landmark-ct 15 5 180 --landmark-radiograph {column} 60"
        _run(f"register {inputs}/ct.nii.gz {file} --view PA --out {tmp_path / name} {landmark}")
        results.append(json.loads((tmp_path / name / "result.json").read_text()))
        initial = method.problems[-1].initial
        assert float(initial[3:5].abs().min()) > 0
    a, b = results
    assert (a["mirrored"], b["mirrored"]) == (False, True)
    assert a["parameters"] == b["parameters"]
    (u, v, w), (u2, v2, w2) = (np.array(r["pixel_from_patient"]) @ point for r in (a, b))
    assert u2 / w2 == pytest.approx(79 - u / w)
    assert v2 / w2 == pytest.approx(v / w)


def test_evaluate_prints_and_writes(inputs, tmp_path, capfd):
    truth, result = inputs / "good" / "truth.json", tmp_path / "result.json"
    content = _result_of(truth)
    content["parameters"]["phi_deg"] += 359.5
    content["pixel_from_patient"][0] = [  # one pixel to the right
        first + last
        for first, last in zip(content["pixel_from_patient"][0], content["pixel_from_patient"][2], strict=True)
    ]
    result.write_text(json.dumps(content))
    assert _run(f"evaluate {result} {truth}") == 0
    printed = capfd.readouterr().out
    assert printed.startswith("pde_mm           3.5000")
    assert _run(f"evaluate {result} {truth} --json {tmp_path}/found.json") == 0
    assert capfd.readouterr().out == printed
    assert _run(f"evaluate {result} {truth} --json") == 0
    out, err = capfd.readouterr()
    found = json.loads(out)
    assert err == ""
    assert found == json.loads((tmp_path / "found.json").read_text())
    assert set(found) >= {"pde_mm", "target_error_mm", "parameter_errors"}
    assert found["pde_mm"] == pytest.approx(3.5)
    assert found["parameter_errors"]["phi_deg"] == pytest.approx(-0.5)
    assert list(found["parameter_errors"]) == PARAMETERS


def test_evaluate_of_the_truth_itself_is_zero(inputs, capfd):
    assert _run(f"evaluate {inputs}/good/result.json {inputs}/good/truth.json --json") == 0
    found = json.loads(capfd.readouterr().out)
    assert found["pde_mm"] == 0
    assert found["target_error_mm"] == pytest.approx(0, abs=1e-9)
    assert set(found["parameter_errors"].values()) == {0}


def test_demo_needs_no_file_and_evaluates_itself(tmp_path, method, monkeypatch, capfd):
    monkeypatch.setattr("regtorch.phantom.make_phantom", partial(make_phantom, 6.0))
    monkeypatch.chdir(tmp_path)
    assert _run("demo --view LAT --seed 2") == 0
    out = capfd.readouterr().out
    names = sorted(p.name for p in (tmp_path / "regtorch-demo").iterdir())
    assert names == ["overlay.png", "phantom.nii.gz", "radiograph.tiff", "result.json", "truth.json"]
    assert "pde_mm" in out
    assert out.splitlines()[-1] == f"see {Path('regtorch-demo') / 'overlay.png'}"
    assert read_volume(tmp_path / "regtorch-demo" / "phantom.nii.gz").spacing_mm.tolist() == [6, 6, 6]
