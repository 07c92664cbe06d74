"""
A batch of problems at once
===========================

Many small problems are solved together, one launch of a kernel for all of them. Each has the
status, the potentials and the certificate of a solve of its own.
"""

from time import perf_counter

import matplotlib.pyplot as plt
import numpy as np

import clmorph

rng = np.random.default_rng(3)
count, points = 100, 64
weights = np.full((count, points), 1 / points)
x, y = rng.random((2, count, points, 2))
clmorph.sinkhorn_batch((weights[:2], x[:2]), (weights[:2], y[:2]), blur=0.05, reach=0.3)  # warm up

began = perf_counter()
found = clmorph.sinkhorn_batch((weights, x), (weights, y), blur=0.05, reach=0.3)
together = perf_counter() - began
began = perf_counter()
for k in range(10):
    clmorph.sinkhorn((weights[k], x[k]), (weights[k], y[k]), blur=0.05, reach=0.3)
alone = (perf_counter() - began) * count / 10

fig, (left, right) = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
left.bar(["together", "one by one"], [1000 * together, 1000 * alone], color=["C0", "C1"])
left.set_ylabel(f"milliseconds for {count} problems")
right.hist(found.n_iter, bins=np.arange(found.n_iter.min(), found.n_iter.max() + 2) - 0.5)
right.set(xlabel="iterations", ylabel="problems")
print(found, found[3].message)
