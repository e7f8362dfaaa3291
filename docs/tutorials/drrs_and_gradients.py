"""DRRs and gradients from Python

`render` makes DRRs of many poses at once, and is differentiable. `render_with_jacobian` adds the derivative of every
pixel by the nine parameters. This page uses both, and recovers a pose by gradient ascent.
"""

import matplotlib.pyplot as plt
import torch

from regtorch import attenuation, make_phantom, render, render_with_jacobian
from regtorch.geometry import NAMES, Detector
from regtorch.similarity import gradient_correlation

# ## DRRs
#
# `attenuation` turns HU into attenuation per mm. A DRR is the line integral of attenuation. Poses are a tensor of nine
# numbers each, in mm and radians.

ct, _ = make_phantom(5.0)
bone = attenuation(ct, threshold_hu=100.0)
detector = Detector(rows=120, columns=100, pixel_mm=3.5)
pose = torch.tensor([0.0, 0.0, 1000.0, 0.0, 0.0, 200.0, 0.0, 0.0, 0.0], dtype=torch.float64)
poses = pose.repeat(8, 1)
poses[:, NAMES.index("theta")] = torch.linspace(-0.3, 0.3, 8)
print(tuple(render(bone, poses, detector, "PA").shape))

# ## Derivatives
#
# The Jacobian has one image per parameter: attenuation per mm, or per radian.

image, jacobian = render_with_jacobian(bone, pose, detector, "PA")
print(tuple(image.shape), tuple(jacobian.shape))

# ## Gradient ascent
#
# Autograd goes through `render` and through the similarity. Each parameter is scaled by a step of its own, so that one
# rate suits mm and radians.

offset = torch.tensor([0.0, 0.0, 0.0, 6.0, -5.0, 0.0, 0.02, -0.03, 0.03], dtype=torch.float64)
step = torch.tensor([0.0, 0.0, 0.0, 5.0, 5.0, 0.0, 0.03, 0.03, 0.03], dtype=torch.float64)
unknown = torch.zeros(9, dtype=torch.float64, requires_grad=True)
optimizer = torch.optim.Adam([unknown], lr=0.1)
history = []
for _ in range(60):
    optimizer.zero_grad()
    moved = render(bone, pose + offset + unknown * step, detector, "PA")
    similarity = gradient_correlation(moved, image)
    (-similarity).backward()
    optimizer.step()
    history.append(float(similarity.detach()))
left = (offset + unknown.detach() * step)[3:]
print(f"similarity {history[0]:.3f} at first, {max(history):.4f} at best")
print("left over (mm, rad):", [round(value, 4) for value in left.tolist()])

# ## The picture
#
# The Jacobian's image by x_obj shows edges across the columns; its image by theta shows a turn about the vertical axis.

figure, panels = plt.subplots(1, 4, figsize=(11, 3.6), layout="constrained")
panels[0].imshow(image, cmap="gray")
panels[0].set_title("DRR")
for axes, name, unit in ((panels[1], "x_obj", "per mm"), (panels[2], "theta", "per rad")):
    values = jacobian[NAMES.index(name)]
    most = float(values.abs().quantile(0.99))
    shown = axes.imshow(values, cmap="PuOr", vmin=-most, vmax=most)
    axes.set_title(f"derivative by {name}")
    figure.colorbar(shown, ax=axes, shrink=0.8, label=unit)
for axes in panels[:3]:
    axes.set(xlabel="column (pixel)", ylabel="row (pixel)")
panels[3].plot(history, color="#0072b2")
panels[3].set(xlabel="step", ylabel="gradient correlation", title="ascent")
figure.savefig("drrs_and_gradients.png", dpi=80)
