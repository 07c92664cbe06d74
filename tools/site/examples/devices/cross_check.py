"""
A cross-check against NumPy
===========================

The backend "numpy" computes the same in float64, without any OpenCL. Whatever a device returns can
be compared with it: here potentials, a plan and frames.
"""

import matplotlib.pyplot as plt
import numpy as np
from skimage import data

import clmorph

a = clmorph.fit(data.astronaut()[:256, 100:356], 32)
b = clmorph.fit(data.chelsea()[:, 85:385], 32)
device, numpy = clmorph.get_backend("auto"), clmorph.get_backend("numpy")

source, target = clmorph.lift(a, color_weight=0.5), clmorph.lift(b, color_weight=0.5)
found = [
    clmorph.sinkhorn(source, target, blur=0.05, reach=0.3, tol=1e-5, backend=backend)
    for backend in (device, numpy)
]
difference = np.abs(found[0].f - found[1].f) / found[1].epsilon
plans = [
    clmorph.transport_plan(source, target, each, backend=backend).to_scipy()
    for each, backend in zip(found, (device, numpy), strict=True)
]
films = [clmorph.morph(a, b, n_frames=3, backend=backend) for backend in (device, numpy)]
frames = np.abs(films[0].frame(0.5) - films[1].frame(0.5)).max(axis=2)

print(f"potentials differ by at most {difference.max():.1e} epsilon")
print(f"plans differ by {abs(plans[0] - plans[1]).sum() / plans[1].sum():.1e} of the mass")
print(f"frames differ by at most {255 * frames.max():.2f} of 255 levels")
fig, axes = plt.subplots(1, 3, figsize=(9, 3.2), layout="constrained")
for ax, name, film in zip(axes, ("device", "NumPy"), films, strict=False):
    ax.imshow(film.frame(0.5))
    ax.set_title(name)
fig.colorbar(axes[2].imshow(255 * frames, cmap="magma"), ax=axes[2], label="levels of 255")
axes[2].set_title("difference")
for ax in axes:
    ax.axis("off")
