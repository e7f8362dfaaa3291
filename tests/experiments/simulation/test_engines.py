"""Eight shards on any engine make the same table as one process, even if a worker is killed."""

import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
SHARDS = "shard=0/8,1/8,2/8,3/8,4/8,5/8,6/8,7/8"
JOBLIB = "hydra/launcher=joblib", "hydra.launcher.n_jobs=2"


def test_two_joblib_workers_make_the_same_table(run, undisturbed, rows, tmp_path):
    done = run("-m", f"out={tmp_path}", SHARDS, *JOBLIB)
    assert done.returncode == 0, done.stderr
    assert rows(tmp_path) == undisturbed
    assert len(list(tmp_path.glob("9-DOF/registrations-*.csv"))) == 8


@pytest.fixture(scope="module")
def slurm() -> Iterator[None]:
    """A SLURM cluster with this machine as its only node."""
    if os.geteuid() or not all(map(shutil.which, ("slurmctld", "slurmd", "sbatch", "munged"))):
        pytest.skip("needs root and Debian's slurmctld, slurmd, slurm-client and munge")
    script = Path(__file__).with_name("slurm.sh")
    with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        patch.setenv("SLURM_CONF", f"{folder}/slurm.conf")
        try:
            subprocess.run([script, "start", folder], check=True)
            yield
        finally:
            subprocess.run([script, "stop", folder], check=True)


@pytest.mark.slurm
def test_slurm_makes_the_same_table(slurm, run, undisturbed, rows, tmp_path):
    done = run("-m", f"out={tmp_path}", SHARDS, "hydra/launcher=submitit_slurm")
    assert done.returncode == 0, done.stderr
    assert rows(tmp_path) == undisturbed


@pytest.mark.slurm
def test_a_second_start_makes_up_for_a_killed_worker(slurm, command, run, undisturbed, rows, tmp_path):
    sweep = f"out={tmp_path}", SHARDS, "hydra/launcher=submitit_slurm"
    launcher = subprocess.Popen(command("-m", *sweep), cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        job = _first_without_a_row(launcher, tmp_path / "9-DOF")
        subprocess.run(["scancel", "--signal=KILL", "--full", job], check=True)
        while _jobs():
            time.sleep(0.2)
    finally:
        launcher.kill()  # which waits: without accounting, SLURM does not tell it that a job has died
        launcher.wait()
    assert set(rows(tmp_path)) < set(undisturbed)
    done = run("-m", *sweep)
    assert done.returncode == 0, done.stderr
    assert rows(tmp_path) == undisturbed


def _first_without_a_row(launcher: subprocess.Popen, arm: Path) -> str:
    """Names of the running jobs, NUMBER_SHARD."""
    while launcher.poll() is None:
        for job in _jobs("--states=RUNNING"):
            if not (arm / f"registrations-{job.partition('_')[2]}.csv").exists():
                return job
        time.sleep(0.1)
    pytest.fail("no job ran")


def _jobs(*which: str) -> list[str]:
    listed = subprocess.run(["squeue", "--noheader", "--format=%i", *which], capture_output=True, text=True, check=True)
    return listed.stdout.split()
