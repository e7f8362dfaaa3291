"""Where the beam fell: the rectangle that collimators leave, found only where it shows beyond doubt."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d, avg_pool1d, pad

Box = tuple[int, int, int, int]
"""First and last + 1 row, first and last + 1 column."""

_COARSE = 256
"""Longer side, in pixels, at which collimator edges are looked for: noise is gone, half shadows are narrow."""
_SHORTEST = 128
"""Shorter side below which a diaphragm or a bone's shaft may pass for a straight edge."""
_DEEPEST = 0.45
"""How far in a collimator may reach, as a share of the image."""
_TILT = 5
"""Pixels by which an edge may rise or fall from one end to the other: about one degree."""
_APART = 6
"""Pixels to lines on both sides, across which brightness must fall less than across an edge."""
_SHARES = (0.45, 0.45, 0.85, 0.85)
"""Of an edge where it must be one, in turn: an edge shows within the field that the other three leave, so that all are
first guessed, and then each must hold."""
_WEAKEST = 0.1
"""Mean drop of an edge, as a share of the grey range: that of a patient table's shadow is up to 0.09."""
_LEAST_RANGE = 0.06
"""Of the remaining field, as a share of the whole image's: the field must show anatomy, and air shows none."""
_MOST_STRUCTURE = 1.5
"""Beyond an edge, of that in the field: up to 1.2 with collimators, from noise; 14 where a straight spine is cut."""
_NEARLY_ALL = 0.2
"""The quantile beyond an edge that is brighter than the field beside it: air further out is not."""
_TRIED = 20
"""Lines, the likeliest first."""
_LETTERS = 0.1
"""Of the field's own share of a row or column, below which it is not the field that is seen beside a shutter."""


