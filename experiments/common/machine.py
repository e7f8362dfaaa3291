"""The libraries and the processor that made a row: last digits depend on them."""

import platform
from functools import cache
from importlib.metadata import version
from pathlib import Path

LIBRARIES = ("torch", "numba", "numpy")
MACHINE = (*LIBRARIES, "processor")


@cache
def machine() -> dict[str, str]:
    """The columns ``MACHINE``: versions, and the processor's name."""
    return {name: version(name) for name in LIBRARIES} | {"processor": _processor(Path("/proc/cpuinfo"))}


def _processor(cpuinfo: Path) -> str:
    """The model that Linux tells; elsewhere Python's word for it."""
    lines = cpuinfo.read_text(encoding="utf-8").splitlines() if cpuinfo.is_file() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.processor() or platform.machine()
