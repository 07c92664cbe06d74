"""
Rows of a plan: where the mass of a pixel goes
==============================================

A plan is a sparse matrix with a row for each pixel of the first picture. A row says where its mass
goes; here a few rows are drawn over the second picture.
"""

import matplotlib.pyplot as plt
import numpy as np
from skimage import data

import clmorph

source = clmorph.lift(clmorph.fit(data.astronaut()[:256, 100:356], 48), color_weight=0.5)
target = clmorph.lift(clmorph.fit(data.chelsea()[:, 85:385], 48), color_weight=0.5)
potentials = clmorph.sinkhorn(source, target, blur=0.03, reach=0.3)
plan = clmorph.transport_plan(source, target, potentials)
rows = plan.to_scipy()

fig, axes = plt.subplots(2, 4, figsize=(10, 5), layout="constrained")
places = [(12, 24), (20, 34), (30, 8), (40, 30)]
for (above, below), (y, x) in zip(axes.T, places, strict=True):
    above.imshow(source.colors.reshape(48, 48, 3))
    above.plot(x, y, "o", markersize=9, markerfacecolor="none", markeredgecolor="cyan")
    below.imshow(target.colors.reshape(48, 48, 3).mean(axis=2), cmap="gray", alpha=0.5)
    row = rows[[48 * y + x]].toarray().reshape(48, 48)
    below.imshow(np.ma.masked_less(row, row.max() / 100), cmap="plasma")
    for ax in (above, below):
        ax.axis("off")
axes[0, 0].set_title("a pixel")
axes[1, 0].set_title("where its mass goes")

# %%
# The whole plan: each line stands for some neighboring pixels.

plan