def exposed_field(image: Float[Tensor, "h w"]) -> Box:
    """The exposed rectangle of a bone-bright image; all of it where no collimator is seen.

    Lead keeps the beam away, but not the patient's scatter: along the whole straight edge the image falls from
    brighter, out to the border, more steeply than beside it, which anatomy hardly ever does. Dark borders are air and
    stay, unless they are one constant around a filled rectangle, which is a shutter burnt in.
    """
    r0, r1, c0, c1 = box = _burnt_in(image)
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
    sides = [_Side.of(turned) for turned in (coarse, coarse.flip(0), coarse.mT, coarse.mT.flip(0))]
    depths = [0, 0, 0, 0]
    for share in _SHARES:
        for number, side in enumerate(sides):
            ends = depths[2:] if number < 2 else depths[:2]
            depths[number] = side.depth(share, opposite=depths[number ^ 1], ends=ends)
    scale = rows / shape[0], columns / shape[1]
    top, bottom, left, right = (round(depth * scale[number // 2]) for number, depth in enumerate(depths))
    return r0 + top, r1 - bottom, c0 + left, c1 - right


@dataclass(frozen=True)
class _Side:
    """An image turned so that one of its sides is on top, and its lines as edges of a collimator there.

    Line r of a tilt is ``shift`` pixels below row r. ``drop`` is the fall of the image across a line, from two pixels
    well above it to two well below. ``steepest`` says whether it falls less across the lines ``_APART`` above and
    below.
    """

    image: Float[Tensor, "h w"]
    shift: Int[Tensor, "tilts w"]
    drop: Float[Tensor, "tilts lines w"]
    steepest: Bool[Tensor, "tilts lines w"]

    @classmethod
    def of(cls, image: Float[Tensor, "h w"]) -> "_Side":
        rows, along = image.shape
        padded = pad(image[None], (0, 0, 2, 2), mode="replicate")[0]
        pairs = (padded[1:] + padded[:-1]) / 2
        drop = _smooth(pairs[: rows - 1] - pairs[4 : rows + 3], 5)
        beside = pad(drop[None], (0, 0, _APART, _APART), mode="replicate")[0]
        steepest = (drop > 0) & (drop > beside[: rows - 1]) & (drop > beside[2 * _APART :])
        tilts = torch.arange(-_TILT, _TILT + 1)[:, None]
        shift = (tilts * torch.linspace(-0.5, 0.5, along)).round().long()
        lines = (torch.arange(int(rows * _DEEPEST))[:, None] + shift[:, None]).clamp(0, rows - 2)
        return cls(
            image, shift, *(each.expand(len(tilts), -1, -1).gather(1, lines) for each in (drop[None], steepest[None]))
        )

    def depth(self, share: float, *, opposite: int, ends: list[int]) -> int:
        """How far in the collimator reaches, 0 without one; the others reach in ``opposite`` and ``ends``."""
        rows, along = self.image.shape
        span = slice(ends[0], along - ends[1])
        drop, steepest = self.drop[:, 1 : rows - opposite - 10, span], self.steepest[:, 1 : rows - opposite - 10, span]
        shares = steepest.float().mean(2)
        strength = (drop * steepest).sum(2) / steepest.sum(2).clamp_min(1)
        straight = 1 - 0.01 * torch.arange(-_TILT, _TILT + 1)[:, None].abs()  # where two tilts do as well
        score = torch.where((shares > share) & (strength > _WEAKEST), straight * shares * strength, 0).flatten()
        for place in score.argsort(descending=True)[:_TRIED].tolist():
            if float(score[place]) > 0:
                tilt, line = divmod(place, drop.shape[1])
                if depth := self._field_begins(tilt, line + 1, rows - opposite, span, share):
                    return depth
        return 0

    def _field_begins(self, tilt: int, line: int, end: int, span: slice, share: float) -> int:
        """At which row, past the half shadow, if this line is a collimator's edge; else 0."""
        rows = len(self.image)
        below = (torch.arange(rows)[:, None] + self.shift[tilt]).clamp(0, rows - 1)
        image = self.image.gather(0, below)[:, span]
        outside, inside = image[:line], image[line + 3 : end]
        brighter = _smooth(outside, 5).quantile(_NEARLY_ALL, dim=0) > image[line + 2 : line + 4].mean(0)
        darkest, brightest = inside.quantile(torch.tensor([0.05, 0.95], dtype=inside.dtype)).tolist()
        if float(brighter.float().mean()) < share or brightest - darkest < _LEAST_RANGE:
            return 0
        if _structure(outside) > _MOST_STRUCTURE * _structure(inside):
            return 0
        row, drop = line + 3, float(self.drop[tilt, line, span].median())
        while row < line + 7 and float((image[row - 1] - image[row + 1]).median()) > 0.25 * drop:
            row += 1
        return row + int(self.shift[tilt].max())


def _structure(part: Float[Tensor, "across along"]) -> float:
    """Detail along an edge, coarser than noise."""
    return float((_smooth(part, 5) - _smooth(part, 17)).abs().median())


def _smooth(part: Float[Tensor, "across along"], width: int) -> Float[Tensor, "across along"]:
    """Mean of ``width`` pixels along."""
    return avg_pool1d(pad(part[:, None], (width // 2, width // 2), mode="replicate"), width, 1)[:, 0]


def _burnt_in(image: Float[Tensor, "h w"]) -> Box:
    """A shutter's inside, whatever letters there are on the shutter."""
    whole = (0, image.shape[0], 0, image.shape[1])
    corners = image[[0, 0, -1, -1], [0, -1, 0, -1]]
    if bool((corners != corners[0]).any()):
        return whole
    shares = [(image != corners[0]).float().mean(dim) for dim in (1, 0)]
    if not float(shares[0].max()) > 0:
        return whole
    rows, columns = ((share > _LETTERS * share.max()).nonzero().flatten() for share in shares)
    r0, r1, c0, c1 = int(rows[0]), int(rows[-1]) + 1, int(columns[0]), int(columns[-1]) + 1
    if (r1 - r0) * (c1 - c0) < 0.1 * image.numel():
        return whole
    # The field of a shutter differs plainly from it all along its four sides; the shadow of a CT's box does not.
    plain = (image - corners[0]).abs() > 0.05 * (image.max() - image.min())
    sides = plain[r0, c0:c1], plain[r1 - 1, c0:c1], plain[r0:r1, c0], plain[r0:r1, c1 - 1]
    filled = all(float(side.float().mean()) > 0.9 for side in sides)
    return (r0, r1, c0, c1) if filled else whole
