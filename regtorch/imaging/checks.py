"""Faults of a CT or a radiograph, one line each.

Each test states a condition that no sound image meets. The limits were set on DRRs of three CTs (PA and LAT, bone alone
and everything, many poses) and leave a margin to all of them.
"""

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d, avg_pool2d

from regtorch.imaging.radiograph import Radiograph
from regtorch.imaging.volume import Volume
from regtorch.limits import SDD_RANGE_MM

_TISSUE_HU, _PADDING_HU = -300, -1500


def check_volume(volume: Volume) -> list[str]:
    """Faults of a CT in HU, one line each."""
    found = list(volume.warnings)
    every = max(1, volume.data.numel() // 250_000)
    values = volume.data.flatten()[::every].cpu()
    lowest, highest = (float(v) for v in values.quantile(torch.tensor([0.005, 0.999], dtype=values.dtype)))
    air = float((values < -500).float().mean())
    # Fat lies near -100 HU and every torso has some, so HU without values well below 0 there are not.
    if lowest > -50:
        found.append(f"no HU offset? The lowest values are about {lowest:.0f}, where fat has -100 and air -1000 HU")
    elif air < 0.01:
        found.append(f"nearly no air ({100 * air:.1f} % of the voxels): a CT cropped within the body, or no HU")
    if air > 0.99:
        found.append(f"nearly empty: {100 * air:.1f} % of the voxels are air")
    # The densest thousandth of any bone that a radiograph shows is beyond 300 HU, contrast or not.
    elif highest < 200:
        found.append(f"no bone: the highest values are about {highest:.0f} HU, where bone has 300 and more")
    elif len(found) == len(volume.warnings) and (cut := _cut_at_the_sides(volume)) > 0.4:
        share = f"{100 * cut:.0f} % of the lines through it end there"
        found.append(f"the body is cut at a side ({share}): only to head and foot the search lets it go on")
    sizes = volume.spacing_mm.tolist()
    if min(sizes) < 0.1 or max(sizes) > 5.01:
        size = " x ".join(f"{s:g}" for s in sizes)
        found.append(f"voxels of {size} mm: expected 0.1 to 5 mm, as thicker slices blur what is registered")
    thickness = volume.slice_thickness_mm
    if thickness is not None and 0 < thickness < 0.95 * sizes[2]:
        found.append(f"gaps between slices: {thickness:g} mm thick but {sizes[2]:g} mm apart")
    return found


def check_radiograph(radiograph: Radiograph, *, sdd_known: bool = False) -> list[str]:
    """Warnings of the reader, and faults of the image as line integrals, bone bright.

    An SDD that is known from elsewhere is not missed in the file.
    """
    found = list(radiograph.warnings)
    found += _check_geometry(radiograph, sdd_known)
    used = radiograph.weight > 0
    share = float(used.float().mean())
    if share < 0.2:
        found.append(
            f"only {100 * share:.0f} % of the image counts: the rest is masked or outside the collimated field"
        )
    if not bool(used.any()):
        return found
    rows, columns = (used.any(dim).nonzero().flatten() for dim in (1, 0))
    box = slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)
    values = radiograph.image[box][used[box]]
    filled = torch.where(used[box], radiograph.image[box], values.min())
    return found + (_check_tone(filled) or _check_grey(values))


