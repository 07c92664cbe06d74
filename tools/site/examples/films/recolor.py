"""
The colors of another picture
=============================

`clmorph.recolor` leaves every pixel in its place and moves its color. ``strength`` goes part of the
way.
"""

import matplotlib.pyplot as plt
from skimage import data

import clmorph

photograph = clmorph.fit(data.astronaut(), 192)
like = clmorph.fit(data.coffee(), 192)
recolored = clmorph.recolor(photograph, like)
half = clmorph.recolor(photograph, like, strength=0.5)

fig, axes = plt.subplots(1, 4, figsize=(11, 2.9), layout="constrained")
shown = {"photograph": photograph, "half of the way": half, "all of it": recolored, "like": like}
for ax, (name, picture) in zip(axes, shown.items(), strict=True):
    ax.imshow(picture)
    ax.set_title(name)
    ax.axis("off")

# %%

recolored

# %%
# The change of colors is also a table, by which other pictures are recolored, and clips
# (`clmorph.recolor_clip`). `clmorph.write_lut` writes it for grading programs.

look = clmorph.fit_lut(photograph, like)
clmorph.apply_lut(clmorph.fit(data.chelsea(), 192), look)
