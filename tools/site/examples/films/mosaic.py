"""
Mosaic: blocks move, nothing is blended
=======================================

The preset ``mosaic`` moves blocks of the first picture to their places in the second.
"""

import matplotlib.pyplot as plt
from skimage import data

import clmorph

coffee = clmorph.fit(data.coffee()[:, 100:500], 128)
rocket = clmorph.fit(data.rocket()[:, 100:527], 128)
film = clmorph.morph(coffee, rocket, preset="mosaic", n_frames=20)

fig, axes = plt.subplots(1, 5, figsize=(10, 2.3), layout="constrained")
for ax, t in zip(axes, (0, 0.25, 0.5, 0.75, 1), strict=True):
    ax.imshow(film.frame(t))
    ax.set_title(f"t = {t}")
    ax.axis("off")

# %%

film
