"""The accuracy study makes each row once, and its figures need its table alone."""

from pathlib import Path

import pandas as pd
import pytest
from hydra import compose, initialize_config_dir

from experiments.accuracy import figures, study
from regtorch.formats.volumes import write_volume
from regtorch.phantom import make_phantom

CONF = Path(__file__).parents[3] / "conf"
TINY = [
    "seeds=2", "detector={rows: 60, columns: 60, pixel_mm: 5.8}", "threads=1",
    "arms=[{dof: 6, radiograph_threshold_hu: 100.0}]",
]  # fmt: skip
METHOD = {"_target_": "regtorch.registration.cmaes", "_partial_": True}
METHOD |= {"starts": 3, "survivors": 2, "finalists": 1, "generations": 4, "final_generations": 8}


@pytest.mark.usefixtures("threads_kept")
def test_rows_are_complete_resumed_and_drawn(tmp_path, capsys):
    write_volume(tmp_path / "ct.nii.gz", make_phantom(6.0)[0])
    out = tmp_path / "out"
    with initialize_config_dir(str(CONF), version_base="1.3"):
        config = compose("accuracy", [*TINY, f"ct={tmp_path / 'ct.nii.gz'}", f"out={out}"])
    config.registration = METHOD
    study.run(config)
    rows = pd.read_csv(out / "registrations.csv")
    assert tuple(rows) == study.COLUMNS
    assert list(zip(rows["view"], rows.seed, strict=True)) == [("PA", 0), ("LAT", 0), ("PA", 1), ("LAT", 1)]
    assert rows[["true_x_s_mm", "pde_mm", "status", "message", "seconds"]].notna().all(axis=None)
    study.run(config)
    assert f"4 of 4 registrations are in {out} already" in capsys.readouterr().out
    assert figures.write(out) == [out / name for name in ("table.md", "accuracy.png", "coupling.png")]
    assert "| 6-DOF, bone alone | PA | 2 |" in (out / "table.md").read_text()
