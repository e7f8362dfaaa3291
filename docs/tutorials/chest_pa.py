"""A chest radiograph, PA

A radiograph of the phantom's chest is simulated, then registered. The truth is known, and so is the error.
"""

from pathlib import Path

import torch

from regtorch import evaluate, make_phantom, register, simulate
from regtorch.geometry import Detector
from regtorch.imaging import Radiograph, attenuation
from regtorch.plotting import write_overlay

# ## The patient and the radiograph
#
# The embedded phantom is a torso. Voxels of 5 mm are coarse, and make the page fast to build. `make_phantom` returns
# the CT and the middle of each vertebral body, in LPS mm.

ct, vertebrae = make_phantom(5.0)
detector = Detector(rows=215, columns=175, pixel_mm=2.0)

# The nine parameters are the source, the patient and three angles. Lengths are in mm, angles in radians. The source is
# 30 mm off the detector's middle, the patient is turned by a few degrees, and the chest lies in the image.

truth = torch.tensor([30.0, -20.0, 1040.0, 15.0, -110.0, 190.0, 0.04, -0.06, 0.03])
simulation = simulate(ct, truth, "PA", detector=detector, photons=1e5, targets=vertebrae)
radiograph = Radiograph.from_image(simulation.image, detector)

# ## The registration
#
# `register` knows the view and nothing else. Its start has the source over the detector's middle, 1000 mm away, and the
# CT's middle over the detector's middle.

result = register(ct, radiograph, "PA")
print(result.status, "-", result.message)
for step in result.trace:
    print(f"{step.name:8} {step.pixels:4} pixels  similarity {step.similarity:.3f}  {step.evaluations:5} DRRs")

# ## The error
#
# The projection distance error (PDE) is the mean distance between true and found projections of the vertebrae. It is
# measured in the detector plane. The result also tells the error to expect.

error = evaluate(result.to_dict(), simulation.to_dict())
shown = torch.tensor(list(simulation.targets.values()), dtype=torch.float64)
print(f"PDE {error['pde_mm']:.3f} mm, expected {float(result.expected_errors_mm(shown).mean()):.3f} mm")

# ## The picture
#
# Orange lines are the edges of the registered bones. Blue crosses are the vertebrae, projected by the result.

write_overlay(Path("chest_pa.png"), attenuation(ct, threshold_hu=100.0), radiograph, result, simulation.targets)
