"""The check of nearest seeds."""

import numpy as np

from clmorph.backends.opencl.build.variants import Variant
from clmorph.backends.opencl.verification.bench import Bench, Findings, check
from clmorph.backends.opencl.verification.findings import UNIT, Finding, count_differences
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
    outside = about + np.array([40.0 * width, -30.0 * height])
    made = {"spread": about, "outside": outside, "in clusters": clusters, "on a lattice": lattice}
    return {name: seeds.astype(np.float32) for name, seeds in made.items()}


@check("nearest_seeds.cl")
def nearest_seeds(bench: Bench, variant: Variant) -> Findings:
    """Compare nearest seeds: by their distances and, where these are exact, by their indices."""
    shape, count = ((120, 160), 20_000) if bench.pictures else ((45, 70), 3000)
    for name, seeds in seeds_of(shape, count).items():
        got, want = (x.nearest_seeds(seeds, shape) for x in bench.both)
        if name == "on a lattice":
            yield Finding(f"nearest_seeds, {name}", count_differences(got, want), 0.0, "indices")
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
