"""Output folders are written whole or not at all, and other files in them stay."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from regtorch.cli import main

from .commands import REGISTER, SIMULATE, disk, run


def test_a_folder_that_the_system_does_not_let_write_to(inputs, capfd):
    if not Path("/proc/self").exists():
        pytest.skip("no folder here that even root cannot write to")
    for command in (REGISTER, SIMULATE):
        arguments = command.replace("{o}/new/deep", "/proc/new").replace("{o}", "/proc")
        assert run(arguments.format(i=inputs)) == 2
        assert capfd.readouterr().err.startswith("regtorch: error: /proc/new: No such file or directory, expected")


def test_an_empty_name_is_not_the_current_folder(inputs, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    ct, image = f"{inputs}/ct.nii.gz", f"{inputs}/good/radiograph.tiff"
    assert main(["register", ct, image, "--view", "PA", "--out", ""]) == 2
    assert capfd.readouterr().err == "regtorch: error: empty name, expected a folder to write to\n"
    assert not list(tmp_path.iterdir())


def test_other_files_in_the_output_folder_stay(inputs, tmp_path, method):
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "result.json").write_text("of an earlier run")
    bad = f"register {inputs}/ct.nii.gz {inputs}/unsized.tiff --view PA --out {tmp_path}"
    before = disk(tmp_path)
    assert run(bad) == 2
    assert disk(tmp_path) == before
    assert (tmp_path / "result.json").read_text() == "of an earlier run"
    assert run(f"{bad} --pixel-mm 3.5") == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == ["notes.txt", "overlay.png", "result.json"]
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert json.loads((tmp_path / "result.json").read_text())["status"] == "ok"


def test_interrupting_ends_with_130_and_leaves_nothing(inputs, tmp_path, method, capfd):
    def interrupted(problem):
        raise KeyboardInterrupt

    method.search = interrupted
    assert run(REGISTER.format(i=inputs, o=tmp_path)) == 130
    assert capfd.readouterr().err.splitlines()[-1] == "regtorch: interrupted, nothing written"
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("asked", [signal.SIGINT, signal.SIGTERM], ids=["Ctrl-C", "timeout"])
def test_a_running_registration_that_is_ended_leaves_nothing(inputs, tmp_path, asked):
    # Whoever runs the tests in the background may have them ignore the signal.
    program = "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler)"
    program += "; from regtorch.cli import main; sys.exit(main(sys.argv[1:]))"
    arguments = REGISTER.format(i=inputs, o=tmp_path).split()
    with subprocess.Popen([sys.executable, "-c", program, *arguments], stderr=subprocess.PIPE, text=True) as process:
        while not (tmp_path / "new" / "deep").exists() and process.poll() is None:
            time.sleep(0.02)
        process.send_signal(asked)
        _, err = process.communicate(timeout=120)
    assert process.returncode == 130, err
    assert err.splitlines()[-1] == "regtorch: interrupted, nothing written"
    assert not list(tmp_path.iterdir())
