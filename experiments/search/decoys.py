"""Images that cannot be registered to the CT: a verdict should trust none."""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

Image = Float[Tensor, "h w"]


def patient(right: Image, other: Callable[[], Image], generator: torch.Generator) -> Image:
    """The radiograph of another CT."""
    return other()


def mirrored(right: Image, other: Callable[[], Image], generator: torch.Generator) -> Image:
    """Left for right, as a file seen from the wrong side."""
    return right.flip(1)


def upside_down(right: Image, other: Callable[[], Image], generator: torch.Generator) -> Image:
    """The last row first."""
    return right.flip(0)


def noise(right: Image, other: Callable[[], Image], generator: torch.Generator) -> Image:
    """Normal and white."""
    return torch.randn(right.shape, generator=generator)
