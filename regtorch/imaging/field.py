"""Where the beam fell: the rectangle that collimators leave, found only where it shows beyond doubt."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d, avg_pool1d, pad

Box = tuple[int, int, int, int]
"""First and last + 1 row, first and last + 1 column."""

_COARSE = 256
"""Longer side, in pixels, at which collimator edges are looked for: noise is gone, slightly turned edges still hold."""
_SHORTEST = 64
"""Shorter side below which a row of bone may pass for a straight edge."""
_WEAKEST = 0.1
"""Drop of an edge, as a share of the grey range, below which it is none."""
_DEEPEST = 0.45
"""How far in a collimator may reach, as a share of the image."""


def exposed_field(image: Float[Tensor, "h w"]) -> Box:
    """The exposed rectangle of a bone-bright image; all of it where no collimator is seen.

    Lead lets least through, so beyond a collimator's edge the image is brighter than nearly all anatomy, along the
    whole straight edge and out to the border. Dark borders are air and stay, unless they are one constant around a
    filled rectangle, which is a shutter burnt in.
    """
    box = _burnt_in(image)
    r0, r1, c0, c1 = box
    inner = image[r0:r1, c0:c1]
    rows, columns = inner.shape
    factor = max(1.0, max(rows, columns) / _COARSE)
    shape = (round(rows / factor), round(columns / factor))
    if min(shape) < _SHORTEST:
        return box
    coarse = adaptive_avg_pool2d(inner[None, None], shape)[0, 0]
    low, high = torch.quantile(coarse, torch.tensor([0.01, 0.99], dtype=coarse.dtype)).tolist()
    if high <= low:
        return box
    coarse = (coarse - low) / (high - low)
    found = [0, shape[0], 0, shape[1]]
    # An edge shows within the field that the other three leave: all are first guessed, then each must hold.
    for strict in (False, False, True, True):
        for side in range(4):
            found[side] = _edge(coarse, found, side, strict)
    scale = (rows / shape[0], columns / shape[1])
    return (
        r0 + round(found[0] * scale[0]),
        r0 + round(found[1] * scale[0]),
        c0 + round(found[2] * scale[1]),
        c0 + round(found[3] * scale[1]),
    )


def _edge(coarse: Float[Tensor, "h w"], box: list[int], side: int, strict: bool) -> int:
    """Where the box ends on one side (top, bottom, left, right): at the collimator, or where the image does."""
    r0, r1, c0, c1 = box
    part = coarse[:, c0:c1] if side < 2 else coarse[r0:r1].mT
    size = len(part)
    part = part.flip(0) if side % 2 else part
    end = (r1, size - r0, c1, size - c0)[side]
    last = min(int(size * _DEEPEST), end - 10)
    if last < 2:
        return size if side % 2 else 0
    # Strips of two pixels on either side of each edge and two pixels between them, which half shadows fill.
    outer = torch.stack([part[max(0, edge - 2) : edge].mean(0) for edge in range(1, last)])
    inner = torch.stack([part[edge + 2 : edge + 4].mean(0) for edge in range(1, last)])
    # Beyond the neighbouring collimators an edge does not show, as both its sides are bright.
    judged = torch.ones_like(inner, dtype=torch.bool) if strict else inner < 0.9
    strength = torch.where(judged, outer - inner, torch.nan).nanmedian(dim=1).values
    strength = torch.where(judged.float().mean(1) > 0.3, strength, 0)
    for row in strength.argsort(descending=True).tolist():
        drop = float(strength[row])
        if drop < _WEAKEST:
            break
        if _is_collimator(part[: row + 1], part[row + 3 : end], (outer - inner)[row], inner[row], judged[row]):
            # Past the half shadow, which may be wider than the strips are apart.
            best = row + 3
            while best < row + 7 and float((part[best - 1] - part[best + 1]).median()) > 0.25 * drop:
                best += 1
            return size - best if side % 2 else best
    return size if side % 2 else 0


def _is_collimator(
    outside: Float[Tensor, "out along"],
    inside: Float[Tensor, "in along"],
    drop: Float[Tensor, " along"],
    inner: Float[Tensor, " along"],
    judged: Bool[Tensor, " along"],
) -> bool:
    straight = float((drop > 0.02)[judged].float().mean())
    bright = float((outside.mean(0) > inner)[judged].float().mean())
    if min(straight, bright) < 0.85:
        return False
    darkest, brightest = inside.quantile(torch.tensor([0.05, 0.95], dtype=inside.dtype)).tolist()
    # What is left must be a radiograph: something bright and something dark, nothing brighter than lead.
    if brightest < max(0.5, darkest + 0.2) or float(outside.median()) < max(0.85, brightest - 0.02):
        return False
    return _roughness(outside) < 0.7 * _roughness(inside)


def _roughness(part: Float[Tensor, "across along"]) -> float:
    """Detail along an edge: anatomy has some, the shadow of lead next to none."""
    smooth = avg_pool1d(pad(part[:, None], (4, 4), mode="replicate"), 9, 1)[:, 0]
    return float((part - smooth).abs().mean())


def _burnt_in(image: Float[Tensor, "h w"]) -> Box:
    whole = (0, image.shape[0], 0, image.shape[1])
    corners = image[[0, 0, -1, -1], [0, -1, 0, -1]]
    if bool((corners != corners[0]).any()):
        return whole
    differs = image != corners[0]
    rows, columns = (differs.any(dim).nonzero().flatten() for dim in (1, 0))
    if not len(rows):
        return whole
    r0, r1, c0, c1 = int(rows[0]), int(rows[-1]) + 1, int(columns[0]), int(columns[-1]) + 1
    if (r1 - r0) * (c1 - c0) < 0.1 * image.numel():
        return whole
    # The field of a shutter differs plainly from it all along its four sides; the shadow of a CT's box does not.
    plain = (image - corners[0]).abs() > 0.05 * (image.max() - image.min())
    sides = plain[r0, c0:c1], plain[r1 - 1, c0:c1], plain[r0:r1, c0], plain[r0:r1, c1 - 1]
    filled = all(float(side.float().mean()) > 0.9 for side in sides)
    return (r0, r1, c0, c1) if filled else whole
