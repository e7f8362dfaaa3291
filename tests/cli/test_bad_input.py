"""Bad input ends with exit code 2 and one line on stderr, and nothing is written."""

import pytest

from regtorch.cli import main

from .commands import EVALUATE, REGISTER, SIMULATE, disk, run

LANDMARK = "--landmark-ct 0 0 150"

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
    (f"{REGISTER} --device gpu", "device 'gpu': "),
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
    (f"{SIMULATE} --rotation-range-deg 1,2", "'1,2', expected one number, or three"),
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
    (f"{SIMULATE} --sdd-mm 240 --source-range-mm 0 0 0 --patient-range-mm 0 0 10000", "in all of 100 geometries drawn"),
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
    (f"{EVALUATE} {{i}}/good/truth.json --json {{i}}/empty", "{i}/empty: no ordinary file"),
]


@pytest.mark.parametrize(("arguments", "expected"), BAD, ids=[f"{n}-{case[1][:40]}" for n, case in enumerate(BAD)])
def test_bad_input_ends_with_2_and_one_line_and_writes_nothing(
    arguments, expected, inputs, tmp_path, method, capfd, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    before = disk(inputs, tmp_path)
    assert run(arguments.format(i=inputs, o=tmp_path)) == 2
    out, err = capfd.readouterr()
    assert out == ""
    assert len(err.splitlines()) == 1, err
    assert err.startswith("regtorch")
    assert expected.format(i=inputs, o=tmp_path) in err
    assert disk(inputs, tmp_path) == before
    assert not method.problems


def test_a_name_with_a_line_break_does_not_break_the_line(inputs, tmp_path, capfd):
    assert main(["register", f"{inputs}/ct.nii.gz", "a\nb.tiff", "--view", "PA", "--out", str(tmp_path)]) == 2
    assert capfd.readouterr().err.splitlines() == [
        "regtorch: error: a b.tiff: no such file, expected a radiograph (DICOM, PNG or TIFF)"
    ]
