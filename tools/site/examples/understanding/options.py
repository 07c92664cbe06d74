"""
Blur, reach and color weight side by side
=========================================

The blur says how far mass spreads, the reach how far it travels before it rather fades, and the
color weight how much colors count beside positions.
"""

import matplotlib.pyplot as plt
from skimage import data

import clmorph

cat = clmorph.fit(data.chelsea()[:, 85:385], 64)
coffee = clmorph.fit(data.coffee()[:, 100:500], 64)
choices = {
    "blur": (0.01, 0.03, 0.1),
    "reach": (0.05, 0.3, None),
    "color_weight": (0.1, 0.5, 2.0),
}
fig, axes = plt.subplots(3, 3, figsize=(8, 8.4), layout="constrained")
for row, (option, values) in zip(axes, choices.items(), strict=True):
    for ax, value in zip(row, values, strict=True):
        given = {"blur": 0.03, "reach": 0.3, "color_weight": 0.5} | {option: value}
        film = clmorph.morph(cat, coffee, n_frames=3, detail="particles", **given)
        ax.imshow(film.frame(0.5))
        ax.set_title(f"{option} = {value}" if value else "balanced", fontsize=10)
        ax.axis("off")
fig.suptitle("Halfway, drawn by the particles alone")
