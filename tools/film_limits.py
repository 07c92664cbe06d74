"""Measure what films cannot beat: ``python tools/film_limits.py``.

The first table is of the bench's pairs (`bench_films.py`): the ghost (the mean over t = 1/4, 1/2,
3/4) and the share in place at 1/2 of the film, of the same film without any mixing, and of a wipe
in place. Without mixing each pixel shows one moved picture alone, cut hard, so that what it has of
both measures is of borders between regions, and of pictures that are like one another.

The second table is of flat discs, drawn exactly: what a crisp figure that moves or grows has of
the measures that were made for photographs; and of a film between two pictures of unlike shapes
that are made square before: without that, each frame is brought to one shape to measure it.

The third table is of drawings before a flat ground, whose figures alone move: how far the low
bands of the ink of films, and of wipes in place, are from the masses of the films' own plans.

``--only NAME`` takes the pairs with NAME in their names.
"""

import argparse
from unittest.mock import patch

import numpy as np
from bench_films import FLICKER_FRAMES, FRAMES, PLAIN, over, wipe
from benching import line, print_head
from picture_pairs import FILM_PAIRS, Picture
from PIL import Image, ImageDraw
from scipy.ndimage import gaussian_filter

import clmorph
from clmorph.analysis.metrics import crossfade_share, film_measures, ghost
from clmorph.frames import layers, pictures
from clmorph.images.pixels import resized

#: Pairs of drawings before a flat ground.
DRAWN = ("star, ring", "face, house", "HELLO, WORLD", "A, S", "M, W", "drawn cat, dog")
#: A pair of pictures of unlike shapes.
UNLIKE = "standing, coffee"
TIMES = (0.25, 0.5, 0.75)
SIDE, RED, ORANGE = 256, np.array([214, 39, 40]), np.array([255, 127, 14])
#: Center, radius and color of discs at time t.
DISCS = {
    "moves by its radius": lambda t: (108 + 40 * t, 40, RED),
    "grows to four times its radius": lambda t: (128, 20 + 60 * t, RED),
    "shrinks, and changes its color": lambda t: (128, 90 - 50 * t, (1 - t) * RED + t * ORANGE),
}


def film(ends: tuple[Picture, Picture]) -> list[Picture]:
    """Return the frames at the three times, opacity over gray."""
    made = clmorph.morph(*ends, n_frames=FRAMES, **PLAIN)
    return [over(made.frame(t), 0.5) for t in TIMES]


def cut(ends: tuple[Picture, Picture]) -> list[Picture]:
    """Return the same frames without any mixing."""

    def switched(times: np.ndarray, agreement: np.ndarray, t: float) -> np.ndarray:
        agreement[:] = 0  # The frame is drawn by it, too.
        return (times < t).astype(float)

    with patch.object(layers, "switched", switched), patch.object(pictures, "MEAN_SHARE", 0.0):
        return film(ends)


def judged(frames: list[Picture], ends: tuple[Picture, Picture]) -> tuple[float, float]:
    """Return the ghost, in units of a cross-fade's, and the share in place."""
    first, last = (resized(over(end, 0.5), frames[1].shape[:2]) for end in ends)
    base = np.mean([ghost((1 - t) * first + t * last, first, last) for t in TIMES])
    found = np.mean([ghost(frame, first, last) for frame in frames])
    return float(found / max(base, 1e-9)), crossfade_share(frames[1], first, last)


def wiped(ends: tuple[Picture, Picture]) -> list[Picture]:
    shape = np.maximum(ends[0].shape[:2], ends[1].shape[:2])
    frames = wipe(*(resized(over(end, 0.5), tuple(shape)) for end in ends), FRAMES)
    return [frames[round(t * (FRAMES - 1))] for t in TIMES]


def ink(frame: Picture) -> Picture:
    """Return how much darker than white an opaque frame is: (H, W)."""
    return 1 - frame.mean(axis=2)


def from_masses(ends: tuple[Picture, Picture]) -> list[float]:
    """Return how far the film and a wipe in place are from the masses of the film's plan.

    The distances are root mean squares of what a Gaussian of a sixteenth of the longer side leaves,
    in percent of black, and means over the three times.
    """
    made = clmorph.morph(*ends, n_frames=FRAMES, **PLAIN)
    moving = made.particles
    height, width = ends[0].shape[:2]
    longer, box = max(height, width), ((0, height), (0, width))
    areas = [ink(end).sum() for end in ends]
    squares = []
    for t, of_wipe in zip(TIMES, wiped(ends), strict=True):
        shares = (1 - t, t)
        places = sum(s * moving.table[moving.links[:, n], :2] for n, s in enumerate(shares))
        x, y = ((places - 0.5) * (longer - 1) + (width / 2, height / 2)).T
        mass, *_ = np.histogram2d(y, x, (height, width), box, weights=moving.weights @ shares)
        mass *= np.dot(shares, areas) / mass.sum()
        apart = [
            gaussian_filter(ink(each) - mass, longer / 16) for each in (made.frame(t), of_wipe)
        ]
        squares.append(np.mean(np.square(apart), axis=(1, 2)))
    return [float(value) for value in 100 * np.sqrt(squares).mean(axis=0)]


def disc(x: float, radius: float, color: np.ndarray) -> Picture:
    """Return an anti-aliased disc on white."""
    image = Image.new("RGB", (8 * SIDE, 8 * SIDE), "white")
    box = [8 * (x - radius), 4 * SIDE - 8 * radius, 8 * (x + radius), 4 * SIDE + 8 * radius]
    ImageDraw.Draw(image).ellipse(box, fill=tuple(np.rint(color).astype(int).tolist()))
    return np.asarray(image.resize((SIDE, SIDE), Image.Resampling.BOX)) / 255.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="", metavar="NAME")
    options = parser.parse_args()
    pairs = [pair for pair in FILM_PAIRS if options.only in pair]
    drawn = [pair for pair in DRAWN if options.only in pair]
    if not pairs:
        parser.error(f"no pair has {options.only!r} in its name: {'; '.join(FILM_PAIRS)}")
    print_head("pair", "ghost: film", "no mixing", "wipe", "share: film", "no mixing", "wipe")
    for pair in pairs:
        try:
            ends = FILM_PAIRS[pair]()
        except ImportError as error:
            print(line(pair, f"left out: {error}", *5 * [""]), flush=True)
            continue
        ghosts, shares = zip(*(judged(way(ends), ends) for way in (film, cut, wiped)), strict=True)
        print(line(pair, *(f"{value:.2f}" for value in ghosts + shares)), flush=True)
    print()
    print_head("film", "sharp", "uneven", "flicker")
    times = np.linspace(0, 1, FLICKER_FRAMES)
    made = {f"disc {name}": [disc(*at(t)) for t in times] for name, at in DISCS.items()}
    square = [resized(end, (SIDE, SIDE)) for end in FILM_PAIRS[UNLIKE]()]
    made[f"{UNLIKE}, made square"] = list(clmorph.morph(*square, n_frames=FLICKER_FRAMES, **PLAIN))
    for name, frames in made.items():
        found = film_measures(frames)
        sharp = " ".join(f"{value:.2f}" for value in found.relative_sharpness)
        print(line(name, sharp, f"{found.unevenness:.2f}", f"{found.flicker:.2f}"))
    print()
    print_head("drawing", "from its masses: film", "wipe")
    for pair in drawn:
        apart = from_masses(FILM_PAIRS[pair]())
        print(line(pair, *(f"{value:.1f}" for value in apart)), flush=True)


if __name__ == "__main__":
    main()
