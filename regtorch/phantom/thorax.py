"""The bones of the chest and shoulder: twelve pairs of ribs with their cartilage, sternum, clavicles, scapulae."""

import numpy as np
from jaxtyping import Float

from regtorch.phantom.raster import Part
from regtorch.phantom.shapes import Numbers, capsule, loft, sheet, side_of, smooth, tube
from regtorch.phantom.spine import Vertebra

# For each rib: half width of the chest at its outermost point; front end of the bone (x, y, z on the left, LPS mm);
# share of that path that is bone (less than 1 for the floating ribs); further points of the cartilage.
_RIBS = (
    (60, (33, -20, 399), 1.00, ((25, -31, 396),)),
    (88, (43, -50, 371), 1.00, ((20, -54, 367),)),
    (107, (51, -67, 343), 1.00, ((33, -71, 338), (17, -64, 341))),
    (119, (58, -77, 316), 1.00, ((36, -81, 311), (17, -71, 319))),
    (127, (66, -83, 288), 1.00, ((42, -88, 286), (17, -77, 301))),
    (132, (78, -83, 256), 1.00, ((52, -92, 262), (16, -82, 285))),
    (135, (91, -77, 224), 1.00, ((64, -92, 232), (34, -94, 256), (12, -86, 272))),
    (136, (103, -67, 194), 1.00, ((84, -82, 208), (66, -91, 230))),
    (134, (111, -52, 168), 1.00, ((98, -70, 186), (86, -81, 206))),
    (129, (114, -32, 146), 1.00, ((108, -50, 158), (99, -69, 184))),
    (120, (112, -28, 116), 0.66, ()),
    (108, (100, -20, 76), 0.45, ()),
)
# The path from the tubercle to the front end, as shares of the distances outwards, forwards and downwards.
_WAY = ((0.38, -0.09, 0.12), (0.76, 0.06, 0.31), (0.97, 0.32, 0.53), (1.0, 0.52, 0.68), (0.90, 0.78, 0.86))

_STERNUM = (  # x, y, z, half width, half depth
    (0, -31, 407, 24, 6.0), (0, -40, 390, 27, 6.5), (0, -53, 369, 17, 5.5), (0, -57, 360, 16, 5.0),
    (0, -70, 320, 18, 5.0), (0, -80, 288, 19, 5.0), (0, -85, 270, 11, 4.5), (0, -86, 250, 6, 3.5),
    (0, -85, 238, 4, 2.5),
)  # fmt: skip
_CLAVICLE = (  # x, y, z, wide, thin
    (19, -35, 405, 9.0, 8.0), (46, -36, 410, 6.5, 6.0), (82, -27, 417, 5.8, 5.5), (116, 7, 422, 6.5, 5.0),
    (138, 32, 420, 8.5, 4.5), (151, 41, 417, 9.5, 4.5),
)  # fmt: skip
_BLADE = (  # rows from the medial to the lateral border, each from top to bottom: x, y, z, half thickness
    ((85, 90, 404, 1.8), (77, 101, 377, 2.0), (76, 108, 336, 2.0), (88, 101, 287, 3.0)),
    ((108, 79, 411, 1.6), (103, 88, 374, 1.4), (103, 97, 335, 1.3), (93, 100, 290, 2.4)),
    ((130, 58, 402, 2.4), (138, 54, 376, 5.0), (123, 78, 335, 4.2), (100, 95, 290, 3.0)),
)
_RIDGE = (  # scapular spine up to the acromion: rows away from the blade, each from medial to lateral
    ((77, 101, 378, 1.5), (104, 88, 386, 1.6), (128, 64, 393, 2.5), (146, 50, 402, 2.5), (154, 42, 409, 3.5)),
    ((77, 104, 379, 2.2), (105, 101, 394, 3.2), (130, 84, 406, 3.6), (151, 60, 413, 4.5), (164, 40, 412, 4.0)),
)
_CORACOID = ((136, 48, 398), (131, 34, 408), (133, 20, 405), (139, 10, 398))
_GLENOID = ((138, 54, 380), (147, 46, 383))


