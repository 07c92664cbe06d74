"""
Sprites: whole pixels move
==========================

Small pictures of few colors choose the preset ``pixel-art``. Every frame has the colors and the
pixels of a sprite.
"""

import matplotlib.pyplot as plt
import numpy as np

import clmorph

HEART = """
..rr..rr..
.rrrrrrrr.
rrwrrrrrrr
rrrrrrrrrr
.rrrrrrrr.
..rrrrrr..
...rrrr...
....rr....
"""
GHOST = """
...bbbb...
..bbbbbb..
.bbbbbbbb.
.bkkbbkkb.
.bkkbbkkb.
.bbbbbbbb.
.bbbbbbbb.
.bb.bb.bb.
"""
COLORS = {".": (20, 20, 40), "r": (224, 58, 62), "w": (255, 230, 230), "b": (90, 180, 255),
          "k": (16, 24, 60)}  # fmt: skip


def sprite(rows: str) -> np.ndarray:
    """Return the picture that letters draw."""
    return np.array([[COLORS[key] for key in row] for row in rows.split()], np.uint8)


film = clmorph.morph(sprite(HEART), sprite(GHOST), n_frames=16)

fig, axes = plt.subplots(1, 6, figsize=(10, 1.7), layout="constrained")
for ax, t in zip(axes, (0, 0.2, 0.4, 0.6, 0.8, 1), strict=True):
    ax.imshow(film.frame(t), interpolation="nearest")
    ax.set_title(f"t = {t}")
    ax.axis("off")

# %%

film
