"""One registration from the command line: what it writes and prints, and how its options reach the search."""

import json

import numpy as np
import pytest
import torch
from PIL import Image

from regtorch import optimization
from regtorch.registration.found import Found
from regtorch.registration.trust.evidence import measure

from .commands import PARAMETERS, REGISTER, SHARED, run


def test_register_writes_the_result_of_the_contract_and_an_overlay(inputs, tmp_path, method, capfd):
    assert run(REGISTER.format(i=inputs, o=tmp_path)) == 0
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
    assert err == ""
    assert "warning: ct.nii.gz: voxels of 6 x 6 x 6 mm" in out
    assert any("6 x 6 x 6 mm" in line for line in result["warnings"])


@pytest.mark.parametrize(("similarity", "status", "code"), [(0.5, "ok", 0), (0.01, "failed", 3)])
def test_exit_code_tells_whether_the_result_can_be_trusted(inputs, tmp_path, method, similarity, status, code):
    method.similarity = similarity
    assert run(REGISTER.format(i=inputs, o=tmp_path)) == code
    assert json.loads((tmp_path / "new" / "deep" / "result.json").read_text())["status"] == status


def test_the_same_seed_gives_the_same_result_but_for_the_seconds(inputs, tmp_path, method):
    method.search = method.tiny
    results = []
    for name in "ab":
        run(REGISTER.format(i=inputs, o=tmp_path / name) + " --seed 3")
        results.append(json.loads((tmp_path / name / "new" / "deep" / "result.json").read_text()))
        for told in (results[-1], *results[-1]["trace"]):
            del told["seconds"]
    assert results[0] == results[1]
    assert results[0]["seed"] == 3


def test_six_dof_keep_the_source_at_its_start(inputs, tmp_path, method):
    method.search = method.tiny
    run(REGISTER.format(i=inputs, o=tmp_path) + " --dof 6 --sdd-mm 1100")
    values = json.loads((tmp_path / "new" / "deep" / "result.json").read_text())["parameters"]
    assert [values[key] for key in PARAMETERS[:3]] == [0, 0, 1100]
    assert all(values[key] != 0 for key in PARAMETERS[3:])


def test_a_range_is_searched_and_zero_freezes(inputs, tmp_path, method):
    run(REGISTER.format(i=inputs, o=tmp_path) + " --source-range-mm 0 0 40 --rotation-range-deg 3")
    problem = method.problems[-1]
    assert problem.searched.free == [2, 3, 4, 5, 6, 7, 8]
    assert problem.searched.half_range[:6].tolist() == [0, 0, 40, 150, 150, 150]
    assert torch.rad2deg(problem.searched.half_range[6:]).tolist() == pytest.approx([3, 3, 3])
    run(REGISTER.format(i=inputs, o=tmp_path) + " --rotation-range-deg 0,3,0.5")
    assert torch.rad2deg(method.problems[-1].searched.half_range[6:]).tolist() == pytest.approx([0, 3, 0.5])
    assert method.problems[-1].searched.free == [0, 1, 2, 3, 4, 5, 7, 8]


def test_the_papers_alternative_parameters_need_all_nine(inputs, tmp_path, method, capsys):
    run(REGISTER.format(i=inputs, o=tmp_path) + " --parameters detector")
    assert method.problems[-1].unknowns.names[3:6] == ("x_d", "y_d", "z_d")
    run(REGISTER.format(i=inputs, o=tmp_path) + " --parameters patient")
    assert method.problems[-1].unknowns.names[3:6] == ("x_obj", "y_obj", "z_obj")
    method.search = method.tiny
    assert run(REGISTER.format(i=inputs, o=tmp_path / "six") + " --parameters detector --dof 6") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "x_s, y_s, z_s frozen: expected nine degrees of freedom" in line
    assert not (tmp_path / "six").exists()


