"""Draw the improvements over the paper's frames: ``python tools/draw_comparison.py FILE.png``.

Left as printed in the paper or its code, right as clmorph does it: holes, ends, mud, and the grid
of a coarse image in a fine one.
"""

import argparse
from importlib import resources
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from plain_options import PLAIN
from skimage import data

import clmorph
from clmorph.images.pixels import to_bytes

SIDE, GAP, LABEL = 240, 10, 24
#: What both sides of a row share beside what they differ in.
PAPER = {**PLAIN, "endpoints": "paper", "unmatched": "drop"}
OURS = {**PLAIN, "splatting": "local", "sigma_start": "auto", "sigma_end": "auto"}


def picture(name: str, size: int) -> np.ndarray:
    """Return the middle square of a photograph, reduced, or the bundled cat."""
    if name == "cat":
        with resources.as_file(resources.files("clmorph.cli.samples") / "cat.png") as file:
            return clmorph.fit(clmorph.read_image(file), size)
    pixels = getattr(data, name)() / 255.0
    side = min(pixels.shape[:2])
    top, left = ((length - side) // 2 for length in pixels.shape[:2])
    return clmorph.fit(pixels[top : top + side, left : left + side], size)


def stripes(colors: list[tuple[float, float, float]], size: int) -> np.ndarray:
    """Return an image of horizontal stripes."""
    return np.repeat(np.array(colors), size // len(colors), axis=0)[:, None].repeat(size, axis=1)


def rows(size: int):
    """Yield title, times, and the two morphs of each row."""
    cat, photo = picture("cat", size), picture("chelsea", 4 * size)
    yield (
        "Holes: sprite to photograph of twice its side, each particle in its nearest pixel",
        "local widths",
        (0.5, 0.8),
        clmorph.morph(cat, photo[::2, ::2], n_frames=2, **{**PAPER, "splatting": "none"}),
        clmorph.morph(cat, photo[::2, ::2], n_frames=2, **OURS),
    )
    astronaut, coffee = picture("astronaut", 2 * size), picture("coffee", 2 * size)
    yield (
        "Ends, at t = 0 and 0.1: seen through a kernel of 1.2 pixels",
        "given back, travelling along",
        (0.0, 0.1),
        clmorph.morph(astronaut, coffee, n_frames=2, **PAPER),
        clmorph.morph(astronaut, coffee, n_frames=2, **PLAIN),
    )
    warm, cold = (
        [(0.9, 0.1, 0.1), (0.95, 0.75, 0.1), (0.1, 0.3, 0.9), (0.9, 0.1, 0.8)],
        [(0.1, 0.8, 0.2), (0.2, 0.2, 0.9), (0.95, 0.85, 0.1), (0.1, 0.8, 0.3)],
    )
    ends = stripes(warm, size), stripes(cold, size)
    still = {"reach": None, "color_weight": 0.01}
    yield (
        "Mud: stripes that change color in place, evenly in sRGB",
        "evenly in Oklab",
        (0.35, 0.5),
        clmorph.morph(*ends, n_frames=2, **{**PLAIN, **still, "path_space": "srgb"}),
        clmorph.morph(*ends, n_frames=2, **{**PLAIN, **still, "path_space": "oklab"}),
    )
    coarse, fine = picture("coffee", size // 2), picture("astronaut", 3 * size)
    yield (
        "Grids: a 16-pixel image fades into a 96-pixel one, one width for all",
        "each width from its own spacing",
        (0.4, 0.6),
        clmorph.morph(coarse, fine, n_frames=2, **{**PLAIN, "endpoints": "paper"}),
        clmorph.morph(coarse, fine, n_frames=2, **OURS),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("file", type=Path)
    options = parser.parse_args()
    made = list(rows(32))
    width = 4 * SIDE + 5 * GAP
    page = Image.new("RGB", (width, len(made) * (SIDE + LABEL + GAP) + GAP), "white")
    draw, font = ImageDraw.Draw(page), ImageFont.load_default(14)
    for number, (before, after, times, paper, ours) in enumerate(made):
        top = GAP + number * (SIDE + LABEL + GAP)
        draw.text((GAP, top), before, fill="black", font=font)
        draw.text((3 * GAP + 2 * SIDE, top), after, fill="black", font=font)
        for column, (morph, t) in enumerate([(m, t) for m in (paper, ours) for t in times]):
            frame = Image.fromarray(to_bytes(morph.frame(t)[..., :3]))
            frame = frame.resize((SIDE, SIDE), Image.Resampling.NEAREST)
            page.paste(frame, (GAP + column * (SIDE + GAP), top + LABEL))
    page.save(options.file)


if __name__ == "__main__":
    main()
