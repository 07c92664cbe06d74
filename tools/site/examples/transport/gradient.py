"""
The gradient of an unbalanced divergence
========================================

Derivatives by points and by weights come in closed form, without recording the iteration. Here they
are drawn, and one of them is compared with a central difference.
"""

import matplotlib.pyplot as plt
import numpy as np

import clmorph

rng = np.random.default_rng(2)
x, y = rng.normal(0, 0.15, (60, 2)), rng.normal([0.4, 0.2], 0.15, (80, 2))
a, b = np.full(60, 1 / 60), np.full(80, 1 / 70)
options = {"blur": 0.05, "reach": 0.5, "tol": 1e-6}
found = clmorph.sinkhorn_divergence((a, x), (b, y), gradient=True, **options)
slope = found.gradient.source_points

plt.figure(figsize=(6, 4.4), layout="constrained")
plt.scatter(*x.T, s=2000 * a, c=found.gradient.source_weights, cmap="coolwarm", label="source")
plt.colorbar(label="derivative by the weight")
plt.scatter(*y.T, s=2000 * b, color="lightgray", label="target")
plt.quiver(*x.T, *-slope.T, width=0.004)
plt.title("Arrows: against the derivative by the point")
plt.axis("equal")

# %%
# The same derivative by two further solves.

step = np.zeros_like(x)
step[0, 0] = 1e-3
ahead, behind = (
    clmorph.sinkhorn_divergence((a, x + sign * step), (b, y), **options) for sign in (1, -1)
)
difference = (float(ahead) - float(behind)) / 2e-3
print(f"closed form {slope[0, 0]:.6f}, difference {difference:.6f}")
