"""
Point clouds
============

The solver takes weighted points in 1 to 1,024 dimensions, and returns potentials and a sparse
plan.
"""

import matplotlib.pyplot as plt
import numpy as np

import clmorph

rng = np.random.default_rng(1)
angle = rng.uniform(0, 2 * np.pi, 150)
ring = np.c_[np.cos(angle), np.sin(angle)] * rng.normal(1, 0.05, (150, 1))
blobs = rng.normal(0, 0.15, (120, 2)) + rng.choice([[-0.5, 0], [0.5, 0]], 120)
a, b = np.full(150, 1 / 150), np.full(120, 1 / 120)

potentials = clmorph.sinkhorn((a, ring), (b, blobs), blur=0.1)
plan = clmorph.transport_plan((a, ring), (b, blobs), potentials)

plt.figure(figsize=(5.5, 5.5), layout="constrained")
share = plan.mass / plan.mass.max()
for i, j, s in zip(plan.rows, plan.indices, share, strict=True):
    if s > 0.05:
        plt.plot(*np.c_[ring[i], blobs[j]], color="gray", alpha=0.4 * s, linewidth=0.8)
plt.scatter(*ring.T, s=14, label="source")
plt.scatter(*blobs.T, s=14, label="target")
plt.legend(loc="upper right")
plt.axis("equal")
plt.axis("off")
print(potentials.message)

# %%

plan
