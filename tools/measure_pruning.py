"""Measure how frames depend on pairs that a plan drops, by the coverage of a pixel.

Random pictures (noise, smooth fields, discs, holes) at random parameters; the plan's kept pairs
beside all of them, in float64. Prints, for each share of the largest pair that is kept: pairs, and
the worst difference of a pixel, in 255ths, for pixels of each coverage: as drawn, and without
filling; then the whole plan's frames beside `clmorph.reference`, which fills nothing.

    python tools/measure_pruning.py --pairs 8
"""

import argparse
import warnings
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter

import clmorph
from clmorph import ConvergenceWarning, Measure, Plan, reference
from clmorph.frames.canvas import canvas_at
from clmorph.frames.kernel_width import KernelWidth, effective_count
from clmorph.frames.render import Sums, render

SIDE = 12
TIMES = (0.2, 0.5, 0.85)
SHARES = (1e-3, 1e-4, 1e-5)
#: Bounds of coverage: kernel mass as a share of an even spread's.
BOUNDS = np.array([0.0, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1])


def picture(rng: np.random.Generator, kind: int) -> np.ndarray:
    """Return a random picture: noise, a smooth field, discs, or discs with holes."""
    if kind == 0:
        return rng.random((SIDE, SIDE, 3))
    if kind == 1:
        field = gaussian_filter(rng.random((SIDE, SIDE, 3)), (2, 2, 0))
        return (field - field.min()) / np.ptp(field)
    y, x = np.mgrid[:SIDE, :SIDE]
    image = np.ones((SIDE, SIDE, 3)) * rng.random(3)
    for _ in range(3):
        center, radius = rng.random(2) * SIDE, 1 + 5 * rng.random()
        image[(x - center[0]) ** 2 + (y - center[1]) ** 2 < radius**2] = rng.random(3)
    if kind == 2:
        return image
    return np.dstack([image, rng.random((SIDE, SIDE)) < 0.4])


def frame(
    source: Measure, target: Measure, plan: Plan, unmatched: str, width: KernelWidth, t: float,
    fill: bool,
) -> Sums:  # fmt: skip
    """Draw a plan in float64, holes and tears filled or not."""
    numpy = clmorph.get_backend("numpy")
    moving = clmorph.particles(source, target, plan, unmatched=unmatched)
    uploaded = numpy.upload_particles(moving.table, moving.links, moving.weights)
    canvas = canvas_at(t, source.shape, target.shape)
    widths = width.widths(t, canvas)
    return render(
        numpy, uploaded, moving.mass(t), t, canvas,
        widths._replace(closed=fill and widths.closed), fill=fill,
    )  # fmt: skip


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=int, default=8, help="pairs of pictures")
    count = parser.parse_args().pairs
    warnings.simplefilter("ignore", ConvergenceWarning)
    numpy = clmorph.get_backend("numpy")
    worst: dict[Any, np.ndarray] = {}
    kept = dict.fromkeys(SHARES, 0)
    for seed in range(count):
        rng = np.random.default_rng(seed)
        weight = rng.choice([0.3, 1.0, 3.0])
        source, target = (clmorph.lift(picture(rng, seed % 4), weight) for _ in range(2))
        blur, reach = rng.choice([0.01, 0.03, 0.1]), rng.choice([0.05, 0.15, 0.3, np.inf])
        solved = clmorph.sinkhorn(source, target, blur, reach, 1e-5, backend=numpy)
        plans = {
            share: clmorph.transport_plan(source, target, solved, relative=share, backend=numpy)
            for share in SHARES
        }
        for share, plan in plans.items():
            kept[share] += len(plan)
        whole = clmorph.transport_plan(source, target, solved, log_threshold=-700.0, backend=numpy)
        dense = whole.to_scipy().toarray()
        for unmatched in ("fade", "drop"):
            masses = whole.marginals
            if unmatched == "fade":
                masses = source.weights, target.weights
            counts = [effective_count(mass) for mass in masses]
            for width in (
                KernelWidth(1.2, 0.5, 0.5, *counts, "adaptive"),
                KernelWidth(0.5, 0.5, 0.0, *counts, "local"),
            ):
                for t in TIMES:
                    beside, bare = (
                        frame(source, target, whole, unmatched, width, t, fill)
                        for fill in (True, False)
                    )
                    for share, plan in plans.items():
                        for fill, wanted in ((True, beside), (False, bare)):
                            found = frame(source, target, plan, unmatched, width, t, fill)
                            add(worst, (share, fill), bare.coverage, found.colors, wanted.colors)
                    if width.splatting == "adaptive":
                        sigma = width.at(t, canvas_at(t, source.shape, target.shape))
                        sums = reference.render(source, target, dense, t, sigma, unmatched)
                        exact = sums[0] / np.maximum(sums[1], 1e-300)[..., None]
                        for fill, found in ((True, beside), (False, bare)):
                            add(worst, ("reference", fill), bare.coverage, found.colors, exact)
    print("worst difference of a pixel in 255ths, by coverage from", *map("{:g}".format, BOUNDS))
    for (share, fill), values in worst.items():
        how = "as drawn" if fill else "unfilled"
        pairs = f"{kept[share]} pairs" if share in kept else "whole plan"
        print(f"{share!s:>10} {how}, {pairs}:", *(f"{255 * value:.2f}" for value in values))


def add(
    worst: dict[Any, np.ndarray], key: Any, coverage: np.ndarray, one: np.ndarray, two: np.ndarray
) -> None:
    """Take note of differences of pixels, by their coverage."""
    values = worst.setdefault(key, np.zeros(len(BOUNDS)))
    differences = np.abs(np.clip(one, 0, 1) - np.clip(two, 0, 1)).max(axis=2)
    np.maximum.at(values, (np.digitize(coverage, BOUNDS) - 1).ravel(), differences.ravel())


if __name__ == "__main__":
    main()
