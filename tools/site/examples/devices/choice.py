"""
Choosing a device
=================

``backend=`` takes part of a device's name, an index as `clmorph devices` prints it, "numpy", or
"auto", which is the best usable one. ``CLMORPH_DEVICE`` sets what "auto" means, and ``--device`` is
the same on the command line.
"""

from time import perf_counter

import matplotlib.pyplot as plt
import numpy as np

import clmorph

rng = np.random.default_rng(7)
weights, clouds = np.full(2000, 1 / 2000), rng.random((2, 2000, 3))
pair = [(weights, cloud) for cloud in clouds]

seconds = {}
for name in ("auto", "numpy"):
    backend = clmorph.get_backend(name)
    print(f"{name}: {backend.description}")
    clmorph.sinkhorn(*pair, blur=0.05, reach=0.3, backend=backend)  # the first call prepares
    began = perf_counter()
    clmorph.sinkhorn(*pair, blur=0.05, reach=0.3, backend=backend)
    seconds[name] = perf_counter() - began

# One device by its name, here the one that "auto" has found; `clmorph devices` lists all.
name = clmorph.get_backend("auto").description.split(" (")[0]
found = clmorph.sinkhorn(*pair, blur=0.05, reach=0.3, backend=name)
print(f"on {name!r}: {found.message}")

plt.figure(figsize=(6, 2), layout="constrained")
plt.barh(list(seconds), list(seconds.values()), color=["C0", "C1"])
plt.xscale("log")
plt.xlim(left=0.005)
plt.xlabel("seconds for 2000 × 2000 points")
