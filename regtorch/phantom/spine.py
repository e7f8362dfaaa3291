"""The spine: C7 to L5, sacrum and coccyx, each vertebra with its own size, tilt and irregularities."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from regtorch.phantom.raster import Part
from regtorch.phantom.shapes import capsule, drum, sheet

# Heights, widths and depths of bodies, pedicles, canals and processes are rounded after Panjabi et al., Spine 16
# (1991) 861 and 888 (cervical, thoracic) and 17 (1992) 299 (lumbar); discs after Gilad and Nissan, Spine 11 (1986)
# 154; tilts make a thoracic kyphosis of 38 degrees, a lumbar lordosis of 55 and a sacral slope of 38, within the
# normal range of Vialle et al., J Bone Joint Surg Am 87 (2005) 260.
_COLUMNS = "height upper_width lower_width upper_depth lower_depth disc tilt wedge pedicle_width pedicle_height " \
    "canal_width canal_depth transverse_width spinous_length spinous_drop"  # fmt: skip
# mm; disc is the one below; tilt is of the body's axis, forward, and wedge how far the endplates open to the front,
# in degrees; spinous_drop is the angle of the spinous process below the body's horizontal.
_TABLE = """
C7  13.0 22.5 24.0 17.0 17.5  5.0  24  -1   6.5  7.5 24.5 15.0 66  33 22
T1  14.5 25.0 27.5 18.0 19.5  4.5  23  -2   8.2  9.6 21.8 16.2 75  34 22
T2  15.8 25.0 27.0 19.5 21.5  4.3  20  -3   7.6 11.4 19.5 15.8 70  34 28
T3  15.9 24.6 26.0 22.0 23.0  4.0  17  -3   6.4 11.9 18.3 16.0 64  34 35
T4  16.4 24.5 26.0 23.0 24.5  4.0  13  -4   5.0 12.1 17.0 16.2 62  35 43
T5  16.8 25.0 27.0 24.3 25.5  4.0   9  -4   5.4 11.9 17.2 16.4 63  37 50
T6  17.7 26.2 28.2 26.0 27.0  4.4   5  -4   5.8 12.2 17.3 16.5 62  38 55
T7  18.5 27.8 29.0 27.4 28.5  4.6   1  -4   6.0 12.1 17.3 16.3 61  38 57
T8  19.0 29.5 30.5 28.0 29.0  4.8  -3  -3   6.7 12.5 17.7 16.1 60  37 55
T9  19.6 30.5 33.0 29.0 31.0  5.2  -6  -2   7.7 13.9 17.9 15.9 59  34 48
T10 20.5 32.0 35.5 30.5 31.5  5.8  -9  -2   9.0 14.9 18.2 15.7 57  31 40
T11 21.6 35.0 39.0 31.8 32.0  6.6 -12  -2   9.6 17.0 19.5 16.2 51  27 27
T12 23.0 39.0 42.0 32.6 33.2  7.4 -15  -1   8.8 16.5 22.2 18.0 46  26 16
L1  24.3 41.2 43.3 34.0 35.0  7.6 -17  -1   8.6 15.9 23.5 19.0 71  30 10
L2  25.0 42.6 45.5 34.5 35.0  8.4 -13   1   8.8 15.0 23.8 18.2 77  31  8
L3  25.0 44.1 48.0 35.0 34.8  9.2  -6   3  10.2 14.6 24.3 17.6 87  32  6
L4  24.8 46.6 49.5 35.3 34.2 10.0   4   5  13.5 15.4 25.4 18.4 80  28  8
L5  24.0 48.0 49.5 34.8 33.4  9.6  18   9  17.0 18.5 27.0 19.2 92  22 14
"""
# Sacral and coccygeal segments; discs are all but gone, and what is behind the bodies is built by `_sacrum`.
_SACRAL = """
S1  29.0 50.0 38.0 32.0 24.0  1.5  40   0
S2  24.0 38.0 31.0 23.0 18.0  1.2  41   0
S3  20.0 31.0 27.0 17.0 13.0  1.0  28   0
S4  17.0 27.0 24.0 12.5 10.0  1.0   8   0
S5  14.0 24.0 19.0 10.0  8.0  2.0 -14   0
Co1  9.0 16.0 12.0  7.5  6.5  1.5 -30   0
Co2  8.0 11.0  8.0  6.5  5.5  1.0 -42   0
Co3  7.0  8.0  5.0  5.0  4.0  0.0 -50   0
"""
_S1_TOP = np.array([0.0, 22.0, 0.0])  # the middle of the sacral endplate, LPS mm


@dataclass(frozen=True)
class Vertebra:
    """Sizes (mm, degrees, named as in the table) and place: ``centre`` of the body in LPS mm, axes as rows."""

    name: str
    size: dict[str, float]
    centre: NDArray[np.float64]
    frame: NDArray[np.float64]

    def at(self, left: float, back: float, up: float) -> NDArray[np.float64]:
        """LPS mm of a point given in mm along the vertebra's own axes, from the centre of its body."""
        return self.centre + np.array([left, back, up]) @ self.frame

    @property
    def body_back(self) -> float:
        return (self.size["upper_depth"] + self.size["lower_depth"]) / 4


