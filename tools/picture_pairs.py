"""Pairs of pictures by which frames are judged: photographs, drawings, and own deformations."""

from collections.abc import Callable

import numpy as np
from drawn_pictures import logo, sprite, star_corners
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
    """Return a smooth deformation of a picture (H, W, 3) halfway, and as a whole.

    The longest displacement is the share `size` of the width. It falls to 0 at the border.
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


def square(name: str) -> Picture:
    """Return the middle of a photograph of scikit-image: (256, 256, 3) array."""
    whole = np.asarray(Image.fromarray(getattr(data, name)()).convert("RGB")) / 255.0
    top, left = ((side - SIDE) // 2 for side in whole.shape[:2])
    return whole[top : top + SIDE, left : left + SIDE]


def samples() -> tuple[Picture, Picture]:
    """Return the photographs of scikit-learn, a temple and a flower."""
    from sklearn.datasets import load_sample_images

    pictures = (Image.fromarray(image) for image in load_sample_images().images)
    small = [each.resize((SIDE, SIDE * each.height // each.width)) for each in pictures]
    return np.asarray(small[0]) / 255.0, np.asarray(small[1]) / 255.0


def drawing(draw_on: Callable[[ImageDraw.ImageDraw], None], width: int, height: int) -> Picture:
    """Return what a function draws on white, of twice the size before it is reduced."""
    image = Image.new("RGB", (2 * width, 2 * height), "white")
    draw_on(ImageDraw.Draw(image))
    return np.asarray(image.resize((width, height), Image.Resampling.LANCZOS)) / 255.0


def word(text: str) -> Picture:
    """Return a word, or a letter, in black on white."""
    width, height = (SIDE, SIDE) if len(text) == 1 else (SIDE, SIDE // 2)
    font = ImageFont.load_default(size=1.5 * SIDE if len(text) == 1 else 0.55 * SIDE)

    def draw_on(draw: ImageDraw.ImageDraw) -> None:
        draw.text((width, height), text, fill="black", font=font, anchor="mm")

    return drawing(draw_on, width, height)


#: Lines as corners in a picture of 100 x 100 units, and ellipses as boxes; the last are filled.
ANIMALS = {
    "cat": (
        [
            [(24, 48), (22, 12), (42, 28), (58, 28), (78, 12), (76, 48), (72, 72), (50, 86),
             (28, 72), (24, 48)],
            [(44, 62), (50, 67), (56, 62), (44, 62)], [(50, 67), (50, 73), (43, 77)],
            [(50, 73), (57, 77)], [(36, 66), (8, 60)], [(36, 70), (8, 73)], [(64, 66), (92, 60)],
            [(64, 70), (92, 73)],
        ],
        [(33, 42, 45, 54), (55, 42, 67, 54)],
        [(37, 43, 41, 53), (59, 43, 63, 53)],
    ),
    "dog": (
        [
            [(32, 24), (50, 18), (68, 24), (74, 44), (70, 60), (64, 84), (50, 90), (36, 84),
             (30, 60), (26, 44), (32, 24)],
            [(32, 24), (16, 28), (10, 50), (14, 70), (24, 66), (28, 44)],
            [(68, 24), (84, 28), (90, 50), (86, 70), (76, 66), (72, 44)],
            [(50, 70), (50, 78), (41, 82)], [(50, 78), (59, 82)],
        ],
        [(36, 38, 46, 48), (54, 38, 64, 48)],
        [(39, 41, 44, 46), (57, 41, 62, 46), (42, 60, 58, 71)],
    ),
}  # fmt: skip


def animal(name: str) -> Picture:
    """Return the face of a cat or a dog, drawn in lines."""
    lines, rings, spots = ANIMALS[name]
    unit = 2 * SIDE / 100

    def draw_on(draw: ImageDraw.ImageDraw) -> None:
        for line in lines:
            corners = [(unit * x, unit * y) for x, y in line]
            draw.line(corners, fill="black", width=round(2 * unit), joint="curve")
        for box in rings:
            draw.ellipse([unit * side for side in box], outline="black", width=round(1.5 * unit))
        for box in spots:
            draw.ellipse([unit * side for side in box], fill="black")

    return drawing(draw_on, SIDE, SIDE)


def oval(name: str) -> Picture:
    """Return a photograph within a soft oval, transparent around it."""
    image = picture(name)
    y, x = (np.linspace(-1, 1, side) for side in image.shape[:2])
    alpha = np.clip(12 * (1 - np.hypot(1.15 * y[:, None], 1.3 * x)), 0, 1)
    return np.dstack((image, alpha))


def with_its_deformation(name: str, seed: int) -> tuple[Picture, Picture]:
    """Return a picture and its own smooth deformation."""
    first = picture(name)
    return first, deformed(first, seed)[1]


#: Pairs by which films are judged.
FILM_PAIRS: dict[str, Callable[[], tuple[Picture, Picture]]] = {
    "astronaut, cat": lambda: (square("astronaut"), square("chelsea")),
    "coffee, rocket": lambda: (square("coffee"), square("rocket")),
    "astronaut, camera": lambda: (square("astronaut"), square("camera")),
    "china, flower": samples,
    "standing, coffee": lambda: (picture("standing"), picture("coffee")),
    "brick, gravel": lambda: (picture("brick"), picture("gravel")),
    "left eye, right eye": lambda: (picture("left eye"), picture("right eye")),
    "sprites": lambda: (sprite("ghost"), sprite("heart")),
    "enlarged sprites": lambda: (sprite("invader", 8, (9, 9, 40)), sprite("ghost", 8, (9, 9, 40))),
    "star, ring": lambda: (logo("star", 128), logo("ring", 128)),
    "face, house": lambda: (picture("face"), picture("house")),
    "HELLO, WORLD": lambda: (word("HELLO"), word("WORLD")),
    "A, S": lambda: (word("A"), word("S")),
    "M, W": lambda: (word("M"), word("W")),
    "drawn cat, dog": lambda: (animal("cat"), animal("dog")),
    "clear star, bars": lambda: (logo("star", 128, ground=None), logo("bars", 128, ground=None)),
    "ovals": lambda: (oval("cat"), oval("portrait")),
    "cat deformed 0": lambda: with_its_deformation("cat", 0),
    "face deformed 0": lambda: with_its_deformation("face", 0),
}
DEFORMATIONS = [(name, seed) for name in DEFORMED for seed in (0, 1, 2)] + [("face", 0)]
