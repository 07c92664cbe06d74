"""
Rearranging the pixels of one picture
=====================================

Every pixel of the first picture moves, with its color, to a place of its own, and together they
form the second one. The last frame holds exactly the colors of the first picture.
"""

import matplotlib.pyplot as plt
from skimage import data

import clmorph

coffee = clmorph.fit(data.coffee()[:, 100:500], 96)
cat = clmorph.fit(data.chelsea()[:, 85:385], 96)
film = clmorph.rearrange(coffee, cat, n_frames=16)

fig, axes = plt.subplots(1, 6, figsize=(11, 2.1), layout="constrained")
for ax, t in zip(axes, (0, 0.25, 0.5, 0.75, 1), strict=False):
    ax.imshow(film.frame(t))
    ax.set_title(f"t = {t}")
axes[5].imshow(cat)
axes[5].set_title("what they form")
for ax in axes:
    ax.axis("off")

# %%

film
