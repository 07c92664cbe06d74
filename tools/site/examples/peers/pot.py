"""
The same problem in POT
=======================

Both libraries solve one entropic, unbalanced problem to the same answer. `clmorph.pot.solve_sample`
takes POT's arguments, so that one line changes.
"""

from time import perf_counter

import matplotlib.pyplot as plt
import numpy as np
import ot

import clmorph.pot

rng = np.random.default_rng(5)
sizes, times, errors = (128, 256, 512, 1024), [], []
for n in sizes:
    x, y = rng.random((2, n, 2))
    # Both cost and entropy as POT has them: |x - y|^2, reg = 2 blur^2, unbalanced = 2 reach^2.
    options = {"reg": 0.02, "unbalanced": 0.2}
    row = []
    for solve in (clmorph.pot.solve_sample, ot.solve_sample):
        more = {"tol": 1e-9, "max_iter": 10_000} if solve is ot.solve_sample else {"tol": 1e-6}
        solve(x, y, **options, **more)  # the first call at a size prepares kernels
        tries = []
        for _ in range(3):
            began = perf_counter()
            plan = solve(x, y, **options, **more).plan
            tries.append(perf_counter() - began)
        row.append((min(tries), plan))
    times.append([seconds for seconds, _ in row])
    errors.append(np.abs(row[0][1] - row[1][1]).sum() / row[1][1].sum())

fig, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
left.loglog(sizes, times, "o-", label=["clmorph", "POT"])
left.set(xlabel="points", ylabel="seconds, with the dense plan")
left.legend()
right.loglog(sizes, errors, "o-", color="C2")
right.set(xlabel="points", ylabel="difference of the plans, share of the mass", ylim=(1e-9, 1e-5))
for ax in (left, right):
    ax.set_xticks(sizes, sizes)
    ax.xaxis.minorticks_off()