def spine(rng: np.random.Generator) -> dict[str, Vertebra]:
    """Vertebrae by name, C7 to Co3, stacked upwards and downwards from the sacral endplate."""
    names, sizes = zip(*(_read(line) for line in (_TABLE + _SACRAL).split("\n") if line), strict=True)
    sizes = [_vary(size, rng) for size in sizes]
    # A slight double scoliosis, and nobody's vertebrae face quite the same way: degrees.
    height = np.linspace(1, 0, len(sizes))
    roll = 2.6 * np.sin(2 * np.pi * (height * 1.5 - 0.35)) + rng.normal(0, 0.7, len(sizes))
    turn = 2.0 * np.sin(2 * np.pi * (height * 1.5 - 0.3)) + rng.normal(0, 1.0, len(sizes))
    frames = [_frame(s["tilt"], r, t) for s, r, t in zip(sizes, roll, turn, strict=True)]
    s1 = names.index("S1")
    centres = [np.zeros(3) for _ in sizes]
    centres[s1] = _S1_TOP - frames[s1][2] * sizes[s1]["height"] / 2
    for lower in range(s1, 0, -1):
        centres[lower - 1] = centres[lower] + _step(lower - 1, sizes, frames)
    for upper in range(s1, len(sizes) - 1):
        centres[upper + 1] = centres[upper] - _step(upper, sizes, frames)
    return {n: Vertebra(n, s, c, f) for n, s, c, f in zip(names, sizes, centres, frames, strict=True)}


def _read(line: str) -> tuple[str, dict[str, float]]:
    name, *values = line.split()
    return name, dict(zip(_COLUMNS.split(), map(float, values), strict=False))


def _vary(size: dict[str, float], rng: np.random.Generator) -> dict[str, float]:
    """Sizes with a deviation of some 2 %, as between neighbours of one person; tilts with one of 0.7 degrees."""
    angles = ("tilt", "wedge", "spinous_drop")
    return {k: v + rng.normal(0, 0.7) if k in angles else v * (1 + rng.normal(0, 0.02)) for k, v in size.items()}


def _frame(tilt: float, roll: float, turn: float) -> NDArray[np.float64]:
    """Left, posterior and superior axis as rows, for degrees of tilt forward, to the left, and turn about the axis."""
    a, b, c = np.radians([tilt, roll, turn])
    about_x = np.array([[1, 0, 0], [0, np.cos(a), np.sin(a)], [0, -np.sin(a), np.cos(a)]])
    about_y = np.array([[np.cos(b), 0, -np.sin(b)], [0, 1, 0], [np.sin(b), 0, np.cos(b)]])
    about_z = np.array([[np.cos(c), np.sin(c), 0], [-np.sin(c), np.cos(c), 0], [0, 0, 1]])
    return about_z @ about_x @ about_y


