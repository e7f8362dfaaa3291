"""6 against 9 degrees of freedom

A C-arm is calibrated, so six degrees of freedom are left: the patient's pose. A mobile unit is not. This page registers
one radiograph both ways, with a source that is not where the calibration says.
"""

import matplotlib.pyplot as plt
import torch

from regtorch import evaluate, make_phantom, register, simulate
from regtorch.geometry import NAMES, Detector
from regtorch.imaging import Radiograph

# ## The patient and the radiograph
#
# The source is 40 mm right of and 30 mm below its assumed place. The SDD is 60 mm longer.

ct, vertebrae = make_phantom(5.0)
detector = Detector(rows=180, columns=150, pixel_mm=2.2)
truth = torch.tensor([40.0, -30.0, 1060.0, 10.0, -30.0, 200.0, 0.03, -0.05, 0.04])
simulation = simulate(ct, truth, "PA", detector=detector, threshold_hu=100.0, targets=vertebrae)
radiograph = Radiograph.from_image(simulation.image, detector)

# ## Two registrations
#
# `free=6` freezes the source at (0, 0, 1000) mm. The default search releases the source once at its end. The move of
# the image after this release is an error to expect.

errors, results = {}, {}
for free in (9, 6):
    result = results[free] = register(ct, radiograph, "PA", free=free)
    found = evaluate(result.to_dict(), simulation.to_dict())
    errors[free] = list(found["parameter_errors"].values())
    print(f"{free} degrees of freedom: {result.status}, PDE {found['pde_mm']:.3f} mm")
    print(f"  {result.message}")

# ## The picture
#
# With six degrees of freedom the patient moves to make up for the source. With nine, all parameters are found.

figure, (lengths, angles) = plt.subplots(
    1, 2, figsize=(8, 3.6), layout="constrained", gridspec_kw={"width_ratios": [2, 1]}
)
for axes, part, unit in ((lengths, slice(0, 6), "mm"), (angles, slice(6, 9), "degrees")):
    place = torch.arange(len(NAMES[part])).double()
    for offset, free, colour, hatch in ((-0.2, 9, "#0072b2", ""), (0.2, 6, "#e69f00", "//")):
        axes.bar(place + offset, errors[free][part], 0.4, color=colour, hatch=hatch, label=f"{free} free")
    axes.axhline(0, color="black", linewidth=0.8)
    axes.set(xticks=place, xticklabels=NAMES[part], ylabel=f"found less true ({unit})")
lengths.legend()
figure.suptitle("Errors of the nine parameters")
figure.savefig("degrees_of_freedom.png", dpi=100)
