"""Paints solids into a volume: distances in the solid's own box, soft edges, a shell about a core, a little texture."""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Float
from numba import njit

_FAR = 1e3
_CELL_MM = 4.0
_LATTICE = 61  # cells: the texture repeats after 244 mm, which no multiple of a vertebra's height meets


@dataclass(frozen=True)
class Part:
    """One structure: solids (``shapes.py``), its filling (HU), and how it is painted over earlier parts.

    ``shell_hu`` fills the outer ``shell_mm``; ``texture_hu`` is the largest deviation of the core; ``blend_mm`` is the
    distance over which solids of this part melt into each other.
    """

    shapes: Float[np.ndarray, "n 28"]
    core_hu: float | int
    shell_hu: float | int = 0
    shell_mm: float | int = 0
    texture_hu: float | int = 0
    blend_mm: float | int = 0


def texture(seed: int) -> Float[np.ndarray, "n n n"]:
    """Periodic noise on a lattice, of wavelengths over about 10 mm, within -1 to 1."""
    noise = np.random.default_rng(seed).normal(size=(_LATTICE,) * 3)
    k = np.fft.fftfreq(_LATTICE, _CELL_MM)
    k2 = k[:, None, None] ** 2 + k[:, None] ** 2 + k**2
    noise = np.fft.ifftn(np.fft.fftn(noise) * np.exp(-k2 / (2 * 0.06**2)) * (k2 < 0.1**2)).real
    return (noise / np.abs(noise).max()).astype(np.float32)


def paint(
    volume: Float[np.ndarray, "d h w"],
    origin: Float[np.ndarray, "3"],
    spacing: float,
    parts: Sequence[Part],
    seed: int,
) -> None:
    """Paints ``parts`` in their order into ``volume`` [z, y, x] in HU; ``origin`` (x, y, z) is its first voxel in mm.

    Slabs are painted independently of each other, so the result does not depend on how many threads there are.
    """
    lattice = texture(seed)
    thick = max(8, round(32 / spacing))

    def paint_slab(k0: int) -> None:
        slab = volume[k0 : k0 + thick]
        for part in parts:
            _paint_part(slab, origin + np.array([0, 0, k0 * spacing]), spacing, part, lattice)

    with ThreadPoolExecutor(min(8, os.cpu_count() or 1)) as pool:
        list(pool.map(paint_slab, range(0, len(volume), thick)))