def thorax_parts(vertebrae: dict[str, Vertebra], rng: np.random.Generator) -> list[Part]:
    """All parts of the chest and shoulders; cartilage comes first, so that bone covers its ends."""
    bones, cartilage = [], []
    for number, (width, end, share, beyond) in enumerate(_RIBS, 1):
        for side in (-1, 1):
            tip = side_of(end, side) + rng.normal(0, (2.0, 2.0, 2.5))
            path = _rib_path(vertebrae[f"T{number}"], side, width * rng.normal(1, 0.012), tip, share)
            bones.append(_rib(path, number))
            if beyond:
                way = smooth(np.concatenate([path[-1:], side_of(beyond, side)]), 6)
                cartilage.append(Part(tube(way, (3, 6, 4.5), (0, 1, 0.3)), 82, texture_hu=6))
    breastbone = Part(loft(_STERNUM), 170, 620, 0.9, 50)
    shoulders = [part for side in (-1, 1) for part in _shoulder(side, rng)]
    return [*cartilage, *bones, breastbone, *shoulders]


def _rib_path(
    v: Vertebra, side: int, width: float, end: Float[np.ndarray, "3"], share: float
) -> Float[np.ndarray, "n 3"]:
    """Centre line of the bone, from its head over the transverse process, outwards and down to its front end."""
    half, deep = v.size["height"] / 2, v.body_back
    pillar = deep + 0.8 * v.size["canal_depth"]
    reach = v.size["transverse_width"] / 2
    head = v.at(side * (0.46 * v.size["upper_width"] + 2), deep - 4, 0.75 * half)
    neck = v.at(side * (0.6 * v.size["upper_width"] + 6), pillar - 5, 0.6 * half)
    tubercle = v.at(side * (reach + 1), pillar + 0.5 * reach - 9, 0.35 * half)
    out, ahead, down = np.array(_WAY).T
    way = np.column_stack([
        tubercle[0] + (side * width - tubercle[0]) * out,
        tubercle[1] + (end[1] - tubercle[1]) * ahead,
        tubercle[2] + (end[2] - tubercle[2]) * down,
    ])  # fmt: skip
    curve = smooth(np.concatenate([[head, neck, tubercle], way, [end]]), 7)
    return curve[: max(2, round(share * len(curve)))]


def _rib(path: Float[np.ndarray, "n 3"], number: int) -> Part:
    """A rib along its path: a flat bone on edge, except for the first rib, which lies flat."""
    along = np.gradient(path, axis=0)
    flat = np.cross(along, [0, 0, 1]) if number > 1 else np.tile([0.0, 0.3, 1.0], (len(path), 1))
    t = np.linspace(0, 1, len(path))
    wide = np.interp(t, [0, 0.08, 0.25, 0.8, 1], [5.0, 4.4, 6.4, 5.6, 6.8]) * (0.8 if number in (11, 12) else 1)
    thin = np.interp(t, [0, 0.1, 0.3, 1], [4.5, 4.0, 3.9, 3.2])
    if number > 10:  # floating ribs end in a point
        wide, thin = wide * (1 - 0.6 * t**4), thin * (1 - 0.4 * t**4)
    return Part(tube(path, np.column_stack([thin, wide, thin]), flat), 220, 950, 1.0, 50)


def _shoulder(side: int, rng: np.random.Generator) -> list[Part]:
    shift = rng.normal((0, 0, 3 * side), 2.0)  # the left shoulder is a little higher

    def place(points: Numbers) -> Float[np.ndarray, "*shape"]:
        return side_of(points, side) + shift

    def place_sheet(grid: Numbers) -> Float[np.ndarray, "r c 4"]:
        grid = np.array(grid, float)
        return np.concatenate([place(grid[..., :3]), grid[..., 3:]], axis=-1)

    s = smooth(_CLAVICLE, 6)
    collar = tube(side_of(s[:, :3], side) + shift * np.linspace(0, 1, len(s))[:, None], s[:, [4, 3, 4]], (0, 0, 1))
    rows = [sheet(place_sheet(_BLADE)), sheet(place_sheet(_RIDGE)), tube(smooth(place(_CORACOID), 3), 5.5)]
    glenoid = capsule(*place(_GLENOID), (4, 13, 9), (3, 17, 12), (0, 1, 0))
    return [Part(collar, 220, 900, 1.4, 60), Part(np.concatenate([*rows, glenoid[None]]), 230, 800, 0.8, 50, 2.0)]
