"""The hip bones and the upper ends of the femora."""

import numpy as np
from jaxtyping import Float

from regtorch.phantom.raster import Part
from regtorch.phantom.shapes import Numbers, Rows, capsule, sheet, side_of, smooth, tube

# Left side, LPS mm. Sizes are those of a medium adult: 275 mm between the iliac crests, 235 mm between the anterior
# superior spines, 176 mm between the hips. The hip axis lies under the sacral endplate and gives a pelvic incidence of
# 54 degrees, the mean of Vialle et al. 2005.
_HIP = np.array([88.0, -4.0, -102.0])
_WING = (  # rows from the crest to the acetabular roof and sciatic notch, each front to back: x, y, z, half thickness
    ((119, -55, -34, 6.0), (134, -38, 0, 5.5), (138, -8, 27, 5.0),
     (122, 26, 36, 5.0), (95, 56, 25, 6.0), (58, 84, -24, 6.5)),
    ((114, -53, -52, 5.5), (126, -28, -18, 3.0), (124, -2, 5, 2.2),
     (104, 28, 15, 2.8), (78, 52, 8, 4.5), (52, 78, -34, 6.0)),
    ((106, -50, -66, 7.0), (115, -25, -42, 4.0), (108, 0, -24, 2.6),
     (84, 28, -8, 4.0), (63, 46, -11, 6.0), (51, 70, -40, 5.5)),
    ((96, -38, -88, 7.0), (86, -20, -80, 9.0), (73, 3, -68, 8.5),
     (61, 24, -45, 8.0), (54, 42, -35, 7.0), (50, 59, -49, 5.0)),
)  # fmt: skip
_SOCKET = ((85, 0, -98), (90, -2, -100))
_OPENING = (122, -14, -118)
# Rami and ischium: x, y, z, wide, thin.
_PUBIS_UPPER = ((82, -28, -96, 11, 9), (60, -44, -100, 8, 7), (36, -55, -106, 7.5, 6.5), (12, -58, -115, 10, 7))
_PUBIS_LOWER = (
    (12, -57, -118, 9, 7), (14, -53, -132, 9, 6), (25, -42, -147, 7.5, 5), (42, -26, -162, 7.5, 5.5),
    (54, -10, -169, 9, 8),
)  # fmt: skip
_ISCHIUM = (
    (63, 26, -54, 8, 8), (72, 27, -84, 11, 10), (79, 20, -110, 15, 13), (73, 22, -132, 15, 12),
    (65, 16, -152, 13, 12), (58, 4, -168, 13, 12),
)  # fmt: skip
_ISCHIAL_SPINE = ((74, 27, -110), (57, 36, -117))

_NECK_END, _SHAFT_TOP = (124, 8, -133), (124, 9, -162)
_TROCHANTERS = (((130, 14, -124), (142, 20, -112), 15, 11), ((118, 18, -162), (110, 24, -166), 12, 7))
_SHAFT = ((124, 9, -160, 17.5), (122, 9, -182, 15.5), (119, 8, -225, 14.5))  # x, y, z, radius
_MARROW = ((124, 8, -138, 14), (124, 9, -158, 13), (122, 9, -182, 10.5), (119, 8, -225, 9))


def pelvis_parts(rng: np.random.Generator) -> list[Part]:
    """Hip bone and femur of both sides."""
    return [part for side in (-1, 1) for part in _half(side, rng.normal(0, 1.2, 3))]


def _half(side: int, shift: Float[np.ndarray, "3"]) -> list[Part]:
    def place(points: Numbers) -> Float[np.ndarray, "*shape"]:
        return side_of(points, side) + shift

    def ramus(table: Numbers) -> Rows:
        s = smooth(table, 4)
        return tube(place(s[:, :3]), s[:, [4, 3, 4]], (0, 1, 0.4))

    def shaft(table: Numbers) -> Rows:
        s = smooth(table, 4)
        return tube(place(s[:, :3]), s[:, 3])

    wing = np.array(_WING, float)
    wing[..., :3] = place(wing[..., :3])
    hip = place(_HIP)
    socket = [capsule(*place(_SOCKET), 33, 31), capsule(hip, place(_OPENING), 26.5, 30, carve=True)]
    bone = [sheet(wing), ramus(_ISCHIUM), tube(place(_ISCHIAL_SPINE), (8, 3.5)), np.stack(socket)]
    bone += [ramus(_PUBIS_UPPER), ramus(_PUBIS_LOWER)]
    head = [
        capsule(hip, hip, 23.5, 23.5),
        capsule(hip, place(_NECK_END), 14.5, 17),
        *(capsule(place(a), place(b), ra, rb) for a, b, ra, rb in _TROCHANTERS),
        capsule(place(_NECK_END), place(_SHAFT_TOP), 18, 17.5),
    ]
    return [
        Part(np.concatenate(bone), 250, 880, 1.5, 60, 3.0),
        Part(np.stack(head), 300, 800, 1.4, 70, 6.0),
        Part(shaft(_SHAFT), 1000, texture_hu=40),
        Part(shaft(_MARROW), 130, texture_hu=50),
    ]
