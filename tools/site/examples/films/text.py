"""
Text: one word becomes another
==============================

Letters are drawn by Pillow, and their strokes move as a whole.
"""

import matplotlib.pyplot as plt
import numpy as np
from PIL import Image, ImageDraw, ImageFont

import clmorph


def word(text: str) -> np.ndarray:
    """Return a word in black on white."""
    image = Image.new("RGB", (192, 72), "white")
    font = ImageFont.load_default(size=48)
    ImageDraw.Draw(image).text((96, 36), text, fill="black", font=font, anchor="mm")
    return np.asarray(image)


film = clmorph.morph(word("Monge"), word("Brenier"), n_frames=20)

fig, axes = plt.subplots(3, 2, figsize=(8, 4.6), layout="constrained")
for ax, t in zip(axes.ravel(), (0, 0.2, 0.4, 0.6, 0.8, 1), strict=True):
    ax.imshow(film.frame(t))
    ax.set_title(f"t = {t}")
    ax.axis("off")

# %%

film
