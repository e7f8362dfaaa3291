"""The exposed field: the rectangle between the collimators, cut out only where it shows beyond doubt."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d, avg_pool1d, pad

Box = tuple[int, int, int, int]
"""First row, last row + 1, first column, last column + 1."""

_COARSE = 256
"""Longer side, in pixels, of the image in which edges are sought: noise averages out, half shadows are narrow."""
_SHORTEST = 128
"""Least shorter side, in pixels; in a narrower image a diaphragm or a bone's shaft may pass for a straight edge."""
_DEEPEST = 0.45
"""Greatest depth of a collimator, as a share of the image."""
_TILT = 5
"""Pixels by which an edge may rise or fall from one end to the other: about one degree."""
_APART = 6
"""Distance, in pixels, to the two parallel lines across which brightness must fall less than across an edge."""
_SHARES = (0.45, 0.45, 0.85, 0.85)
"""Share of its length along which a line must look like an edge, one value for each round over the four sides.

An edge shows only within the field that the other three edges leave. Early rounds guess, later rounds confirm."""
_WEAKEST = 0.1
"""Least mean drop across an edge, as a share of the grey range; the shadow of a patient table drops by up to 0.09."""
_LEAST_RANGE = 0.06
"""Least grey range inside the field, as a share of the whole image's; anatomy has it, air has not."""
_MOST_STRUCTURE = 1.5
"""Most structure outside an edge, relative to the field; noise behind collimators has 1.2, a cut straight spine 14."""
_NEARLY_ALL = 0.2
"""This quantile of the brightness outside an edge must exceed the inside next to the edge; air outside fails this."""
_TRIED = 20
"""Number of lines tried as an edge, the likeliest first."""
_LETTERS = 0.1
"""Rows and columns that differ from a shutter in less than this share of the field's maximum hold letters only."""


def exposed_field(image: Float[Tensor, "h w"]) -> Box:
    """The exposed rectangle of a bone-bright image, or the whole image where no collimator shows.

    Lead stops the beam but not the scatter from the patient. The image behind a collimator is brighter than the field,
    out to the border. Along the whole straight edge brightness falls more steeply than beside it, as it hardly ever
    does in anatomy. Dark borders are air and stay, except for a shutter burnt into the image: one constant value
    around a filled rectangle.
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
    """An image turned so that one side is on top, and its candidate lines for a collimator's edge on that side.

    Args:
        image: The turned image.
        shift: Pixels by which a tilted line r lies below row r, for each tilt and column.
        drop: Fall in brightness across a line, from two pixels above it to two below; the pixels beside it are left
            out.
        steepest: Whether brightness falls less across the lines ``_APART`` pixels above and below.
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
        """Depth of the collimator in pixels, 0 if there is none; ``opposite`` and ``ends`` are the others' depths."""
        rows, along = self.image.shape
        span = slice(ends[0], along - ends[1])
        drop, steepest = self.drop[:, 1 : rows - opposite - 10, span], self.steepest[:, 1 : rows - opposite - 10, span]
        shares = steepest.float().mean(2)
        strength = (drop * steepest).sum(2) / steepest.sum(2).clamp_min(1)
        straight = 1 - 0.01 * torch.arange(-_TILT, _TILT + 1)[:, None].abs()  # decides between equally good tilts
        score = torch.where((shares > share) & (strength > _WEAKEST), straight * shares * strength, 0).flatten()
        for place in score.argsort(descending=True)[:_TRIED].tolist():
            if float(score[place]) > 0:
                tilt, line = divmod(place, drop.shape[1])
                if depth := self._field_begins(tilt, line + 1, rows - opposite, span, share):
                    return depth
        return 0

    def _field_begins(self, tilt: int, line: int, end: int, span: slice, share: float) -> int:
        """Row at which the field begins, past the half shadow; 0 if this line is no collimator's edge."""
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
    """Strength of the detail along an edge that is coarser than noise."""
    return float((_smooth(part, 5) - _smooth(part, 17)).abs().median())


def _smooth(part: Float[Tensor, "across along"], width: int) -> Float[Tensor, "across along"]:
    """Running mean of ``width`` pixels along the edge."""
    return avg_pool1d(pad(part[:, None], (width // 2, width // 2), mode="replicate"), width, 1)[:, 0]


def _burnt_in(image: Float[Tensor, "h w"]) -> Box:
    """The inside of a burnt-in shutter, or the whole image; letters on the shutter do not matter."""
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
    # The field inside a shutter differs plainly from it along all four sides; the shadow of a CT's box does not.
    plain = (image - corners[0]).abs() > 0.05 * (image.max() - image.min())
    sides = plain[r0, c0:c1], plain[r1 - 1, c0:c1], plain[r0:r1, c0], plain[r0:r1, c1 - 1]
    filled = all(float(side.float().mean()) > 0.9 for side in sides)
    return (r0, r1, c0, c1) if filled else whole
