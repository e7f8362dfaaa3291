"""The same radiograph from files of several kinds is registered alike."""

import json

import numpy as np
import pydicom
import pytest

from .commands import SIZE, run


def test_tiff_png_and_dicom_register_alike(inputs, tmp_path, method):
    method.search = method.tiny
    results = []
    for kind in ("tiff", "png", "dcm"):
        assert run(f"simulate {inputs}/ct.nii.gz --view PA --out {tmp_path}/{kind} --format {kind} {SIZE}") == 0
        run(f"register {inputs}/ct.nii.gz {tmp_path}/{kind}/radiograph.{kind} --view PA --out {tmp_path}/{kind}/result")
        results.append(json.loads((tmp_path / kind / "result" / "result.json").read_text()))
        del results[-1]["seconds"], results[-1]["trace"], results[-1]["warnings"]  # which name the file
    assert results[0] == results[1] == results[2]


def test_a_mirrored_dicom_is_registered_alike_and_mapped_to_its_own_pixels(inputs, tmp_path, method):
    assert run(f"simulate {inputs}/ct.nii.gz --view PA --out {tmp_path}/plain --format dcm {SIZE}") == 0
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
        run(f"register {inputs}/ct.nii.gz {file} --view PA --out {tmp_path / name} {landmark}")
        results.append(json.loads((tmp_path / name / "result.json").read_text()))
        initial = method.problems[-1].searched.initial
        assert float(initial[3:5].abs().min()) > 0
    a, b = results
    assert (a["mirrored"], b["mirrored"]) == (False, True)
    assert a["parameters"] == b["parameters"]
    (u, v, w), (u2, v2, w2) = (np.array(r["pixel_from_patient"]) @ point for r in (a, b))
    assert u2 / w2 == pytest.approx(79 - u / w)
    assert v2 / w2 == pytest.approx(v / w)
