"""
Several devices share the work
==============================

A list of devices divides the frames of a film. Here a device and NumPy share one, because every
machine has these two; on one with two graphics cards it would be ``backend=["0:0", "0:1"]``.
"""

import matplotlib.pyplot as plt
import numpy as np
from skimage import data

import clmorph

a = clmorph.fit(data.astronaut()[:256, 100:356], 32)
b = clmorph.fit(data.coffee()[:, 100:500], 32)
both = clmorph.get_backend([clmorph.get_backend("auto"), "numpy"])
print(both.description)
film = clmorph.morph(a, b, n_frames=6, backend=both)
alone = clmorph.morph(a, b, n_frames=6)

fig, axes = plt.subplots(1, 6, figsize=(10, 2), layout="constrained")
for number, ax in enumerate(axes):
    ax.imshow(film[number])
    ax.set_title(f"frame {number}")
    ax.axis("off")
most = max(np.abs(film[k] - alone[k]).max() for k in range(6))
print(f"frames differ from those of one device by at most {255 * most:.2f} of 255 levels")
