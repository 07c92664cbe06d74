"""
One's own queue and arrays
==========================

A program that uses OpenCL itself gives its queue as ``backend=`` and its arrays as they are:
clmorph reads them in place, and returns results on the device.
"""

import matplotlib.pyplot as plt
import numpy as np
import pyopencl as cl
import pyopencl.array as cl_array

import clmorph

# A program has a queue already; this one takes the device that "auto" means.
device = clmorph.get_backend("auto").device
context = cl.Context([device])
queue = cl.CommandQueue(context)

rng = np.random.default_rng(8)
angle = 2.4 * np.arange(400)
spiral = np.sqrt(np.arange(400) / 400)[:, None] * np.c_[np.cos(angle), np.sin(angle)]
points_a = cl_array.to_device(queue, spiral.astype(np.float32))
points_b = cl_array.to_device(queue, rng.normal(0, 0.4, (400, 2)).astype(np.float32))
masses = cl_array.to_device(queue, np.full(400, 1 / 400, np.float32))

pair = (masses, points_a), (masses, points_b)
potentials = clmorph.sinkhorn(*pair, blur=0.05, backend=queue)
f, g = potentials.to_device(queue)  # arrays on the device, for kernels of the program
print(type(f), f.shape, f.dtype)

fig, axes = plt.subplots(1, 2, figsize=(9, 3.8), layout="constrained")
for ax, points, values, letter in zip(axes, (points_a, points_b), (f, g), "fg", strict=True):
    drawn = ax.scatter(*points.get().T, c=values.get(), s=14)
    fig.colorbar(drawn, ax=ax, label=f"potential {letter}")
    ax.axis("equal")
