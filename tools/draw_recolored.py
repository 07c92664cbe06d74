"""Draw photographs with the colors of others: ``python tools/draw_recolored.py out.png``.

Each row shows a photograph, the one whose colors it takes, what two usual methods make of it (mean
and standard deviation of each channel of CIELAB: Reinhard et al. 2001; histograms of each channel),
and `clmorph.recolor`. ``--time`` measures a picture of a megapixel in its place.
"""

import argparse
import time
import warnings
from pathlib import Path

import numpy as np
from PIL import Image
from skimage import color, data, exposure

import clmorph

#: Photographs and those whose colors they take.
PAIRS = (("astronaut", "coffee"), ("coffee", "rocket"), ("rocket", "chelsea"))
#: Left, top and side of the square that is taken of each photograph, and the side of the drawing.
CUTS = {
    "astronaut": (60, 0, 380),
    "coffee": (100, 0, 400),
    "rocket": (160, 27, 400),
    "chelsea": (75, 0, 300),
}
DRAWN = 176
#: Side of the picture that is measured, in pixels.
SIDE = 1024


def square(name: str) -> np.ndarray:
    """Return the square of a photograph, reduced: (DRAWN, DRAWN, 3) floats."""
    left, top, side = CUTS[name]
    cut = Image.fromarray(getattr(data, name)()[top : top + side, left : left + side])
    return np.asarray(cut.resize((DRAWN, DRAWN), Image.Resampling.LANCZOS)) / 255


def by_moments(image: np.ndarray, like: np.ndarray) -> np.ndarray:
    """Match mean and standard deviation of each channel of CIELAB."""
    ours, theirs = (color.rgb2lab(each).reshape(-1, 3) for each in (image, like))
    shares = theirs.std(axis=0) / ours.std(axis=0)
    moved = (ours - ours.mean(axis=0)) * shares + theirs.mean(axis=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # colors that sRGB does not have
        return np.clip(color.lab2rgb(moved.reshape(image.shape)), 0, 1)


def draw(path: Path, device: str) -> None:
    """Draw a row for each pair."""
    rows = []
    for names in PAIRS:
        image, like = map(square, names)
        matched = exposure.match_histograms(image, like, channel_axis=2)
        found = clmorph.recolor(image, like, backend=device)
        rows.append(np.hstack([image, like, by_moments(image, like), matched, found]))
    clmorph.write_image(path, np.vstack(rows))


def measure(device: str) -> None:
    """Print the seconds of a megapixel of 8 bits and of 16, stage by stage; twice each."""
    operations = clmorph.get_backend(device)
    image, like = (
        np.asarray(Image.fromarray(getattr(data, name)()).resize((SIDE, SIDE)))
        for name in ("astronaut", "coffee")
    )
    # Most pixels of 16 bits have colors of their own.
    deep = 256 * image.astype(np.uint16) + np.random.default_rng(0).integers(
        0, 256, image.shape, np.uint16
    )
    print(f"{SIDE} x {SIDE} pixels on {operations.description}")
    for bits, picture in ((8, image), (16, deep)):
        for run in ("first", "second"):
            began, done = time.perf_counter(), {}

            def report(stage: str, share: float, began: float = began, done: dict = done) -> None:
                done[stage] = time.perf_counter() - began

            clmorph.recolor(picture, like, backend=operations, progress=report)
            done["all"] = time.perf_counter() - began
            stages = ", ".join(f"{stage} after {seconds:.2f} s" for stage, seconds in done.items())
            print(f"{bits} bits, {run} run: {stages}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("output", type=Path, nargs="?")
    parser.add_argument("--device", default="auto")
    parser.add_argument("--time", action="store_true")
    given = parser.parse_args()
    if given.output is not None:
        draw(given.output, given.device)
    if given.time:
        measure(given.device)


if __name__ == "__main__":
    main()
