"""
A matrix of divergences
=======================

All pairs of many measures at once, each with its interval. Multidimensional scaling then draws the
measures by their distances.
"""

import matplotlib.pyplot as plt
import numpy as np

import clmorph

rng = np.random.default_rng(4)
kinds = {"ring": [], "blob": [], "bar": []}
for _ in range(5):
    angle, size = rng.uniform(0, 2 * np.pi, 80), rng.uniform(0.2, 0.4)
    kinds["ring"].append(size * np.c_[np.cos(angle), np.sin(angle)])
    kinds["blob"].append(rng.normal(0, size / 2, (80, 2)))
    kinds["bar"].append(np.c_[rng.uniform(-2 * size, 2 * size, 80), rng.normal(0, 0.03, 80)])
clouds = [cloud for each in kinds.values() for cloud in each]
measures = [(np.full(80, 1 / 80), cloud) for cloud in clouds]
matrix = clmorph.divergence_matrix(measures, blur=0.05, reach=1.0)

# Classical scaling: the divergence is like half a squared distance.
centering = np.eye(len(clouds)) - 1 / len(clouds)
values, vectors = np.linalg.eigh(-centering @ matrix.values @ centering)
places = vectors[:, -2:] * np.sqrt(np.maximum(values[-2:], 0))

fig, (left, right) = plt.subplots(1, 2, figsize=(10, 4.4), layout="constrained")
left.set_title("divergences")
fig.colorbar(left.imshow(matrix.values, cmap="viridis"), ax=left)
for number, name in enumerate(kinds):
    right.scatter(*places[5 * number : 5 * number + 5].T, label=name, s=60)
right.legend()
right.set(title="placed by their distances", xticks=[], yticks=[])
right.margins(0.15)
print(matrix)
