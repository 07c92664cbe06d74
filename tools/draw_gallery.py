"""Morph six kinds of pairs with the defaults, to be judged by eye.

``python tools/draw_gallery.py FOLDER`` leaves a contact sheet and a page for each pair, and
``gallery.png``, the best three, which the README shows.
"""

import argparse
import shutil
from pathlib import Path

import numpy as np
from PIL import Image
from skimage import data

from clmorph.cli.main import main as clmorph

DATA = Path(__file__).parents[1] / "clmorph" / "cli" / "samples"
#: Frames of each row of the README's picture, and the height of its pictures.
COLUMNS, HEIGHT = 7, 160
BEST = ("photo-photo", "sprite-photo", "sprite-sprite")


def pictures() -> dict[str, Image.Image]:
    """Return photographs (bundled with scikit-image) and the package's own sprites."""
    astronaut = Image.fromarray(data.astronaut())
    chelsea = Image.fromarray(data.chelsea())
    found = {
        "astronaut": astronaut.crop((100, 0, 356, 256)),
        "chelsea": chelsea.crop((85, 0, 385, 300)),
        "portrait": astronaut.crop((60, 0, 380, 480)),
        "coffee": Image.fromarray(data.coffee()),
        "cat": Image.open(DATA / "cat.png").resize((96, 96), Image.Resampling.NEAREST),
        "toadstool": Image.open(DATA / "toadstool.png").resize((96, 96), Image.Resampling.NEAREST),
        "small-cat": Image.open(DATA / "cat.png"),
        "small-toadstool": Image.open(DATA / "toadstool.png"),
    }
    cut = chelsea.crop((85, 0, 385, 300)).convert("RGBA")
    y, x = np.mgrid[-1:1:300j, -1:1:300j]
    soft = np.clip((1 - np.hypot(x * 1.05, y * 1.15)) * 12, 0, 1)
    cut.putalpha(Image.fromarray((soft * 255).astype(np.uint8)))
    return found | {"oval": cut}


PAIRS = {
    "photo-photo": ("astronaut", "chelsea"),
    "sprite-photo": ("cat", "chelsea"),
    "photo-sprite": ("astronaut", "toadstool"),
    "sprite-sprite": ("small-cat", "small-toadstool"),
    "portrait-landscape": ("portrait", "coffee"),
    "alpha": ("oval", "toadstool"),
}


def strip(folder: Path) -> Image.Image:
    """Return some of a folder's frames side by side, on white."""
    files = sorted(folder.iterdir())
    chosen = [files[i] for i in np.linspace(0, len(files) - 1, COLUMNS).round().astype(int)]
    frames = []
    for file in chosen:
        frame = Image.open(file).convert("RGBA")
        factor = HEIGHT / frame.height
        small = frame.height < 64
        how = Image.Resampling.NEAREST if small else Image.Resampling.BICUBIC
        frames.append(frame.resize((round(frame.width * factor), HEIGHT), how))
    row = Image.new("RGB", (sum(frame.width + 8 for frame in frames) - 8, HEIGHT), "white")
    x = 0
    for frame in frames:
        row.paste(frame, (x, 0), frame)
        x += frame.width + 8
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", choices=list(PAIRS), action="append")
    parser.add_argument("--more", default="", help="options of clmorph morph for all pairs")
    arguments = parser.parse_args()
    folder = arguments.folder
    folder.mkdir(parents=True, exist_ok=True)
    inputs = folder / "inputs"
    inputs.mkdir(exist_ok=True)
    for name, picture in pictures().items():
        picture.save(inputs / f"{name}.png")
    for name, pair in PAIRS.items():
        if arguments.only and name not in arguments.only:
            continue
        images = [str(inputs / f"{image}.png") for image in pair]
        options = arguments.more.split()
        outputs = [folder / f"{name}{ending}" for ending in (".png", ".html")]
        frames = folder / f"{name}-frames"
        shutil.rmtree(frames, ignore_errors=True)
        places = [word for path in (*outputs, frames) for word in ("-o", str(path))]
        assert clmorph(["morph", *images, *places, *options]) == 0
    if not all((folder / f"{name}-frames").is_dir() for name in BEST):
        return
    rows = [strip(folder / f"{name}-frames") for name in BEST]
    width = max(row.width for row in rows)
    whole = Image.new("RGB", (width, len(rows) * (HEIGHT + 12) - 12), "white")
    for number, row in enumerate(rows):
        whole.paste(row, ((width - row.width) // 2, number * (HEIGHT + 12)))
    whole.save(folder / "gallery.png", optimize=True)


if __name__ == "__main__":
    main()
