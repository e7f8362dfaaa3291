"""Compiled kernels are kept beside their files; numba does not see when a kernel that they call has changed."""

import contextlib
from pathlib import Path


def forget_stale_kernels() -> None:
    """Remove what was compiled from files named ``cpu``, or in folders of that name, before one of them changed."""
    package = Path(__file__).parent
    sources = [*package.rglob("cpu.py"), *package.rglob("cpu/*.py")]
    newest = max(file.stat().st_mtime for file in sources)
    folders = {file.parent / "__pycache__" for file in sources}
    with contextlib.suppress(OSError):  # another process may be at it, too, or the folder may be read-only
        for index in [index for folder in folders for index in folder.glob("*.nbi")]:
            if index.stat().st_mtime < newest:
                index.unlink()
