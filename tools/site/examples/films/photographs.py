"""
A film of two photographs
=========================

Two pictures go in, a film comes out. The object is the film: a notebook, and this page, shows it to
play with, and `save` writes it as GIF, MP4, WebM, WebP, APNG or a page.
"""

import matplotlib.pyplot as plt
from skimage import data

import clmorph

cat = clmorph.fit(data.chelsea()[:, 85:385], 128)
astronaut = clmorph.fit(data.astronaut()[:256, 100:356], 128)
film = clmorph.morph(astronaut, cat, n_frames=20)

fig, axes = plt.subplots(1, 5, figsize=(10, 2.3), layout="constrained")
for ax, t in zip(axes, (0, 0.25, 0.5, 0.75, 1), strict=True):
    ax.imshow(film.frame(t))
    ax.set_title(f"t = {t}")
    ax.axis("off")

# %%
# The film itself.

film

# %%
# With pictures of your own, from Python or in a terminal::
#
#     film = clmorph.morph(clmorph.read_image("a.png"), clmorph.read_image("b.jpg"))
#     film.save("film.gif")
#
#     clmorph morph a.png b.jpg -o film.gif