def _step(upper: int, sizes: list[dict[str, float]], frames: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """From the centre of the body below to that of body number ``upper``."""
    up, down = frames[upper][2], frames[upper + 1][2]
    across = (up + down) / np.linalg.norm(up + down)
    return up * sizes[upper]["height"] / 2 + across * sizes[upper]["disc"] + down * sizes[upper + 1]["height"] / 2


def spine_parts(vertebrae: dict[str, Vertebra], rng: np.random.Generator) -> list[Part]:
    """One part for each of C7 to L5, one for sacrum and coccyx."""
    presacral = [v for name, v in vertebrae.items() if name[0] in "CTL" and name[:2] != "Co"]
    parts = [Part(_vertebra(v, rng), rng.normal(245, 15), rng.normal(920, 40), 1.2, 75, 1.5) for v in presacral]
    return [*parts, Part(_sacrum(vertebrae), 190, 720, 0.9, 60, 3.0)]


def _body(v: Vertebra) -> NDArray[np.float64]:
    s = v.size
    widths, depths = (s["lower_width"], s["upper_width"]), (s["lower_depth"], s["upper_depth"])
    return drum(v.centre, v.frame, s["height"], widths, depths, wedge=np.tan(np.radians(s["wedge"]) / 2))


def _vertebra(v: Vertebra, rng: np.random.Generator) -> NDArray[np.float64]:
    """Body, pedicles, facets, transverse processes, laminae and spinous process."""
    s, lumbar = v.size, v.name[0] == "L"
    half, back = s["height"] / 2, v.body_back
    wide, tall = s["pedicle_width"] / 2, s["pedicle_height"] / 2
    pillar = back + 0.8 * s["canal_depth"]  # where pedicle, facets, transverse process and lamina meet
    arch = back + s["canal_depth"] + 3
    high = half - tall + (0.5 if lumbar else 1.5)
    rows = [_body(v)]
    for side in (-1, 1):
        x = side * (s["canal_width"] / 2 + wide)
        inner, outer = (0.72 * x, x + side * 3) if lumbar else (0.75 * x, x)
        facet = (5, 5, 8) if lumbar else (4, 6, 3)  # sagittal and stout, or coronal and thin
        reach = side * s["transverse_width"] / 2 * (1 + rng.normal(0, 0.03))
        rows += [
            capsule(v.at(x, back - 4, high), v.at(x, pillar, high), (2, wide, tall), (2, wide, tall), v.frame[2]),
            capsule(v.at(outer, pillar - 1, high), v.at(outer, pillar + 1, half + 0.6 * tall), facet, facet, v.frame[1]),
            capsule(v.at(x, pillar, high), v.at(inner, arch + 1, -half - 0.3 * tall - s["disc"] / 2), (3, 4, 3.5),
                    facet, v.frame[1]),
            capsule(v.at(0.85 * x, pillar + 1, 0.3 * half), v.at(0, arch, -0.25 * half), (2, 0.55 * half, 3),
                    (2, 0.65 * half, 3), v.frame[1]),
        ]  # fmt: skip
        if lumbar:
            thick = 7 if v.name == "L5" else 3.6
            rows.append(capsule(v.at(x, pillar - 3, high - 3), v.at(reach, pillar - 2 + rng.normal(0, 1), high + rng.normal(-2, 1.5)),
                                (3, thick, thick), (3, 4.5, 2.5), v.frame[1]))  # fmt: skip
        else:
            rows.append(capsule(v.at(x, pillar - 1, high - 1), v.at(reach, pillar + 0.5 * (abs(reach) - abs(x)), high + 2),
                                (3, 5, 4), (4, 4.6, 4.6), v.frame[1]))  # fmt: skip
    drop = np.radians(s["spinous_drop"])
    tip = np.array([rng.normal(0, 1.6), arch + s["spinous_length"] * np.cos(drop), -s["spinous_length"] * np.sin(drop)])
    root, end = ((3, 8, 3.2), (6, 8.5, 4.2)) if lumbar else ((3, 6.5, 3), (4, 4.2, 3.6))
    rows.append(capsule(v.at(0, arch - 1, -0.3 * half), v.at(tip[0], tip[1], tip[2] - 0.3 * half), root, end, v.frame[0]))
    return np.stack(rows)


def _sacrum(vertebrae: dict[str, Vertebra]) -> NDArray[np.float64]:
    """Fused bodies, the wings that meet the iliac bones, the median crest; canal and foramina carved out."""
    chain = [v for name, v in vertebrae.items() if name[0] == "S" or name[:2] == "Co"]
    rows = [_body(v) for v in chain]
    s1, s2, s3, s4, s5 = chain[:5]
    for side in (-1, 1):
        wing = [
            [(*s1.at(side * x, y, 5 - x / 6), t), (*s1.at(side * x, y, -9), t), (*s2.at(side * 0.95 * x, y, 0), 0.8 * t),
             (*s3.at(side * 0.75 * x, y - 1, 0), 0.55 * t), (*s4.at(side * 0.5 * x, y - 3, 0), 0.4 * t),
             (*s5.at(side * 0.25 * x, y - 6, 0), 0.28 * t)]
            for x, y, t in ((18, 4, 11), (34, 8, 12), (48, 14, 11))
        ]  # fmt: skip
        rows += [*sheet(wing, 2), capsule(s1.at(side * 20, 12, 4), s1.at(side * 21, 19, 16), (3, 6, 4), (3, 5, 3), s1.frame[1])]
    backs = [v.at(0, v.body_back + reach, 0) for v, reach in zip(chain[:4], (20, 17, 13, 8), strict=True)]
    rows += [capsule(a, b, (4, 6, 5), (4, 5, 4), (1, 0, 0)) for a, b in zip(backs[:-1], backs[1:], strict=True)]
    for v, reach in zip(chain[:4], (17, 15, 11, 7), strict=True):
        rows += [capsule(v.at(0, v.body_back + reach, 0), v.at(side * 20, v.body_back + reach - 6, 0), (3, 9, 4), thin=v.frame[1], rb=(3, 9, 5))
                 for side in (-1, 1)]  # fmt: skip
    canal = [s1.at(0, s1.body_back + 9, 20), s1.at(0, s1.body_back + 9, 0), s2.at(0, s2.body_back + 7, 0), s4.at(0, s4.body_back + 3, 0)]
    for a, b, r in zip(canal[:-1], canal[1:], (11, 8, 5), strict=True):
        rows.append(capsule(a, b, (1, 1.3 * r, 0.7 * r), (1, r, 0.5 * r), s1.frame[1], carve=True))
    for v, x, r in zip(chain[:4], (19, 17, 15, 13), (4.8, 4.4, 3.8, 3.2), strict=True):
        for side in (-1, 1):  # nearly level, so that a frontal radiograph shows them half open
            hole = v.at(side * x, 4, -v.size["height"] / 2)
            rows.append(capsule(hole + [side * 3, -30, -9], hole + [side, 35, 11], 1.2 * r, 0.7 * r, carve=True))
    return np.stack(rows)
