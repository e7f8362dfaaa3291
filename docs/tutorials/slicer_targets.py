"""Targets from 3D Slicer

A surgeon marks points in the CT with 3D Slicer. The registration puts each point into the radiograph, and tells the
error to expect there.
"""

import json
from pathlib import Path

import torch

from regtorch import attenuation, make_phantom, read_radiograph, read_volume, register, simulate
from regtorch.formats import read_points, write_radiograph, write_volume
from regtorch.geometry import Detector, project
from regtorch.plotting import write_overlay

# ## The files
#
# A CT and a radiograph stand in for yours: a NIfTI file and a TIFF of 16 bits. The TIFF keeps the size of its pixels.

phantom, vertebrae = make_phantom(5.0)
detector = Detector(rows=200, columns=160, pixel_mm=2.0)
truth = torch.tensor([10.0, 20.0, 990.0, -5.0, 70.0, 190.0, 0.02, 0.03, -0.03])
simulation = simulate(phantom, truth, "AP", detector=detector, photons=2e5, targets=vertebrae)
write_volume(Path("ct.nii.gz"), phantom)
write_radiograph(Path("radiograph.tiff"), simulation.image, detector, view="AP")

# Slicer saves points as `.mrk.json`. Its own coordinates are RAS or LPS; the file says which. This file has RAS, the
# opposite sign of x and y. A point 25 mm left of L3 is an entry point.

x, y, z = vertebrae["L3"]
named = {"L2": vertebrae["L2"], "L3": (x, y, z), "L4": vertebrae["L4"], "entry": (x + 25, y, z)}
points = [{"label": name, "position": [-x, -y, z]} for name, (x, y, z) in named.items()]
markup = {"type": "Fiducial", "coordinateSystem": "RAS", "coordinateUnits": "mm", "controlPoints": points}
Path("plan.mrk.json").write_text(json.dumps({"markups": [markup]}))

# ## The registration
#
# `read_points` returns LPS mm by name, whatever the file has.

targets = read_points("plan.mrk.json")
ct = read_volume("ct.nii.gz")
radiograph = read_radiograph("radiograph.tiff", view="AP")
result = register(ct, radiograph, "AP")
print(result.status, "-", result.message)

# ## Each target
#
# `pixel_from_patient` maps LPS mm to (column, row) of the image as its file stores it.

places = torch.tensor(list(targets.values()), dtype=torch.float64)
pixels = project(result.pixel_from_patient, places)
true = project(simulation.pixel_from_patient, places)
for name, pixel, expected, miss in zip(
    targets, pixels.tolist(), result.expected_errors_mm(places).tolist(), (pixels - true).norm(dim=1), strict=True
):
    print(f"{name:6} ({pixel[0]:6.1f}, {pixel[1]:6.1f}), expected error {expected:.2f} mm, true {2 * miss:.2f} mm")

# ## The same from the command line
#
#     regtorch register ct.nii.gz radiograph.tiff --view AP --targets plan.mrk.json --out registered
#
# `result.json` then holds `expected_target_errors_mm`, and `overlay.png` shows the targets.
#
# ## The picture

write_overlay(Path("slicer_targets.png"), attenuation(ct, threshold_hu=100.0), radiograph, result, targets)
