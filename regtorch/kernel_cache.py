"""Compiled kernels are kept beside their files; numba does not see when a kernel that they call has changed."""

import contextlib
import hashlib
from pathlib import Path

_STAMP = "kernels.sha256"


def forget_stale_kernels() -> None:
    """Remove kernels compiled from files named ``cpu``, or in folders of that name, when their sources have changed."""
    package = Path(__file__).parent
    sources = sorted([*package.rglob("cpu.py"), *package.rglob("cpu/*.py")])
    now = hashlib.sha256(b"".join(file.read_bytes() for file in sources)).hexdigest()
    stamp = package / "__pycache__" / _STAMP
    with contextlib.suppress(OSError):
        if stamp.read_text() == now:
            return
    for index in {index for file in sources for index in (file.parent / "__pycache__").glob("*.nbi")}:
        with contextlib.suppress(OSError):  # another process may be at it, too, or the folder may be read-only
            index.unlink()
    with contextlib.suppress(OSError):
        stamp.parent.mkdir(exist_ok=True)
        stamp.write_text(now)
