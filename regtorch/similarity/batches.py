"""Any batch of moving images, a bounded number of pixels at a time."""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.batches import at_once
from regtorch.errors import RegtorchError


def over_images(
    values: Callable[[Float[Tensor, "n h w"]], Float[Tensor, "n ..."]],
    moving: Float[Tensor, "*b h w"],
    fixed: Tensor,
    weight: Tensor | None,
) -> Float[Tensor, "..."]:
    """``values`` of every moving image, with the batch shape put back; checks that all images have one shape."""
    h, w = moving.shape[-2:]
    for name, image in (("fixed image", fixed), ("weight", weight)):
        if image is not None and image.shape != (h, w):
            raise RegtorchError(f"{name} of shape {tuple(image.shape)}: expected {(h, w)}, that of the moving images")
    chunks = moving.reshape(-1, h, w).split(at_once(h * w, moving.device.type))
    results = [values(chunk) for chunk in chunks]
    joined = results[0] if len(results) == 1 else torch.cat(results)
    return joined.reshape((*moving.shape[:-2], *joined.shape[1:]))
