"""
Barycenters
===========

The barycenter of two measures is the mean in the sense of the Sinkhorn divergence: halfway in
shape, and no double exposure.
"""

import matplotlib.pyplot as plt
import numpy as np

import clmorph

side = 32
y, x = np.mgrid[-1 : 1 : side * 1j, -1 : 1 : side * 1j]
radius = np.hypot(x, y)
ring = np.exp(-(((radius - 0.7) / 0.1) ** 2))
bars = np.exp(-(((np.abs(x) - 0.5) / 0.12) ** 2)) * (np.abs(y) < 0.8)
shapes = [each / each.sum() for each in (ring, bars)]
densities = [clmorph.density(each) for each in shapes]
cells = densities[0].points

fig, axes = plt.subplots(1, 5, figsize=(11, 2.5), layout="constrained")
for ax, share in zip(axes, (0, 0.25, 0.5, 0.75, 1), strict=True):
    if share in (0, 1):
        shown = shapes[int(share)]
    else:
        mean = clmorph.barycenter(
            densities, weights=[1 - share, share], support=cells, fixed=True, blur=0.04, tol=0.01
        )
        shown = mean.weights
    ax.imshow(np.reshape(shown, (side, side)), cmap="magma")
    ax.set_title(f"{1 - share:g} : {share:g}")
    ax.axis("off")
