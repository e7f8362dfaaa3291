"""Output folders are written whole or not at all."""

from pathlib import Path

import pytest

from regtorch.errors import RegtorchError
from regtorch.files import output_folder, write_text


def _contents(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def _write_and_fail(out: Path, error: type[BaseException]) -> None:
    with output_folder(out) as folder:
        (folder / "result.json").write_text("new")
        raise error


def test_files_are_moved_to_the_folder_when_all_went_well(tmp_path):
    out = tmp_path / "a" / "b"
    with output_folder(out) as folder:
        (folder / "result.json").write_text("1")
        (folder / "overlay.png").write_text("2")
        assert not (out / "result.json").exists(), "not before the end"
    assert _contents(tmp_path) == ["a", "a/b", "a/b/overlay.png", "a/b/result.json"]


def test_nothing_stays_behind_when_something_went_wrong(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        _write_and_fail(tmp_path / "a" / "b", KeyboardInterrupt)
    assert _contents(tmp_path) == []


def test_a_folder_that_was_there_keeps_its_files_when_something_went_wrong(tmp_path):
    (tmp_path / "result.json").write_text("old")
    with pytest.raises(ZeroDivisionError):
        _write_and_fail(tmp_path, ZeroDivisionError)
    assert _contents(tmp_path) == ["result.json"]
    assert (tmp_path / "result.json").read_text() == "old"


def test_old_files_are_replaced_and_others_left(tmp_path):
    (tmp_path / "result.json").write_text("old")
    (tmp_path / "notes.txt").write_text("mine")
    with output_folder(tmp_path) as folder:
        (folder / "result.json").write_text("new")
    assert _contents(tmp_path) == ["notes.txt", "result.json"]
    assert (tmp_path / "result.json").read_text() == "new"
    assert (tmp_path / "notes.txt").read_text() == "mine"


@pytest.mark.parametrize("below", ["", "deeper", "deeper/still"])
def test_a_path_under_a_file_is_refused_at_once(tmp_path, below):
    file = tmp_path / "file"
    file.write_text("a file")
    path = file / below
    with pytest.raises(RegtorchError, match="expected a folder to write to") as caught, output_folder(path):
        pytest.fail("the block was entered")
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert _contents(tmp_path) == ["file"]
    assert file.read_text() == "a file"


def test_texts_are_written_whole_and_only_to_ordinary_files(tmp_path):
    write_text(tmp_path / "a.json", "old")
    write_text(tmp_path / "a.json", "new")
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("a.json", "new")]
    with pytest.raises(RegtorchError, match="no ordinary file"):
        write_text(tmp_path, "text")


def test_a_name_that_no_folder_can_have_is_refused_and_leaves_no_parents(tmp_path):
    path = tmp_path / "a" / ("b" * 300)
    with pytest.raises(RegtorchError, match="expected a folder to write to"), output_folder(path):
        pytest.fail("the block was entered")
    assert _contents(tmp_path) == []
