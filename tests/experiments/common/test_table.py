"""Tables are resumed after kills as if nothing had happened, and never hold rows of other columns."""

import pandas as pd
import pytest

from experiments.common.table import append, done, refuse_other_columns, whole_lines
from regtorch.errors import RegtorchError

KEY = ["arm", "view", "seed"]


def test_a_row_cut_short_is_written_anew(tmp_path):
    table = tmp_path / "registrations.csv"
    row = {"arm": "a", "view": "PA", "seed": 0, "message": 'one, "two"', "last": 1}
    for seed in (0, 1):
        append(table, row | {"seed": seed})
    whole = table.read_bytes()
    for size in range(len(whole)):
        table.write_bytes(whole[:size])
        made = done(tmp_path, KEY)
        assert whole_lines(table).encode() == whole[: whole.rfind(b"\n", 0, size) + 1]
        for seed in (0, 1):
            if ("a", "PA", str(seed)) not in made:
                append(table, row | {"seed": seed})
        assert table.read_bytes() == whole


def test_a_row_of_other_columns_is_refused_and_one_in_another_order_is_not(tmp_path):
    table = tmp_path / "registrations.csv"
    append(table, {"seed": 0, "view": "PA"})
    before = table.read_bytes()
    for row, message in (({"seed": 1}, "unknown column 'view'"), ({"seed": 1, "view": "PA", "n": 2}, "no column 'n'")):
        with pytest.raises(RegtorchError, match=rf"registrations\.csv: {message}.*out=FOLDER begins anew"):
            append(table, row)
    assert table.read_bytes() == before
    append(table, {"view": "PA", "seed": 1})
    assert table.read_text().splitlines() == ["seed,view", "0,PA", "1,PA"]


def test_a_folder_of_another_version_is_refused_whatever_table_it_has(tmp_path):
    folder = tmp_path / "arm"
    folder.mkdir()
    refuse_other_columns(folder, ["seed", "view"])
    (folder / "registrations-1.csv").touch()
    pd.DataFrame({"seed": [0], "view": ["PA"]}).to_parquet(tmp_path / "registrations.parquet")
    refuse_other_columns(folder, ["view", "seed"])
    with pytest.raises(RegtorchError, match=r"registrations\.parquet: no column 'reasons', begun by another version"):
        refuse_other_columns(folder, ["seed", "view", "reasons"])
    append(folder / "registrations-1.csv", {"seed": 0, "view": "PA"})
    with pytest.raises(RegtorchError, match=r"registrations-1\.csv: no column 'reasons', begun by another version"):
        refuse_other_columns(folder, ["seed", "view", "reasons"])


def test_a_table_of_another_study_is_not_counted(tmp_path):
    append(tmp_path / "registrations.csv", {"seed": 0})
    with pytest.raises(RegtorchError, match="no column 'view', expected a table of this study"):
        done(tmp_path, ["view", "seed"])
