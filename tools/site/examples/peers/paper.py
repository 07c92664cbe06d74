"""
The paper's way of drawing, and how far it moves mass
=====================================================

The preset ``paper`` has the paper's numbers. Its Table 1 measures the mean displacement of pixels
for some color weights; here it is measured between two photographs at the paper's 48 pixels. The
paper's own pictures are not published with it, so the numbers are those of these photographs.
"""

import matplotlib.pyplot as plt
from skimage import data

import clmorph

a = clmorph.fit(data.astronaut()[:256, 100:356], 48)
b = clmorph.fit(data.chelsea()[:, 85:385], 48)
print("color weight  mean displacement  largest  transported")
for color_weight in (0.0, 1.0, 2.0, 4.0):
    found = clmorph.inspect(a, b, preset="paper", color_weight=color_weight, divergence=False)
    moved = found.displacement
    print(
        f"{color_weight:12}  {moved.mean:14.2f} px  {moved.max:4.1f} px  {found.transported:9.1%}"
    )

# %%
# Frames as in the paper, whose ends are seen through the kernel, above the default of clmorph.

fig, axes = plt.subplots(2, 5, figsize=(10, 4.3), layout="constrained")
for row, preset in zip(axes, ("paper", "photo"), strict=True):
    film = clmorph.morph(a, b, preset=preset, n_frames=5)
    for ax, t in zip(row, film.times, strict=True):
        ax.imshow(film.frame(t))
        ax.set_title(f"{preset}, t = {t:.2g}", fontsize=10)
        ax.axis("off")