def _paint_part(slab, origin, spacing, part, lattice) -> None:
    margin = spacing + part.blend_mm
    low, high = part.shapes[:, 2:5].min(0) - margin, part.shapes[:, 5:8].max(0) + margin
    first = np.maximum(np.ceil((low - origin) / spacing), 0).astype(int)
    last = np.minimum(np.floor((high - origin) / spacing) + 1, slab.shape[::-1]).astype(int)
    if (last <= first).any():
        return
    view = slab[first[2] : last[2], first[1] : last[1], first[0] : last[0]]
    start = origin + first * spacing
    distance = np.full(view.shape, _FAR, np.float32)
    _measure(distance, start, spacing, part.shapes, part.blend_mm)
    _fill(view, distance, start, spacing, part.core_hu, part.shell_hu, part.shell_mm, part.texture_hu, lattice)


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _capsule(s, x, y, z):
    q0 = s[11] * x + s[12] * y + s[13] * z
    q1 = s[14] * x + s[15] * y + s[16] * z
    q2 = s[17] * x + s[18] * y + s[19] * z
    t = min(max(q0 / s[20], 0.0), 1.0) if s[20] > 0 else 0.0
    q0 -= t * s[20]
    r0, r1, r2 = s[21] + t * (s[24] - s[21]), s[22] + t * (s[25] - s[22]), s[23] + t * (s[26] - s[23])
    u0, u1, u2 = (q0 / r0) ** 2, (q1 / r1) ** 2, (q2 / r2) ** 2
    # First order: distance to the ellipsoid |q / r| = 1 is (|q / r| - 1) / |gradient|.
    level = np.sqrt(u0 + u1 + u2)
    steep = np.sqrt(u0 / r0**2 + u1 / r1**2 + u2 / r2**2) / max(level, 1e-9)
    return (level - 1) / max(steep, 1e-9)


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _slice(s, x, y, z):
    tall = s[13]
    t = min(max(z / tall, 0.0), 1.0)
    x, y = x - t * s[11], y - t * s[12]
    a, b = s[21] + t * (s[23] - s[21]), s[22] + t * (s[24] - s[22])
    u0, u1 = (x / a) ** 2, (y / b) ** 2
    level = np.sqrt(u0 + u1)
    side = (level - 1) / max(np.sqrt(u0 / a**2 + u1 / b**2) / max(level, 1e-9), 1e-9)
    return max(side, -z, z - tall) if z < 0 or z > tall else side


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _drum(s, x, y, z):
    left = s[11] * x + s[12] * y + s[13] * z
    back = s[14] * x + s[15] * y + s[16] * z
    up = s[17] * x + s[18] * y + s[19] * z
    half = s[20] / 2
    v = min(max(up / half, -1.0), 1.0)
    narrow = 1 - s[23] * (1 - v * v)
    a = (s[21] + (s[22] - s[21]) * (v + 1) / 2) * narrow
    b = (s[24] + (s[25] - s[24]) * (v + 1) / 2) * narrow
    if back > 0:  # the hollow back of the body, towards the canal
        back += 0.15 * b * max(0.0, 1 - (left / a) ** 2)
    u0, u1 = (left / a) ** 2, (back / b) ** 2
    level = np.sqrt(u0 + u1)
    side = (level - 1) / max(np.sqrt(u0 / a**2 + u1 / b**2) / max(level, 1e-9), 1e-9)
    rim = half - s[26] * back - s[27] * max(0.0, 1 - level * level)
    end = abs(up) - rim
    blend = max(2.0 - abs(side - end), 0.0)
    return max(side, end) + blend * blend / 8


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _triangle(s, x, y, z):
    # Coordinates are about the first corner; e1, e2 lead from it to the others. Ericson, Real-Time Collision
    # Detection, 2005, 5.1.5: the nearest point is inside, on an edge, or a corner.
    e1x, e1y, e1z = s[11] - s[8], s[12] - s[9], s[13] - s[10]
    e2x, e2y, e2z = s[14] - s[8], s[15] - s[9], s[16] - s[10]
    d11, d12, d22 = e1x * e1x + e1y * e1y + e1z * e1z, e1x * e2x + e1y * e2y + e1z * e2z, e2x**2 + e2y**2 + e2z**2
    p1, p2 = x * e1x + y * e1y + z * e1z, x * e2x + y * e2y + z * e2z
    area = max(d11 * d22 - d12 * d12, 1e-12)
    v, w = (d22 * p1 - d12 * p2) / area, (d11 * p2 - d12 * p1) / area
    if v < 0 or w < 0 or v + w > 1:
        best = 1e30
        for edge in range(3):
            if edge == 0:
                v_, w_ = min(max(p1 / d11, 0.0), 1.0), 0.0
            elif edge == 1:
                v_, w_ = 0.0, min(max(p2 / d22, 0.0), 1.0)
            else:
                w_ = min(max((d11 - d12 - p1 + p2) / max(d11 - 2 * d12 + d22, 1e-12), 0.0), 1.0)
                v_ = 1 - w_
            far = (x - v_ * e1x - w_ * e2x) ** 2 + (y - v_ * e1y - w_ * e2y) ** 2 + (z - v_ * e1z - w_ * e2z) ** 2
            if far < best:
                best, v, w = far, v_, w_
    far = (x - v * e1x - w * e2x) ** 2 + (y - v * e1y - w * e2y) ** 2 + (z - v * e1z - w * e2z) ** 2
    return np.sqrt(far) - (s[21] * (1 - v - w) + s[22] * v + s[23] * w)


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _measure(distance, origin, spacing, shapes, blend):
    """Signed distance (mm, negative inside) to the union of ``shapes`` less the carving ones, near its surface."""
    nz, ny, nx = distance.shape
    margin = spacing + blend
    for n in range(len(shapes)):
        s = shapes[n]
        i0, i1 = _span(s[2], s[5], origin[0], spacing, margin, nx)
        j0, j1 = _span(s[3], s[6], origin[1], spacing, margin, ny)
        k0, k1 = _span(s[4], s[7], origin[2], spacing, margin, nz)
        for k in range(k0, k1):
            z = origin[2] + k * spacing - s[10]
            for j in range(j0, j1):
                y = origin[1] + j * spacing - s[9]
                for i in range(i0, i1):
                    x = origin[0] + i * spacing - s[8]
                    if s[0] == 0:
                        d = _capsule(s, x, y, z)
                    elif s[0] == 1:
                        d = _drum(s, x, y, z)
                    elif s[0] == 2:
                        d = _triangle(s, x, y, z)
                    else:
                        d = _slice(s, x, y, z)
                    old = distance[k, j, i]
                    if s[1] > 0:
                        distance[k, j, i] = max(old, -d)
                    elif s[0] == 2:  # neighbours in a sheet would swell along their common edge if they melted
                        distance[k, j, i] = min(old, d)
                    else:
                        near = max(blend - abs(old - d), 0.0)
                        distance[k, j, i] = min(old, d) - (near * near / (4 * blend) if near > 0 else 0.0)


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _span(low, high, origin, spacing, margin, n):
    first = int(np.ceil((low - margin - origin) / spacing))
    last = int(np.floor((high + margin - origin) / spacing)) + 1
    return max(first, 0), min(last, n)


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _fill(volume, distance, origin, spacing, core, shell, thickness, amplitude, lattice):
    """Replaces earlier values by shell and core, in the share of each voxel that they cover."""
    nz, ny, nx = volume.shape
    for k in range(nz):
        z0, z1, z = _cell(origin[2] + k * spacing)
        for j in range(ny):
            y0, y1, y = _cell(origin[1] + j * spacing)
            a, b, c, e = lattice[z0, y0], lattice[z0, y1], lattice[z1, y0], lattice[z1, y1]
            for i in range(nx):
                d = distance[k, j, i]
                outer = min(max(0.5 - d / spacing, 0.0), 1.0)
                if outer == 0:
                    continue
                inner = min(max(0.5 - (d + thickness) / spacing, 0.0), 1.0)
                value = core
                if amplitude > 0 and inner > 0:
                    x0, x1, x = _cell(origin[0] + i * spacing)
                    below = (a[x0] * (1 - x) + a[x1] * x) * (1 - y) + (b[x0] * (1 - x) + b[x1] * x) * y
                    above = (c[x0] * (1 - x) + c[x1] * x) * (1 - y) + (e[x0] * (1 - x) + e[x1] * x) * y
                    value += amplitude * (below * (1 - z) + above * z)
                volume[k, j, i] = volume[k, j, i] * (1 - outer) + shell * (outer - inner) + value * inner


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _cell(position):
    """The lattice points before and after a position in mm, and how far it is from the one to the other."""
    place = position / _CELL_MM + 100 * _LATTICE  # positive, so that int() rounds down
    first = int(place)
    return first % _LATTICE, (first + 1) % _LATTICE, place - first
