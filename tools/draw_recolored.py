"""Draw photographs with the colors of others: ``python tools/draw_recolored.py out.png``.

Each row shows a photograph, the one whose colors it takes, what two usual methods make of it (mean
and standard deviation of each channel of CIELAB: Reinhard et al. 2001; histograms of each channel),
and `clmorph.recolor`. ``--compare`` prints how far the colors of each are from those that they
should be, and ``--time`` what a picture of a megapixel takes.
"""

import time
import warnings
from pathlib import Path

import numpy as np
from drawing import parser, square
from PIL import Image
from skimage import color, data, exposure

import clmorph
from clmorph.images.color import to_space

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
#: Blur of the distances between colors, and the share of pixels whose colors are compared.
BLUR, EVERY = 0.05, 5
#: Side of the picture that is measured, in pixels.
SIDE = 1024


def photograph(name: str) -> np.ndarray:
    """Return the square of a photograph, reduced: (DRAWN, DRAWN, 3) floats."""
    return square(name, CUTS[name], DRAWN) / 255


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
        image, like = map(photograph, names)
        made = by_methods(image, like, device)
        rows.append(np.hstack([image, like, *list(made.values())[1:4]]))
    clmorph.write_image(path, np.vstack(rows))


def by_methods(image: np.ndarray, like: np.ndarray, device: str) -> dict[str, np.ndarray]:
    """Return the picture itself, and with the colors of another one by each method."""
    return {
        "as it is": image,
        "mean and deviation": by_moments(image, like),
        "histograms": exposure.match_histograms(image, like, channel_axis=2),
        "recolor": clmorph.recolor(image, like, backend=device),
        "recolor, balanced": clmorph.recolor(image, like, reach=None, backend=device),
    }


def compare(device: str) -> None:
    """Print sqrt(2 S) between the colors in Oklab, S being the Sinkhorn divergence."""

    def colors(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        points = to_space(image.reshape(-1, 3)[::EVERY], "oklab")
        return np.full(len(points), 1 / len(points)), points

    for number, names in enumerate(PAIRS):
        image, like = map(photograph, names)
        made = by_methods(image, like, device)
        if number == 0:
            print(f"| colors | {' | '.join(made)} |\n|---|{'---|' * len(made)}")
        found = [
            clmorph.sinkhorn_divergence(colors(each), colors(like), BLUR, tol=1e-2, backend=device)
            for each in made.values()
        ]
        values = " | ".join(f"{np.sqrt(2 * each.value):.3f}" for each in found)
        print(f"| {names[0]} as {names[1]} | {values} |")


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
    options = parser(__doc__, optional=True)
    options.add_argument("--compare", action="store_true")
    options.add_argument("--time", action="store_true")
    given = options.parse_args()
    if given.output is not None:
        draw(given.output, given.device)
    if given.compare:
        compare(given.device)
    if given.time:
        measure(given.device)


if __name__ == "__main__":
    main()
