"""Soft tissue and air: skin, fat, muscle, lungs with vessels, heart, great vessels, organs of the abdomen, gas."""

import numpy as np
from jaxtyping import Float

from regtorch.phantom.raster import Part
from regtorch.phantom.shapes import Numbers, Rows, capsule, loft, side_of, smooth, tube
from regtorch.phantom.spine import Vertebra

FAT, MUSCLE, LUNG, AIR = -95, 50, -830, -1000

# Each section: x, y, z, half width, half depth, in LPS mm.
_TRUNK = (
    (0, 25, 480, 57, 56), (0, 26, 462, 60, 60), (0, 27, 447, 80, 65), (0, 27, 436, 116, 69), (0, 31, 424, 156, 78),
    (0, 35, 408, 178, 84), (0, 30, 388, 183, 94), (0, 24, 360, 180, 104), (0, 18, 320, 169, 110),
    (0, 11, 270, 161, 118), (0, 5, 210, 153, 117), (0, 1, 140, 146, 107), (0, -4, 80, 148, 106), (0, -2, 30, 160, 109),
    (0, 6, -20, 170, 113), (0, 10, -70, 176, 118), (0, 10, -120, 179, 117), (0, 8, -170, 178, 108),
    (0, 6, -230, 172, 100),
)  # fmt: skip
_WALL = (  # muscle under the fat
    (0, 27, 485, 53, 51), (0, 28, 458, 56, 55), (0, 29, 438, 94, 61), (0, 32, 420, 146, 70), (0, 34, 404, 166, 76),
    (0, 31, 388, 172, 85), (0, 26, 360, 168, 93), (0, 20, 320, 156, 100), (0, 12, 270, 148, 107), (0, 6, 210, 141, 103),
    (0, 4, 140, 131, 88), (0, 2, 80, 132, 84), (0, 4, 30, 146, 85), (0, 14, -20, 156, 84), (0, 18, -70, 158, 90),
    (0, 16, -120, 160, 92), (0, 12, -230, 156, 84),
)  # fmt: skip
_BELLY = (  # fat around the organs, inside the abdominal wall
    (0, -6, 225, 122, 72), (0, -20, 180, 120, 66), (0, -24, 130, 114, 60), (0, -26, 80, 112, 58), (0, -26, 30, 108, 56),
    (0, -14, -20, 84, 52), (0, 0, -60, 58, 46), (0, 6, -100, 44, 38), (0, 8, -118, 36, 28),
)  # fmt: skip
_LUNG = (  # left; the right lung is a little wider
    (38, 23, 437, 3, 4), (38, 23, 433, 8, 12), (40, 23, 426, 13, 21), (43, 23, 412, 20, 31), (48, 22, 396, 33, 42),
    (57, 19, 371, 42, 57), (65, 16, 338, 51, 70), (70, 10, 295, 58, 80), (71, 5, 255, 59, 80), (70, 3, 215, 56, 72),
    (67, 15, 180, 49, 52), (64, 30, 162, 36, 28),
)  # fmt: skip
_MEDIASTINUM = (
    (0, 16, 445, 23, 32), (0, 10, 400, 19, 36), (1, -2, 350, 16, 52), (2, -8, 300, 16, 66), (2, -6, 240, 22, 74),
    (0, 0, 190, 24, 66),
)  # fmt: skip
_AORTA = (
    (10, -20, 312), (4, -26, 345), (6, -16, 372), (20, 2, 380), (25, 18, 366), (24, 25, 330), (20, 20, 250),
    (12, 8, 190), (6, -12, 130), (3, -22, 62),
)  # fmt: skip
_CAVA = ((-20, -16, 436), (-22, -16, 400), (-24, -20, 350), (-21, -24, 310))
_TRACHEA = ((0, -12, 490), (0, -8, 440), (0, 0, 400), (1, 4, 368))
_BRONCHI = ((1, 4, 370), (20, 8, 350), (38, 10, 338))
_GAS = (  # pockets in the stomach (the first) and in the bowel: centre; radii (tall, wide, deep)
    ((58, -28, 222), (15, 34, 22)), ((100, -30, 150), (24, 14, 14)), ((96, -40, 80), (22, 14, 12)),
    ((-92, -34, 60), (26, 18, 15)), ((-88, -46, 110), (20, 15, 12)), ((-40, -60, 122), (9, 24, 10)),
    ((22, -62, 112), (9, 30, 10)), ((10, 2, -66), (16, 14, 12)), ((30, -58, 46), (8, 12, 9)),
    ((-22, -52, 22), (8, 14, 9)), ((44, -36, 4), (10, 12, 10)),
)  # fmt: skip
_PSOAS = (("T12", 22, 8), ("L1", 32, 14), ("L2", 37, 18), ("L3", 42, 22), ("L4", 48, 25), ("L5", 58, 25))
_ORGANS = (  # from, to, radii (along, wide, deep) at both; HU, texture
    (((-66, -8, 192), (-10, -34, 196), (74, 70, 84), (48, 50, 56)), 62, 12),  # liver
    (((-78, -18, 160), (-82, -20, 108), (30, 46, 62), (16, 24, 34)), 62, 12),  # its lower margin
    (((62, -8, 186), (62, -8, 186), (52, 62, 74), (52, 62, 74)), 42, 14),  # stomach under the left dome
    (((98, 34, 182), (98, 34, 182), (44, 24, 36), (44, 24, 36)), 52, 8),  # spleen
    (((62, 44, 168), (68, 36, 118), (14, 26, 22), (14, 25, 21)), 38, 8),  # kidneys: the right one is lower
    (((-60, 42, 152), (-66, 34, 104), (14, 26, 22), (14, 25, 21)), 38, 8),
    (((2, -22, -92), (2, -22, -92), (26, 40, 28), (26, 40, 28)), 12, 5),  # bladder
)


