"""Checks of nearest seeds."""

from collections.abc import Iterator

import numpy as np

from clmorph.backends.comparison import UNIT, Finding
from clmorph.backends.interface import Operations
from clmorph.backends.records import Float32

#: How far a square of a distance may be off, relative to it: four roundings, of each of two seeds.
SEED_TOLERANCE = 10 * UNIT


def seeds_of(shape: tuple[int, int], count: int) -> dict[str, Float32]:
    """Return seeds for a canvas: spread about it, far outside, in few places, and on a lattice."""
    rng = np.random.default_rng(6)
    height, width = shape
    about = rng.uniform(-0.3, 1.3, (count, 2)) * (width, height)
    places = rng.uniform(0.0, 1.0, (5, 2)) * (width, height)
    clusters = places[rng.integers(0, 5, count)] + rng.normal(0.0, 0.1, (count, 2))
    # Ties of any number of seeds, some of them in the same place; all numbers are exact.
    lattice = rng.integers(-2, np.array([width, height]) + 2, (count, 2)) + 0.5
    return {
        "spread": about.astype(np.float32),
        "outside": (about + np.array([40.0 * width, -30.0 * height])).astype(np.float32),
        "in clusters": clusters.astype(np.float32),
        "on a lattice": lattice.astype(np.float32),
    }


def check_nearest_seeds(
    operations: Operations,
    exact: Operations,
    shape: tuple[int, int] = (45, 70),
    count: int = 3000,
) -> Iterator[Finding]:
    """Compare nearest seeds: by their distances and, where these are exact, by their indices."""
    for name, seeds in seeds_of(shape, count).items():
        got, want = (backend.nearest_seeds(seeds, shape) for backend in (operations, exact))
        if name == "on a lattice":
            wrong = float(np.count_nonzero(got != want))
            yield Finding(f"nearest_seeds, {name}", wrong, 0.0, "indices")
            continue
        error = seed_excess(seeds, got, want)
        yield Finding(f"nearest_seeds, {name}", error, SEED_TOLERANCE, "of a squared distance")


def seed_excess(seeds: Float32, got: np.ndarray, want: np.ndarray) -> float:
    """Return how much farther seeds `got` are than `want`: the largest share of a square."""
    if not (got.min() >= 0 and got.max() < len(seeds)):
        return float("inf")
    y, x = np.mgrid[: want.shape[0], : want.shape[1]]
    ours, best = (
        np.square(np.dstack((x, y)) - seeds[each].astype(float)).sum(axis=-1)
        for each in (got, want)
    )
    return float(np.max((ours - best) / np.maximum(best, np.finfo(float).tiny)))
