"""
The same divergence in GeomLoss
===============================

`clmorph.geomloss.SamplesLoss` takes GeomLoss's arguments. GeomLoss ends at the end of a schedule
and clmorph when it has converged, so the values of a fine schedule come closer to each other.
"""

from time import perf_counter

import geomloss
import matplotlib.pyplot as plt
import torch

import clmorph.geomloss

generator = torch.Generator().manual_seed(0)
x = torch.rand(800, 2, generator=generator, dtype=torch.float64)
y = torch.rand(800, 2, generator=generator, dtype=torch.float64) * 0.7
ours = clmorph.geomloss.SamplesLoss("sinkhorn", p=2, blur=0.05, reach=0.5)


def timed(loss):
    """Return the value of a loss, and the best of three times after a first call."""
    value, times = loss(x, y).item(), []
    for _ in range(3):
        began = perf_counter()
        loss(x, y)
        times.append(perf_counter() - began)
    return value, min(times)


value, best = timed(ours)
seconds, errors = {"clmorph": best}, {}
for scaling in (0.5, 0.9, 0.98):
    theirs = geomloss.SamplesLoss(
        "sinkhorn", p=2, blur=0.05, reach=0.5, scaling=scaling, backend="tensorized"
    )
    found, best = timed(theirs)
    errors[f"scaling {scaling}"] = abs(found / value - 1)
    seconds[f"scaling {scaling}"] = best

fig, (left, right) = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
left.bar(seconds.keys(), seconds.values(), color=["C0", "C1", "C1", "C1"])
left.set(ylabel="seconds, 800 points", yscale="log")
right.bar(errors.keys(), errors.values(), color="C1")
right.set(ylabel="relative difference from clmorph", yscale="log")
print(f"divergence {value:.6g}")
