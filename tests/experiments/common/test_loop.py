"""The loop makes each row once, keeps the settings, and reports the rows that exist."""

import pytest
from omegaconf import OmegaConf

from experiments.common.loop import Plan, register_missing
from experiments.common.settings import SETTINGS
from regtorch.errors import RegtorchError

pytestmark = pytest.mark.usefixtures("threads_kept")


class Counting:
    made = 0

    def __init__(self, config):
        self.config = config

    def row(self, case, tell):
        tell("half way")
        Counting.made += 1
        return {"status": "ok"}


def _plan(folder, cases, columns=("seed", "limit", "status"), **settings):
    config = OmegaConf.create({"threads": 1, "dof": 9, "out": str(folder)} | settings)
    return Plan(config, folder, ("seed", "limit"), columns, cases, ("threads", "out"))


def test_each_row_is_made_once_and_the_command_says_so(tmp_path, capsys):
    folder, cases = tmp_path / "study", [(0, None), (1, 2.5)]
    Counting.made = 0
    register_missing(_plan(folder, cases[:1]), Counting)
    register_missing(_plan(folder, cases), Counting)
    assert Counting.made == 2
    assert (folder / "registrations.csv").read_text().splitlines() == ["seed,limit,status", "0,,ok", "1,2.5,ok"]
    assert (folder / SETTINGS).read_text() == "dof: 9\n"
    assert capsys.readouterr().out.splitlines() == [
        f"wrote 1 of 1 registrations to {folder}/registrations.csv",
        f"wrote 1 of 2 registrations to {folder}/registrations.csv",
    ]
    register_missing(_plan(folder, cases), lambda config: pytest.fail("read the CT for nothing"))
    assert capsys.readouterr().out == f"2 of 2 registrations are in {folder} already; out=FOLDER begins anew\n"


def test_other_settings_and_another_version_are_refused_before_any_work(tmp_path):
    folder = tmp_path / "study"
    register_missing(_plan(folder, [(0, None)]), Counting)
    before = (folder / "registrations.csv").read_bytes()
    with pytest.raises(RegtorchError, match="made with another 'dof'"):
        register_missing(_plan(folder, [(1, None)], dof=6), Counting)
    with pytest.raises(RegtorchError, match="no column 'reasons', begun by another version"):
        register_missing(_plan(folder, [(1, None)], ("seed", "limit", "status", "reasons")), Counting)
    assert (folder / "registrations.csv").read_bytes() == before


def test_a_finished_folder_of_another_version_is_finished(tmp_path, capsys):
    folder = tmp_path / "study"
    register_missing(_plan(folder, [(0, None)]), Counting)
    register_missing(_plan(folder, [(0, None)], ("seed", "limit", "status", "reasons")), Counting)
    assert "1 of 1 registrations are in" in capsys.readouterr().out
