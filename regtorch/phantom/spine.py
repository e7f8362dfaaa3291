"""Where the vertebrae stand and how large they are: C7 to coccyx, each with its own size, tilt and deviations."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

# Bodies, pedicles, canals and processes are modelled on the means of Panjabi et al., Spine 16 (1991) 861 and 888
# (cervical, thoracic) and 17 (1992) 299 (lumbar), the lumbar discs on Gilad and Nissan, Spine 11 (1986) 154. The tilts
# make a thoracic kyphosis of 40 degrees, a lumbar lordosis of 57 and a sacral slope of 40, all close to the means of
# Vialle et al., J Bone Joint Surg Am 87 (2005) 260.
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
    centre: Float[np.ndarray, "3"]
    frame: Float[np.ndarray, "3 3"]

    def at(self, left: float | int, back: float | int, up: float | int) -> Float[np.ndarray, "3"]:
        """LPS mm of a point given in mm along the vertebra's own axes, from the centre of its body."""
        return self.centre + np.array([left, back, up]) @ self.frame

    @property
    def is_sacral(self) -> bool:
        return self.name[0] == "S" or self.name.startswith("Co")

    @property
    def body_back(self) -> float:
        """From the centre of the body to its back, mm."""
        return (self.size["upper_depth"] + self.size["lower_depth"]) / 4


def drawn_vertebrae(rng: np.random.Generator) -> dict[str, Vertebra]:
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


def _frame(tilt: float, roll: float, turn: float) -> Float[np.ndarray, "3 3"]:
    """Left, posterior and superior axis as rows, for degrees of tilt forward, to the left, and turn about the axis."""
    a, b, c = np.radians([tilt, roll, turn])
    about_x = np.array([[1, 0, 0], [0, np.cos(a), np.sin(a)], [0, -np.sin(a), np.cos(a)]])
    about_y = np.array([[np.cos(b), 0, -np.sin(b)], [0, 1, 0], [np.sin(b), 0, np.cos(b)]])
    about_z = np.array([[np.cos(c), np.sin(c), 0], [-np.sin(c), np.cos(c), 0], [0, 0, 1]])
    return about_z @ about_x @ about_y


def _step(upper: int, sizes: list[dict[str, float]], frames: list[Float[np.ndarray, "3 3"]]) -> Float[np.ndarray, "3"]:
    """From the centre of the body below to that of body number ``upper``."""
    up, down = frames[upper][2], frames[upper + 1][2]
    across = (up + down) / np.linalg.norm(up + down)
    return up * sizes[upper]["height"] / 2 + across * sizes[upper]["disc"] + down * sizes[upper + 1]["height"] / 2
