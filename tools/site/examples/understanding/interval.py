"""
A distance with a proven interval
=================================

`clmorph.sinkhorn_divergence` returns a value and an interval that certainly holds the true one,
rounding included. Two distances can be compared for certain only if their intervals are apart.
"""

import matplotlib.pyplot as plt
import numpy as np

import clmorph

rng = np.random.default_rng(0)
masses = np.full(200, 1 / 200)
cloud = rng.normal(0, 0.1, (200, 2))
shifts = np.linspace(0, 0.5, 6)
fig, (left, right) = plt.subplots(1, 2, figsize=(10, 3.8), layout="constrained")
left.plot(shifts, shifts**2 / 2, color="black", linewidth=1, label="truth: half the squared shift")
for tol, color, width in ((0.3, "C1", 9), (0.03, "C0", 4)):
    found = [
        clmorph.sinkhorn_divergence(
            (masses, cloud), (masses, cloud + np.array([shift, 0])), blur=0.05, reach=None, tol=tol
        )
        for shift in shifts
    ]
    low, high = np.transpose([each.interval for each in found])
    left.vlines(shifts, low, high, color=color, linewidth=width, alpha=0.6, label=f"tol {tol:g}")
    right.semilogy(shifts, high - low, "o-", color=color, label=f"tol {tol:g}")
    assert np.all((low <= shifts**2 / 2) & (shifts**2 / 2 <= high))
left.set(xlabel="shift of a cloud", ylabel="divergence from the cloud, balanced")
right.set(xlabel="shift", ylabel="width of the interval")
left.legend()
right.legend()

# %%
# Is the smaller shift surely nearer? ``None`` would say that nothing is proven.

print(found[1].closer_than(found[2]))
found[2]
