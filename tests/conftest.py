"""Shapes are checked by beartype in tests only; real CTs are found through REGTORCH_DATA."""

import os
from pathlib import Path

import pytest
from jaxtyping import install_import_hook

install_import_hook("regtorch", "beartype.beartype")


@pytest.fixture
def threads_kept():
    """Restores the number of threads after a test whose code changes it, as studies do."""
    import numba
    import torch

    before = torch.get_num_threads(), numba.get_num_threads()
    yield
    torch.set_num_threads(before[0])
    numba.set_num_threads(before[1])


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """The folder of real scans; a test that needs it is skipped where there is none."""
    folder = os.environ.get("REGTORCH_DATA", "")
    if not folder:
        pytest.skip("REGTORCH_DATA is not set: no real scans to test on")
    if not Path(folder).is_dir():
        pytest.fail(f"REGTORCH_DATA={folder} is not a folder")
    return Path(folder).resolve()
