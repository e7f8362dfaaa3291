"""A lateral radiograph of the abdomen

Lateral abdomens are hard: few photons come through, and bone is faint. The radiograph here has moved soft
tissue, noise, scatter, blur and wires. The result says how far to trust it.
"""

from pathlib import Path

import torch

from regtorch import attenuation, evaluate, make_phantom, register
from regtorch.geometry import Detector
from regtorch.imaging import Radiograph
from regtorch.plotting import write_overlay
from regtorch.simulation import realistic

# ## The patient and the radiograph
#
# `realistic` adds the effects that make a radiograph unlike a DRR. Soft tissue has moved by 8 mm RMS against the bones.
# LLAT is the lateral view with the patient's left side on the detector.

ct, vertebrae = make_phantom(5.0)
detector = Detector(rows=200, columns=160, pixel_mm=2.0)
truth = torch.tensor([-20.0, 30.0, 1010.0, 20.0, 60.0, 260.0, -0.05, 0.04, 0.02])
simulation = realistic(ct, truth, "LLAT", detector=detector, targets=vertebrae, seed=1)
radiograph = Radiograph.from_image(simulation.image, detector)

# ## The registration
#
# A rough landmark helps where the patient is far from the middle of the image. Here it is the middle of L3, marked with
# an error of about a centimetre. `landmark_stored` is the (column, row) of the file.

marked = (78.0, 82.0)
result = register(ct, radiograph, "LLAT", landmark_patient_mm=vertebrae["L3"], landmark_stored=marked)
print(result.status, "-", result.message)
for reason in result.reasons:
    print(f"  {reason.code}: {reason.sentence}")

# ## The evidence
#
# The rules judge these numbers. The page on reasons of doubt explains each rule.

evidence = result.evidence
print(f"best start {evidence.best_start:.2f}, mirrored {evidence.mirrored:.2f}, gap {evidence.gap}")
print(f"{evidence.agreeing} of {evidence.starts} starts agree, expected error {evidence.expected_mm:.2f} mm")
print(f"PDE {evaluate(result.to_dict(), simulation.to_dict())['pde_mm']:.2f} mm")

# ## The picture
#
# Wires and letters stay in the picture. Robust weights keep them out of the similarity.

bone = attenuation(ct, threshold_hu=100.0)
write_overlay(Path("lateral_abdomen.png"), bone, radiograph, result, simulation.targets)
