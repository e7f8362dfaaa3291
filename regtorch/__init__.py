"""regtorch: registers one uncalibrated radiograph to one CT, nine degrees of freedom.

The names below are loaded when first used, so that ``import regtorch`` alone costs nothing.
"""

from importlib import import_module
from typing import Any

from regtorch.kernel_cache import forget_stale_kernels

__version__ = "0.1.0"

_HOME = {
    "Detector": "regtorch.geometry",
    "Radiograph": "regtorch.imaging",
    "Registration": "regtorch.registration",
    "RegtorchError": "regtorch.errors",
    "Volume": "regtorch.imaging",
    "attenuation": "regtorch.imaging",
    "evaluate": "regtorch.evaluation",
    "make_phantom": "regtorch.phantom",
    "read_radiograph": "regtorch.formats",
    "read_volume": "regtorch.formats",
    "register": "regtorch.registration",
    "render": "regtorch.drr",
    "render_with_jacobian": "regtorch.drr",
    "simulate": "regtorch.simulation",
}

__all__ = ["__version__", *_HOME]

forget_stale_kernels()


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'regtorch' has no attribute '{name}'")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return __all__
