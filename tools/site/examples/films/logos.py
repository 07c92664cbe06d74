"""
Logos: shapes become shapes
===========================

Two flat drawings choose the preset ``logo`` by themselves: the ground stays, all of the figure
moves, and outlines stay sharp.
"""

import matplotlib.pyplot as plt
import numpy as np

import clmorph

y, x = np.mgrid[-1:1:128j, -1:1:128j]
angle, radius = np.arctan2(x, -y), np.hypot(x, y)
star = np.where((radius < 0.35 + 0.45 * np.abs(np.cos(2.5 * angle)) ** 1.5)[..., None],
                [0.84, 0.15, 0.16], 1.0)  # fmt: skip
ring = np.where(((radius > 0.42) & (radius < 0.78))[..., None], [0.12, 0.47, 0.71], 1.0)
film = clmorph.morph(star, ring, n_frames=20)

fig, axes = plt.subplots(1, 6, figsize=(10, 1.9), layout="constrained")
for ax, t in zip(axes, (0, 0.2, 0.4, 0.6, 0.8, 1), strict=True):
    ax.imshow(film.frame(t))
    ax.set_title(f"t = {t}")
    ax.axis("off")

# %%

film
