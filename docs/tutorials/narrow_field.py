"""A narrow field

A collimated field shows three or four vertebrae. They resemble their neighbours, so a wrong level is the danger. One
landmark and a smaller range keep the search at the right level.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import torch

from regtorch import attenuation, evaluate, make_phantom, register, render, simulate
from regtorch.geometry import Detector, project
from regtorch.imaging import Radiograph
from regtorch.plotting import edge_strength

# ## The patient and the radiograph
#
# The whole detector is 360 mm wide. Only 140 x 130 mm about L2 count: `weight` is 0 outside. `read_radiograph` finds
# such a field by itself; `--mask` gives it by hand.

ct, vertebrae = make_phantom(5.0)
detector = Detector(rows=180, columns=180, pixel_mm=2.0)
truth = torch.tensor([15.0, 25.0, 1030.0, -10.0, 40.0, 200.0, 0.03, 0.05, -0.04])
simulation = simulate(ct, truth, "PA", detector=detector, photons=2e5, targets=vertebrae)
column, row = project(simulation.pixel_from_patient, torch.tensor([vertebrae["L2"]]).double())[0].round().int().tolist()
field = torch.zeros(180, 180)
field[max(row - 32, 0) : row + 33, max(column - 35, 0) : column + 36] = 1
radiograph = replace(Radiograph.from_image(simulation.image, detector), weight=field)

# ## Two registrations
#
# The first one is given the field alone. The second one is given L2, marked 8 mm off, and looks within 40 mm of it.

landmark = {"landmark_patient_mm": vertebrae["L2"], "landmark_stored": (column + 3.0, row - 3.0)}
near = torch.tensor([75.0, 75.0, 150.0, 40.0, 40.0, 150.0, 0.2, 0.2, 0.2])
results = {
    "field alone": register(ct, radiograph, "PA"),
    "with a landmark": register(ct, radiograph, "PA", half_range=near, **landmark),
}
for name, result in results.items():
    error = evaluate(result.to_dict(), simulation.to_dict())["targets"]["L2"]["pde_mm"]
    print(f"{name}: {result.status}, {error:.2f} mm off at L2")
    print(f"  {result.message}")
    print(f"  {result.evidence.agreeing} of {result.evidence.starts} starts agree, {result.evaluations} DRRs")

# ## The picture
#
# Both pictures show the field, the edges of the registered bones and the middle of L2: true (blue), found (orange).

bone = attenuation(ct, threshold_hu=100.0)
figure, panels = plt.subplots(1, 2, figsize=(8, 4.2), layout="constrained")
for axes, (name, result) in zip(panels, results.items(), strict=True):
    edges = edge_strength(render(bone, result.parameters, detector, "PA")).clamp(max=0.9).numpy()
    axes.imshow(simulation.image * (0.35 + 0.65 * field), cmap="gray")
    axes.imshow(np.dstack([np.broadcast_to((1.0, 0.6, 0.1), (*edges.shape, 3)), edges]))
    here = project(result.pixel_from_patient, torch.tensor([vertebrae["L2"]]).double())[0]
    axes.plot(column, row, "+", color="#56b4e9", markersize=16, markeredgewidth=2.5, label="L2, true")
    axes.plot(*here.tolist(), "x", color="#e69f00", markersize=11, markeredgewidth=2.5, label="L2, found")
    axes.set(title=f"{name}: {result.status}", xlabel="column (pixel of 2 mm)", ylabel="row (pixel of 2 mm)")
    axes.legend(loc="lower right", fontsize=8)
figure.savefig("narrow_field.png", dpi=100)
