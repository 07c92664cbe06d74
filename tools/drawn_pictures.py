"""Sprites and logos that are drawn without files, for tests and for pictures of the pages."""

import io

import numpy as np
from PIL import Image, ImageDraw

COLORS = {
    ".": (0, 0, 0, 0), "r": (160, 20, 40, 255), "R": (230, 40, 70, 255), "w": (255, 255, 255, 255),
    "p": (120, 120, 230, 255), "k": (20, 20, 30, 255), "g": (90, 200, 90, 255),
}  # fmt: skip
SPRITES = {
    "heart": (
        "............", "...rr..rr...", "..rRRrrRRr..", "..rRwRRRRr..", "...rRRRRr...",
        "....rRRr....", ".....rr.....", "............",
    ),
    "ghost": (
        "............", "....pppp....", "...pppppp...", "..pwwppwwp..", "..pwkppwkp..",
        "..pppppppp..", "..pppppppp..", "..p.pp.pp...",
    ),
    "invader": (
        "............", ".g.......g..", "..ggggggg...", ".gg.ggg.gg..", ".gggggggggg.",
        ".g.ggggg.g..", ".g.g...g.g..", "....gg.gg...",
    ),
}  # fmt: skip


def sprite(name: str, block: int = 1, ground: tuple[int, int, int] | None = None) -> np.ndarray:
    """Return a sprite of 8 x 12 blocks, with opacity unless a background's color is given."""
    levels = np.array([[COLORS[key] for key in row] for row in SPRITES[name]], dtype=np.uint8)
    if ground is not None:
        levels = np.where(levels[..., 3:] > 0, levels[..., :3], np.array(ground, np.uint8))
    return np.kron(levels, np.ones((block, block, 1))) / 255.0


def star_corners() -> list[tuple[float, float]]:
    """Return the corners of a star in a picture of 100 x 100 units."""
    turns, radii = np.arange(10) * np.pi / 5, np.where(np.arange(10) % 2, 19, 42)
    x, y = 50 + radii * np.sin(turns), 50 - radii * np.cos(turns)
    return list(zip(x.tolist(), y.tolist(), strict=True))


def logo(name: str, side: int = 64, *, ground: str | None = "white") -> np.ndarray:
    """Return an anti-aliased logo, with opacity if there is no background."""
    whole = 8 * side
    image = Image.new("RGBA", (whole, whole), ground or (0, 0, 0, 0))
    draw = ImageDraw.Draw(image)

    def at(*values: float) -> tuple[float, ...]:
        return tuple(whole * value / 100 for value in values)

    if name == "star":
        draw.polygon([at(*corner) for corner in star_corners()], fill="#d62728")
    elif name == "disc":
        draw.ellipse(at(28, 28, 72, 72), fill="#1f77b4")
    elif name == "ring":
        draw.ellipse(at(10, 10, 90, 90), fill="#ff7f0e")
        draw.ellipse(at(30, 30, 70, 70), fill=ground or (0, 0, 0, 0))
    else:
        for number, color in enumerate(("#e41a1c", "#377eb8", "#4daf4a")):
            draw.rectangle(at(12 + 28 * number, 60 - 20 * number, 30 + 28 * number, 85), fill=color)
    pixels = np.asarray(image.resize((side, side), Image.Resampling.BOX)) / 255.0
    return pixels if ground is None else pixels[..., :3]


def compressed(image: np.ndarray, quality: int) -> np.ndarray:
    """Return an opaque image after compression as JPEG."""
    stream = io.BytesIO()
    Image.fromarray(np.rint(255 * image).astype(np.uint8)).save(stream, "JPEG", quality=quality)
    return np.asarray(Image.open(stream)) / 255.0