def _ball(middle: Numbers, radii: Numbers) -> Rows:
    """An ellipsoid with the radii (tall, wide, deep)."""
    return capsule(middle, middle, radii, radii)[None]


def _mirrored(sections: tuple, side: int, widen: float) -> Float[np.ndarray, "n 5"]:
    table = side_of(sections, side)
    table[:, 3] *= widen
    return table


def tissue_parts(vertebrae: dict[str, Vertebra], rng: np.random.Generator) -> list[Part]:
    """All soft parts in the order of painting, from the skin inwards; bones are painted after them."""
    walls = [
        Part(loft(_TRUNK), FAT, 30, 1.8, 8),
        Part(loft(_WALL), MUSCLE, MUSCLE, texture_hu=16),
        Part(loft(_BELLY), FAT + 10, texture_hu=14),
    ]
    return [*walls, *_chest(rng), *_abdomen(vertebrae, rng)]


def _chest(rng: np.random.Generator) -> list[Part]:
    lungs = [Part(loft(_mirrored(_LUNG, side, 1.03 if side < 0 else 0.99)), LUNG, texture_hu=50) for side in (-1, 1)]
    vessels = [Part(_tree(side, rng), 40) for side in (-1, 1)]
    left_heart = capsule((10, -34, 290), (44, -46, 258), (38, 46, 40), (30, 40, 36))[None]
    return [
        *lungs,
        *vessels,
        Part(loft(_MEDIASTINUM), 20, texture_hu=14),
        Part(left_heart, 45, texture_hu=12),
        Part(_ball((-15, -28, 274), (52, 33, 36)), 45, texture_hu=12),
        Part(tube(smooth(_AORTA, 5), (8, 12.5, 12.5)), 48, texture_hu=8),
        Part(tube(smooth(_CAVA, 5), (8, 11, 11)), 45, texture_hu=8),
        Part(tube(_TRACHEA, (4, 8.5, 8.5)), AIR, 35, 1.2),
        *(Part(tube(side_of(_BRONCHI, side), (3, 6, 6)), AIR, 35, 1.0) for side in (-1, 1)),
    ]


def _tree(side: int, rng: np.random.Generator) -> Rows:
    """Vessels that leave the hilum in all directions and fork once."""
    hilum, rows = np.array([30.0 * side, 6.0, 330.0]), []
    for _ in range(13):
        aim = hilum + rng.uniform((30, -60, -105), (75, 55, 65)) * (side, 1, 1)
        middle = (hilum + aim) / 2 + rng.normal(0, 8, 3)
        rows.append(tube(smooth([hilum, middle, aim], 4), np.linspace(4.2, 1.4, 9)))
        for _ in range(2):
            twig = middle + (aim - middle) * 1.1 + rng.normal(0, 18, 3)
            bend = (middle + twig) / 2 + rng.normal(0, 4, 3)
            rows.append(tube(smooth([middle, bend, twig], 3), np.linspace(2.4, 1.0, 7)))
    return np.concatenate(rows)


def _pocket(middle: Float[np.ndarray, "3"], radii: Float[np.ndarray, "3"], rng: np.random.Generator) -> Rows:
    """A gas pocket of irregular outline, made of five overlapping ellipsoids."""
    offsets, sizes = rng.uniform(-0.6, 0.6, (5, 3)), rng.uniform(0.4, 0.7, (5, 3))
    return np.concatenate([_ball(middle + radii * o, radii * s) for o, s in zip(offsets, sizes, strict=True)])


def _abdomen(vertebrae: dict[str, Vertebra], rng: np.random.Generator) -> list[Part]:
    psoas = [
        tube([vertebrae[name].at(side * x, 2, 0) for name, x, _ in _PSOAS], [(6, r, r) for *_, r in _PSOAS])
        for side in (-1, 1)
    ]
    loops = [_ball(rng.uniform((-80, -75, -30), (80, -30, 110)), rng.uniform(12, 20, 3)) for _ in range(26)]
    gas = [Part(_pocket(*np.array(pocket, float), rng), -900, 35, 2.0, blend_mm=6.0) for pocket in _GAS]
    return [
        Part(np.concatenate(psoas), 55, texture_hu=10),
        Part(np.concatenate(loops), 32, texture_hu=16),
        *(Part(capsule(*ends)[None], hu, texture_hu=texture) for ends, hu, texture in _ORGANS),
        *gas,
    ]
