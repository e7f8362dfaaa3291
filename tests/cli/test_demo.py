"""The demonstration on the embedded phantom."""

from functools import partial
from pathlib import Path

from regtorch.formats import read_volume
from regtorch.phantom import make_phantom

from .commands import run


def test_demo_needs_no_file_and_evaluates_itself(tmp_path, method, monkeypatch, capfd):
    monkeypatch.setattr("regtorch.phantom.make_phantom", partial(make_phantom, 6.0))
    monkeypatch.chdir(tmp_path)
    assert run("demo --view LAT --seed 2") == 0
    out = capfd.readouterr().out
    names = sorted(p.name for p in (tmp_path / "regtorch-demo").iterdir())
    assert names == ["overlay.png", "phantom.nii.gz", "radiograph.tiff", "result.json", "truth.json"]
    assert "pde_mm" in out
    assert out.splitlines()[-1] == f"see {Path('regtorch-demo') / 'overlay.png'}"
    assert read_volume(tmp_path / "regtorch-demo" / "phantom.nii.gz").spacing_mm.tolist() == [6, 6, 6]
