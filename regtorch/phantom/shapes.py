"""Solids as rows of numbers: elliptic capsules, slices, vertebral drums and triangles of some thickness, in LPS mm.

Everything anatomical is made of these four, so that one compiled loop (``raster.py``) paints it all. A row holds

    kind, carve | box: low xyz, high xyz | point | what the kind needs, in the order of its function

where ``carve`` = 1 takes the solid away from earlier ones, and the box bounds the solid.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float

CAPSULE, DRUM, TRIANGLE, SLICE = 0.0, 1.0, 2.0, 3.0
Numbers = float | int | Sequence | np.ndarray
Row = Float[np.ndarray, "28"]
Rows = Float[np.ndarray, "n 28"]


def _row(kind: float, carve: bool, low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"], *fields: Numbers) -> Row:
    row = np.zeros(28)
    values = np.concatenate([[kind, carve], low, high, *(np.ravel(f) for f in fields)])
    row[: len(values)] = values
    return row


def capsule(a: Numbers, b: Numbers, ra: Numbers, rb: Numbers, thin: Numbers = (0, 1, 0), *, carve: bool = False) -> Row:
    """Elliptic capsule from ``a`` to ``b`` (mm), one row.

    ``ra`` and ``rb`` are the radii at its ends: one number, or three (along the axis, wide, thin). ``thin`` is the
    direction of the third, made orthogonal to the axis. With ``a`` = ``b`` it is an ellipsoid whose axis is vertical.
    """
    a, b, thin = (np.asarray(v, float) for v in (a, b, thin))
    ra, rb = (np.broadcast_to(np.asarray(r, float), 3) for r in (ra, rb))
    length = float(np.linalg.norm(b - a))
    along = (b - a) / length if length > 1e-6 else np.array([0.0, 0.0, 1.0])
    thin = thin - (thin @ along) * along
    if np.linalg.norm(thin) < 1e-6:
        thin = np.cross(along, [1.0, 0.0, 0.0])
    thin = thin / np.linalg.norm(thin)
    frame = np.stack([along, np.cross(thin, along), thin])
    reach_a, reach_b = (np.linalg.norm(r[:, None] * frame, axis=0) for r in (ra, rb))
    low, high = np.minimum(a - reach_a, b - reach_b), np.maximum(a + reach_a, b + reach_b)
    return _row(CAPSULE, carve, low, high, a, frame, length, ra, rb)


def drum(
    centre: Numbers,
    frame: Float[np.ndarray, "3 3"],
    height: float | int,
    widths: Numbers,
    depths: Numbers,
    *,
    wedge: float | int = 0,
    waist: float | int = 0.1,
    dish: float | int = 1,
) -> Row:
    """Vertebral body, one row: kidney-shaped sections, a waist, dished endplates.

    ``frame`` has the vertebra's left, posterior and superior axes as rows; ``widths`` and ``depths`` (mm) are the lower
    and the upper endplate's. ``waist`` is the share of width lost at mid height. ``wedge`` is the slope (rise in mm per
    mm forward) by which either endplate opens to the front. ``dish`` is the depth in mm of the endplates' hollow.
    """
    centre = np.asarray(centre, float)
    a, b = np.asarray(widths, float) / 2, np.asarray(depths, float) / 2
    tall = height / 2 + abs(wedge) * b.max() + 1
    reach = np.abs(np.array([a.max(), b.max(), tall])[:, None] * frame).sum(0)
    return _row(DRUM, False, centre - reach, centre + reach, centre, frame, height, a, waist, b, wedge, dish)


def triangle(a: Numbers, b: Numbers, c: Numbers, radii: Numbers) -> Row:
    """Flat triangle rounded by three radii (half of its thickness in mm at each corner), one row."""
    corners, radii = np.stack([a, b, c]).astype(float), np.asarray(radii, float)
    reach = radii.max()
    return _row(TRIANGLE, False, corners.min(0) - reach, corners.max(0) + reach, corners, [0] * 4, radii)


def smooth(points: Numbers, pieces: int) -> Float[np.ndarray, "..."]:
    """Catmull-Rom spline along the first axis through every point, ``pieces`` steps from one to the next."""
    p = np.asarray(points, float)
    p = np.concatenate([2 * p[:1] - p[1:2], p, 2 * p[-1:] - p[-2:-1]])
    t = (np.arange(pieces) / pieces).reshape(1, -1, *[1] * (p.ndim - 1))
    p0, p1, p2, p3 = (p[i : len(p) - 3 + i, None] for i in range(4))
    curve = p1 + t / 2 * (p2 - p0 + t * (2 * p0 - 5 * p1 + 4 * p2 - p3 + t * (3 * (p1 - p2) + p3 - p0)))
    return np.concatenate([curve.reshape(-1, *p.shape[1:]), p[-2:-1]])


def tube(points: Numbers, radii: Numbers, thin: Numbers = (0, 1, 0)) -> Rows:
    """Capsules along a polyline: (n, 3) points, radii that broadcast to (n, 3), ``thin`` to (n, 3); n - 1 rows."""
    points = np.asarray(points, float)
    radii = np.asarray(radii, float)
    radii = np.broadcast_to(radii[:, None] if radii.ndim == 1 and len(radii) == len(points) else radii, points.shape)
    thin = np.broadcast_to(np.asarray(thin, float), points.shape)
    pairs = zip(points[:-1], points[1:], radii[:-1], radii[1:], thin[:-1], strict=True)
    return np.stack([capsule(*pair) for pair in pairs])


def loft(sections: Numbers, pieces: int = 5) -> Rows:
    """A stack of level elliptic sections, each (x, y, z, half width, half depth) in mm, smoothly joined.

    Its ends are cut at the nearest voxels.
    """
    s = smooth(sections, pieces)
    s = s[np.argsort(s[:, 2])]
    rows = []
    for a, b in pairwise(s):
        reach_a, reach_b = np.append(a[3:], 0), np.append(b[3:], 0)
        low, high = np.minimum(a[:3] - reach_a, b[:3] - reach_b), np.maximum(a[:3] + reach_a, b[:3] + reach_b)
        rows.append(_row(SLICE, False, low, high, a[:3], b[:3] - a[:3], [0] * 7, a[3:], b[3:]))
    return np.stack(rows)


def sheet(grid: Numbers, pieces: int = 4) -> Rows:
    """A curved plate through a grid (r, c, 4) of (x, y, z, half thickness) in mm, as triangles."""
    g = smooth(np.swapaxes(smooth(grid, pieces), 0, 1), pieces)
    quads = zip(*(q.reshape(-1, 4) for q in (g[:-1, :-1], g[1:, :-1], g[1:, 1:], g[:-1, 1:])), strict=True)
    halves = [half for p, q, r, s in quads for half in ((p, q, r), (p, r, s))]
    return np.stack([triangle(*(corner[:3] for corner in h), [corner[3] for corner in h]) for h in halves])


def side_of(points: Numbers, side: int) -> Float[np.ndarray, "*shape"]:
    """Points given for the patient's left (side 1), or their mirror image on the right (side -1)."""
    points = np.array(points, float)
    points[..., 0] *= side
    return points
