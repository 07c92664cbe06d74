"""Pairs of pictures by which frames are judged: photographs, drawings, and own deformations."""

import numpy as np
from drawn_pictures import star_corners
from PIL import Image, ImageDraw, ImageFont
from scipy.ndimage import gaussian_filter, map_coordinates
from skimage import data

Picture = np.ndarray

#: The longer side of all pictures, in pixels.
SIDE = 256
#: Photographs, each with (left, top, width, height) of what is taken of it; none: all of it.
CUTS = {
    "portrait": ("astronaut", (100, 0, 256, 256)),
    "standing": ("astronaut", (60, 0, 320, 480)),
    "photographer": ("camera", (120, 40, 256, 256)),
    "cat": ("chelsea", (85, 0, 300, 300)),
    "galaxies": ("hubble_deep_field", (0, 0, 800, 800)),
    **{name: (name, None) for name in ("coffee", "rocket", "camera", "moon", "retina")},
    **{name: (name, None) for name in ("brick", "gravel", "coins", "page")},
}
PHOTOGRAPHS = [
    ("portrait", "photographer"),
    ("portrait", "cat"),
    ("cat", "portrait"),
    ("standing", "coffee"),
    ("rocket", "coffee"),
    ("moon", "galaxies"),
    ("retina", "moon"),
    ("camera", "rocket"),
    ("brick", "gravel"),
    ("coins", "page"),
    ("left eye", "right eye"),
]
DRAWINGS = [("star", "shapes"), ("face", "house"), ("Monge", "Sinkhorn")]
#: Photographs that are paired with their own smooth deformation.
DEFORMED = ["cat", "rocket", "camera", "page"]


def picture(name: str) -> Picture:
    """Return a picture by its name: (H, W, 3) array in [0, 1]."""
    if name in ("left eye", "right eye"):
        whole = Image.fromarray(data.stereo_motorcycle()[name == "right eye"])
    elif name in CUTS:
        source, cut = CUTS[name]
        whole = Image.fromarray(getattr(data, source)()).convert("RGB")
        if cut:
            left, top, width, height = cut
            whole = whole.crop((left, top, left + width, top + height))
    else:
        whole = _drawn(name)
    scale = SIDE / max(whole.size)
    size = tuple(round(side * scale) for side in whole.size)
    return np.asarray(whole.resize(size, Image.Resampling.LANCZOS)) / 255.0


def _drawn(name: str) -> Image.Image:
    """Draw a picture of 100 x 100 units."""
    unit = 2 * SIDE / 100
    image = Image.new("RGB", (2 * SIDE, 2 * SIDE), "white")
    draw = ImageDraw.Draw(image)

    def at(*values: float) -> tuple[float, ...]:
        return tuple(unit * value for value in values)

    if name == "star":
        draw.polygon([at(*corner) for corner in star_corners()], fill="#d62728")
    elif name == "shapes":
        draw.ellipse(at(15, 20, 70, 75), fill="#1f77b4")
        draw.rectangle(at(60, 60, 90, 90), fill="#2ca02c")
    elif name == "face":
        draw.ellipse(at(20, 10, 80, 90), fill="#ffd9a0", outline="black", width=8)
        for x in (38, 62):
            draw.ellipse(at(x - 6, 35, x + 6, 43), fill="white", outline="black", width=5)
            draw.ellipse(at(x - 2, 37, x + 2, 41), fill="black")
        draw.arc(at(35, 50, 65, 75), 20, 160, fill="red", width=10)
    elif name == "house":
        draw.rectangle(at(0, 70, 100, 100), fill="#79b15a")
        draw.rectangle(at(25, 40, 75, 80), fill="#e8c9a0", outline="black", width=8)
        draw.polygon([at(18, 42), at(50, 12), at(82, 42)], fill="#b5442e", outline="black")
        draw.rectangle(at(45, 58, 57, 80), fill="#6b3f1d")
    else:
        font = ImageFont.load_default(size=20 * unit)
        draw.text(at(50, 45), name, fill="black", font=font, anchor="mm")
    return image


def deformed(image: Picture, seed: int, size: float = 0.06) -> tuple[Picture, Picture]:
    """Return a smooth deformation of a picture halfway, and as a whole.

    Parameters
    ----------
    image : (H, W, 3) array
    seed : int
    size : float
        The longest displacement, as a share of the width. It falls to 0 at the border.
    """
    height, width = image.shape[:2]
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width].astype(float)
    window = np.sin(np.pi * (x + 0.5) / width) * np.sin(np.pi * (y + 0.5) / height)
    noise = rng.normal(size=(2, height, width))
    field = np.array([gaussian_filter(part, 0.15 * width, mode="wrap") for part in noise])
    field *= np.minimum(1, 3 * window)
    field *= size * width / np.abs(field).max()

    def at(t: float) -> Picture:
        places = np.stack((y, x))
        for _ in range(40):
            moved = [map_coordinates(part, places, order=1, mode="nearest") for part in field]
            places = np.stack((y, x)) - t * np.array(moved)
        channels = np.moveaxis(image, -1, 0)
        warped = [map_coordinates(part, places, order=3, mode="nearest") for part in channels]
        return np.clip(np.stack(warped, axis=-1), 0, 1)

    return at(0.5), at(1.0)


def psnr(image: Picture, truth: Picture) -> float:
    """Return the peak signal-to-noise ratio of an image, in dB."""
    return float(-10 * np.log10(np.mean((image - truth) ** 2)))