def _cut_at_the_sides(volume: Volume) -> float:
    """The share of lines across the body that have tissue where the CT or its padding ends.

    The largest of the four sides. A couch or an arm alone has up to a fifth.
    """
    along = 2 - volume.along_body
    shares = [0.0]
    for across in {0, 1, 2} - {along}:
        lines = volume.data.movedim(across, -1)
        lines = lines[tuple(slice(None, None, max(1, n // 64)) for n in lines.shape[:2])]
        crossing = (lines > _TISSUE_HU).any(-1)
        for side in (lines, lines.flip(-1)):
            outermost = side.gather(-1, (side > _PADDING_HU).int().argmax(-1, keepdim=True))[..., 0]
            shares.append(float(((outermost > _TISSUE_HU) & crossing).sum() / crossing.sum().clamp(min=1)))
    return max(shares)


def _check_geometry(radiograph: Radiograph, sdd_known: bool) -> list[str]:
    found = []
    low, high = SDD_RANGE_MM
    if radiograph.sdd_mm is None:
        if not sdd_known:
            found.append("no source-detector distance (SDD) in the file")
    elif not low <= radiograph.sdd_mm <= high:
        found.append(f"source-detector distance (SDD) of {radiograph.sdd_mm:g} mm: expected {low:g} to {high:g} mm")
    pixel = radiograph.detector.pixel_mm
    width, height = radiograph.detector.columns * pixel, radiograph.detector.rows * pixel
    # Cassettes and flat panels are up to 43 cm wide, long-leg and EOS images up to 2 m long; a dental film has 3 cm.
    if min(width, height) > 650 or max(width, height) > 2200 or max(width, height) < 30:
        found.append(f"pixels of {pixel:g} mm make a detector of {width:.0f} x {height:.0f} mm: is their size right?")
    return found


def _check_grey(values: Float[Tensor, " n"]) -> list[str]:
    low, high = float(values.min()), float(values.max())
    if high == low:
        return ["empty: every pixel has the same value"]
    some = values[:: max(1, len(values) // 500_000)]
    near = torch.quantile(some, torch.tensor([0.005, 0.995], dtype=some.dtype))
    if float(near[1] - near[0]) < 0.05 * (high - low):
        return ["nearly empty: 99 % of the pixels lie within a twentieth of the grey range"]
    levels = len(some.unique())
    if levels <= 64 < len(some):
        return [f"only {levels} grey levels: expected a radiograph of 10 bits or more"]
    # Air at the lower end may well be one value; the densest bone is never an area of one value.
    topped = float((values == high).float().mean())
    if topped > 0.01:
        return [f"grey range cut off: {100 * topped:.0f} % of the pixels have the highest value"]
    return []


def _check_tone(image: Float[Tensor, "h w"]) -> list[str]:
    image = image.double()
    image = (image - image.min()) / (image.max() - image.min()).clamp(min=1e-12)
    factor = max(1.0, max(image.shape) / 128)
    shape = tuple(max(5, round(n / factor)) for n in image.shape)
    image = adaptive_avg_pool2d(image[None, None], shape)[0, 0]
    image = (image - image.min()) / (image.max() - image.min()).clamp(min=1e-12)
    border = torch.cat([image[0], image[-1], image[:, 0], image[:, -1]])
    top, at_border = (float((v > 0.98).double().mean()) for v in (image, border))
    # Only air is a flat area that reaches the border, and it is dark; DRRs have under 1 % and 2 % there.
    if top > 0.03 and at_border > 0.05:
        share = f"{100 * top:.0f} % of the image"
        return [f"inverted or not logarithmic? The brightest tone fills {share} and reaches its border, as air would"]
    mean = avg_pool2d(image[None, None], 5, 1)[0, 0]
    spread = (avg_pool2d(image[None, None] ** 2, 5, 1)[0, 0] - mean**2).clamp(min=0).sqrt()
    body = mean > 0.05
    if int(body.sum()) < 100:
        return []
    mean, spread = mean[body], spread[body]
    thin, thick = torch.quantile(mean, torch.tensor([1 / 3, 2 / 3], dtype=mean.dtype))
    contrast = float(spread[mean > thick].median() / spread[mean < thin].median().clamp(min=1e-12))
    level = float(mean[mean > thick].median())
    # 1 - exp(-L) crowds the thick parts at the top and takes their contrast; line integrals reach 0.88 and keep 0.2.
    if level > 0.92 and contrast < 0.25:
        return [
            "not logarithmic? The thick parts have next to no contrast, as in counts of the beam (--intensity counts)"
        ]
    return []
