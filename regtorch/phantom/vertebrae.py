"""The bones of the spine as solids: vertebrae with arch and seven processes, the sacrum with wings and foramina."""

from itertools import pairwise

import numpy as np

from regtorch.phantom.raster import Part
from regtorch.phantom.shapes import Row, Rows, capsule, drum, sheet
from regtorch.phantom.spine import Vertebra

# Spinous process: radii (along, high, wide) at its root and at its tip, mm.
_SPINOUS = {"lumbar": ((3, 8, 3.2), (6, 8.5, 4.2)), "thoracic": ((3, 6.5, 3), (4, 4.2, 3.6))}
# Wings of the sacrum. First outwards from the bodies: distance to the left and backwards, half thickness, mm. Then
# downwards: segment, share of the width, share of the thickness, offset upwards and backwards from its centre, mm.
_WING = ((18, 4, 11), (34, 8, 12), (48, 14, 11))
_WING_LEVELS = (
    ("S1", 1.0, 1.0, 1, 0), ("S1", 1.0, 1.0, -9, 0), ("S2", 0.95, 0.8, 0, 0),
    ("S3", 0.75, 0.55, 0, -1), ("S4", 0.5, 0.4, 0, -3), ("S5", 0.25, 0.28, 0, -6),
)  # fmt: skip
# For each sacral body: distance backwards to the lamina and the median crest; lateral distance and radius of the
# foramina, mm.
_SACRAL_BACK = (("S1", 17, 20, 19, 4.8), ("S2", 15, 17, 17, 4.4), ("S3", 11, 13, 15, 3.8), ("S4", 7, 8, 13, 3.2))


def spine_parts(vertebrae: dict[str, Vertebra], rng: np.random.Generator) -> list[Part]:
    """One part for each vertebra from C7 to L5, one for sacrum and coccyx."""
    single = [v for v in vertebrae.values() if not v.is_sacral]
    parts = [Part(_vertebra(v, rng), rng.normal(245, 15), rng.normal(920, 40), 1.2, 75, 1.5) for v in single]
    return [*parts, Part(_sacrum(vertebrae), 200, 720, 0.9, 60, 3.0)]


def _body(v: Vertebra) -> Row:
    s = v.size
    widths, depths = (s["lower_width"], s["upper_width"]), (s["lower_depth"], s["upper_depth"])
    return drum(v.centre, v.frame, s["height"], widths, depths, wedge=np.tan(np.radians(s["wedge"]) / 2))


def _vertebra(v: Vertebra, rng: np.random.Generator) -> Rows:
    """Body, spinous process and, on each side, pedicle, facets, lamina and transverse process."""
    s, lumbar = v.size, v.name[0] == "L"
    half, wide, tall = s["height"] / 2, s["pedicle_width"] / 2, s["pedicle_height"] / 2
    pillar = v.body_back + 0.8 * s["canal_depth"]  # where pedicle, facets, lamina and transverse process meet
    arch = v.body_back + s["canal_depth"] + 3
    high = half - tall + (0.5 if lumbar else 1.5)
    facet = (5, 5, 8) if lumbar else (4, 6, 3)  # sagittal and thick, or coronal and thin
    left, back, up = v.frame
    rows = [_body(v)]
    for side in (-1, 1):
        x = side * (s["canal_width"] / 2 + wide)
        upper, lower = (x + 3 * side, 0.72 * x) if lumbar else (x, 0.75 * x)
        foot = v.at(lower, arch + 1, -half - 0.3 * tall - s["disc"] / 2)
        rows += [
            capsule(v.at(x, v.body_back - 4, high), v.at(x, pillar, high), (2, wide, tall), (2, wide, tall), up),
            capsule(v.at(upper, pillar - 1, high), v.at(upper, pillar + 1, half + 0.6 * tall), facet, facet, back),
            capsule(v.at(x, pillar, high), foot, (3, 4, 3.5), facet, back),
            capsule(v.at(0.85 * x, pillar + 1, 0.3 * half), v.at(0, arch, -0.25 * half),
                    (2, 0.55 * half, 3), (2, 0.65 * half, 3), back),
        ]  # fmt: skip
        reach = side * s["transverse_width"] / 2 * (1 + rng.normal(0, 0.03))
        if lumbar:  # long and straight outwards; thick for L5
            thick = 7 if v.name == "L5" else 3.6
            tip = v.at(reach, pillar - 2 + rng.normal(0, 1), high + rng.normal(-2, 1.5))
            rows.append(capsule(v.at(x, pillar - 3, high - 3), tip, (3, thick, thick), (3, 4.5, 2.5), back))
        else:  # outwards and backwards, with a knob for the rib
            tip = v.at(reach, pillar + 0.5 * (abs(reach) - abs(x)), high + 2)
            rows.append(capsule(v.at(x, pillar - 1, high - 1), tip, (3, 5, 4), (4, 4.6, 4.6), back))
    drop, length = np.radians(s["spinous_drop"]), s["spinous_length"]
    tip = v.at(rng.normal(0, 1.6), arch + length * np.cos(drop), -0.3 * half - length * np.sin(drop))
    rows.append(capsule(v.at(0, arch - 1, -0.3 * half), tip, *_SPINOUS["lumbar" if lumbar else "thoracic"], left))
    return np.stack(rows)


def _sacrum(vertebrae: dict[str, Vertebra]) -> Rows:
    """Fused bodies, wings up to the iliac bones, laminae and median crest; canal and foramina are carved out."""
    rows = [_body(v) for v in vertebrae.values() if v.is_sacral]
    s1 = vertebrae["S1"]
    for side in (-1, 1):
        wing = [
            [(*vertebrae[name].at(side * x * out, y + behind, up), thick * thin)
             for name, out, thin, up, behind in _WING_LEVELS]
            for x, y, thick in _WING
        ]  # fmt: skip
        rows += [*sheet(wing, 2)]
        rows.append(capsule(s1.at(side * 20, 12, 4), s1.at(side * 21, 19, 16), (3, 6, 4), (3, 5, 3), s1.frame[1]))
    crest, canal = [], [s1.at(0, s1.body_back + 9, 20)]
    for name, lamina, ridge, _, _ in _SACRAL_BACK:
        v = vertebrae[name]
        middle = v.at(0, v.body_back + lamina, 0)
        for side in (-1, 1):
            out = v.at(side * 20, v.body_back + lamina - 6, 0)
            rows.append(capsule(middle, out, (3, 9, 4), (3, 9, 5), v.frame[1]))
        crest.append(v.at(0, v.body_back + ridge, 0))
        canal.append(v.at(0, v.body_back + 0.5 * lamina, 0))
    rows += [capsule(a, b, (4, 6, 5), (4, 5, 4), s1.frame[0]) for a, b in pairwise(crest)]
    for (a, b), r in zip(pairwise(canal), (11, 9, 7, 5), strict=True):
        rows.append(capsule(a, b, (1, 1.3 * r, 0.7 * r), (1, r, 0.5 * r), s1.frame[1], carve=True))
    for name, _, _, x, r in _SACRAL_BACK:
        v = vertebrae[name]
        for side in (-1, 1):  # the foramina are nearly horizontal, so a frontal radiograph shows them half open
            hole = v.at(side * x, 4, -v.size["height"] / 2)
            front, back = hole + np.array([3 * side, -30, -9]), hole + np.array([side, 35, 11])
            rows.append(capsule(front, back, 1.2 * r, 0.7 * r, carve=True))
    return np.stack(rows)
