"""Checks of pictures that are sampled where a smooth motion says."""

from collections.abc import Iterator

import numpy as np

from clmorph.backends.comparison import UNIT, Finding
from clmorph.backends.interface import Operations
from clmorph.backends.records import Motion


def motions(shape: tuple[int, int]) -> dict[str, Motion]:
    """Return motions of a canvas over a picture of some shape: small ones, and far outside."""
    rng = np.random.default_rng(5)
    height, width = shape
    canvas = height + 5, 2 * width + 3
    step = (height - 1) / (canvas[0] - 1), (width - 1) / (canvas[1] - 1)
    return {
        "near": Motion(canvas, (0.0, 0.0), step, rng.normal(0, 3.0, (7, 4, 2))),
        "far": Motion(canvas, (-9.3, 4.1), step, rng.normal(0, 4.0 * max(shape), (3, 5, 2))),
        "one point": Motion(canvas, (0.5, -0.25), (0.0, 0.0), np.full((1, 1, 2), 1.75)),
    }


def check_spline(
    operations: Operations, exact: Operations, shape: tuple[int, int] = (45, 70)
) -> Iterator[Finding]:
    """Compare samples of a random picture, inside it and far outside."""
    coefficients = np.random.default_rng(4).normal(size=(*shape, 3)).astype(np.float32)
    ours, theirs = operations.upload_spline(coefficients), exact.upload_spline(coefficients)
    for name, motion in motions(shape).items():
        first, stop = 3, motion.shape[0] - 1
        got = operations.sample_spline(ours, motion, first, stop)
        want = exact.sample_spline(theirs, motion, first, stop)
        error = float(np.abs(got - want).max())
        yield Finding(f"sample_spline, {name}", error, sample_tolerance(coefficients, motion), "")


def sample_tolerance(coefficients: np.ndarray, motion: Motion) -> float:
    """Return the tolerated error of samples.

    A place is rounded relative to its size, and the slope of the spline is at most the largest
    difference of coefficients.
    """
    largest = float(np.abs(coefficients).max())
    place = max(motion.shape) + float(np.abs(motion.displacements).max()) + 16.0
    return 2 * largest * UNIT * (8 * place + 64)
