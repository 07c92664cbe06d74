"""
An unbalanced plan with weights
===============================

Points have weights, and their sums may differ. With a ``reach`` mass that has no partner nearby
dies, and what is missing is born. ``reach=None`` is balanced transport, and ``reach=(0.3, None)``
balances the target alone.
"""

import matplotlib.pyplot as plt
import numpy as np

import clmorph

x = np.linspace(0, 1, 120)
a = np.exp(-(((x - 0.25) / 0.06) ** 2)) + 0.5 * np.exp(-(((x - 0.8) / 0.04) ** 2))
b = 0.7 * np.exp(-(((x - 0.4) / 0.05) ** 2))
a, b = a / a.sum(), b / a.sum()

fig, axes = plt.subplots(1, 3, figsize=(11, 3.4), layout="constrained", sharey=True)
for ax, reach in zip(axes, (0.05, 0.2, (0.2, None)), strict=True):
    potentials = clmorph.sinkhorn((a, x), (b, x), blur=0.02, reach=reach)
    plan = clmorph.transport_plan((a, x), (b, x), potentials)
    leaving, arriving = plan.marginals
    ax.plot(x, a, color="C0", linestyle=":", label="a")
    ax.plot(x, b, color="C1", linestyle=":", label="b")
    ax.fill_between(x, leaving, color="C0", alpha=0.5, label="leaves a")
    ax.fill_between(x, arriving, color="C1", alpha=0.5, label="arrives in b")
    ax.set_title(f"reach = {reach}: {plan.total_mass:.2f} moves")
axes[0].legend(fontsize=8)

# %%
# The plan as a matrix of SciPy, and as a picture.

print(repr(plan.to_scipy()))
plan
