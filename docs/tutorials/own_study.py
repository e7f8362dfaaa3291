"""An own study

A study is rows: one registration each, of a geometry drawn from a seed. This page registers ten radiographs, keeps
their rows in a CSV file, and draws the errors.
"""

import matplotlib.pyplot as plt
import pandas as pd
import torch

from regtorch import evaluate, make_phantom, register
from regtorch.geometry import Detector
from regtorch.imaging import Radiograph
from regtorch.registration import initial_parameters
from regtorch.simulation import draw_geometry, simulate

# ## The question
#
# Do expected errors follow true errors as noise grows? Five geometries get radiographs with many and with few photons.

ct, vertebrae = make_phantom(5.0)
detector = Detector(rows=130, columns=130, pixel_mm=3.0)
middle = initial_parameters(ct, detector, "PA")
half_range = torch.tensor([25.0, 25.0, 50.0, 25.0, 25.0, 50.0, 0.09, 0.09, 0.09])

# ## The rows
#
# The seed makes the geometry, the noise and the search. The same seed gives the same row.

rows = []
for seed in range(5):
    truth = draw_geometry(ct, middle, half_range, "PA", torch.Generator().manual_seed(seed))
    for photons in (1e6, 2e4):
        made = simulate(ct, truth, "PA", detector=detector, photons=photons, targets=vertebrae, seed=seed)
        result = register(ct, Radiograph.from_image(made.image, detector), "PA", seed=seed)
        targets = torch.tensor(list(made.targets.values()), dtype=torch.float64)
        row = {"seed": seed, "photons": photons, "status": result.status, "drrs": result.evaluations}
        row["pde_mm"] = evaluate(result.to_dict(), made.to_dict())["pde_mm"]
        row["expected_mm"] = float(result.expected_errors_mm(targets).mean())
        row["reasons"] = " ".join(reason.code for reason in result.reasons)
        rows.append(row)
table = pd.DataFrame(rows)
table.to_csv("own_study.csv", index=False)
print(table.groupby("photons")[["pde_mm", "expected_mm", "drrs"]].median().round(3))
print(table.groupby("photons")["status"].value_counts())

# ## The picture
#
# Points on the line have the expected error. The studies of this project have the same form, with settings, shards and
# resumption: see the page on studies.

figure, axes = plt.subplots(figsize=(5, 4.4), layout="constrained")
for photons, colour, marker in ((1e6, "#0072b2", "o"), (2e4, "#d55e00", "s")):
    some = table[table.photons == photons]
    axes.scatter(some.expected_mm, some.pde_mm, color=colour, marker=marker, label=f"{photons:,.0f} photons a pixel")
low, high = table[["pde_mm", "expected_mm"]].min().min() / 2, table[["pde_mm", "expected_mm"]].max().max() * 2
axes.plot([low, high], [low, high], color="black", linewidth=0.8, label="error as expected")
axes.set(xscale="log", yscale="log", xlim=(low, high), ylim=(low, high))
axes.set(xlabel="expected error (mm)", ylabel="true PDE (mm)", title="Ten registrations of the phantom")
axes.legend(fontsize=8)
figure.savefig("own_study.png", dpi=100)