def test_what_a_search_knows_of_its_errors_is_printed_and_written(inputs, tmp_path, method, capsys):
    def found(problem):
        spread = torch.diag(torch.tensor([0, 0, 50.0**2, 1, 1, 1, 0, 0, 0], dtype=torch.float64))
        initial, similarity = problem.searched.initial, torch.full((3,), 0.5).double()
        starts = initial.repeat(3, 1)
        evidence = measure(problem, initial, 0.5, starts, similarity, comparable=True, covariance=spread)
        return Found(initial, 0.5, starts, similarity, 3, evidence, spread)

    method.search = found
    (tmp_path / "targets.csv").write_text("name,x,y,z\nT8,0,0,0\n")
    run(REGISTER.format(i=inputs, o=tmp_path) + f" --targets {tmp_path}/targets.csv")
    told = json.loads((tmp_path / "new" / "deep" / "result.json").read_text())
    assert told["standard_deviations"]["z_s_mm"] == pytest.approx(50)
    assert list(told["expected_target_errors_mm"]) == ["T8"]
    assert told["expected_pde_mm"] > 1
    printed = capsys.readouterr().out
    assert "warning: SDD and ODD can hardly be told apart: SDD +- 5.0%" in printed
    assert "+- 50.000" in printed


@pytest.mark.parametrize(
    "error", [MemoryError(), RuntimeError("[enforce fail] DefaultCPUAllocator: can't allocate memory")]
)
def test_too_little_memory_is_told_in_one_line(inputs, tmp_path, method, capsys, error):
    def search(problem):
        raise error

    method.search = search
    assert run(REGISTER.format(i=inputs, o=tmp_path)) == 2
    assert capsys.readouterr().err.startswith("regtorch: error: out of memory")
    assert list(tmp_path.iterdir()) == []


def test_method_pycma_searches_by_the_package(inputs, tmp_path, method, monkeypatch):
    calls = []

    def counted(*arguments, **options):
        calls.append(options["seed"])
        return pycma(*arguments, **options)

    pycma = optimization.pycma
    monkeypatch.setattr(optimization, "pycma", counted)
    method.search = method.tiny
    run(REGISTER.format(i=inputs, o=tmp_path))
    assert not calls
    run(REGISTER.format(i=inputs, o=tmp_path) + " --method pycma --seed 7")
    assert calls == [7, 7, 7]


def test_threads_are_those_asked_for(inputs, tmp_path, method):
    import numba

    before = torch.get_num_threads(), numba.get_num_threads()
    try:
        assert run(REGISTER.format(i=inputs, o=tmp_path) + " --threads 1") == 0
        assert (torch.get_num_threads(), numba.get_num_threads()) == (1, 1)
    finally:
        torch.set_num_threads(before[0])
        numba.set_num_threads(before[1])


def test_the_mask_takes_pixels_out(inputs, tmp_path, method):
    mask = np.full((100, 80), 255, np.uint8)
    mask[20:40, :30] = 0
    Image.fromarray(mask).save(tmp_path / "mask.png")
    assert run(REGISTER.format(i=inputs, o=tmp_path) + f" --mask {tmp_path}/mask.png") == 0
    weight = method.problems[0].radiograph.weight
    assert torch.equal(weight == 0, torch.from_numpy(mask == 0))


def test_the_settings_reach_the_registration(inputs, tmp_path, method):
    told = " --threshold-hu 400 --sdd-mm 1300 --dof 7 --seed 5 --pixel-mm 3"
    assert run(REGISTER.format(i=inputs, o=tmp_path) + told) == 0
    problem = method.problems[0]
    assert float(problem.searched.initial[2]) == 1300
    assert problem.searched.free == [2, 3, 4, 5, 6, 7, 8]
    assert problem.seed == 5
    assert problem.radiograph.detector.pixel_mm == 3
    assert float(problem.attenuating.data[problem.attenuating.data > 0].min()) >= 0.02 * 1.4 - 1e-6
