"""Lift frames and particles to measures, as the images were, to compare them by transport."""

import numpy as np

from clmorph._shared.typing import Array
from clmorph._shared.validation import check_choice, check_integer, check_number, shown
from clmorph.errors import InputError
from clmorph.frames.render import Sums
from clmorph.frames.sequence import FrameSequence, check_frame_sequence
from clmorph.images.color import from_space
from clmorph.measures.measure import Measure
from clmorph.measures.points import WeightedPoints

#: The rules for the mass of a pixel in a frame's measure: its kernel mass, or equal masses (the
#: paper).
FRAME_WEIGHTS = ("kernel", "uniform")
#: The number of points to which particles are merged before they are compared.
MERGED_POINTS = 8192


def frame_measure(
    morph: FrameSequence, t: float, *, weights: str = "kernel", sums: Sums | None = None
) -> WeightedPoints:
    """Return a frame, or another rendering `sums`, as a measure, lifted as the images were.

    With the weights "kernel" a pixel has the mass that the particles' kernels give it, and the sum
    is the particles' total mass. With "uniform" all pixels have the same mass, and the sum is 1;
    this is the paper's rule, which does not detect holes.
    """
    check_frame_sequence(morph)
    t = check_number("t", t, 0.0, 1.0)
    check_choice("weights", weights, FRAME_WEIGHTS)
    canvas = morph.canvas(t)
    if sums is None:
        sums = morph.sums(t)
        colors = morph.frame(t)[..., :3].astype(float)
    else:
        if not isinstance(sums, Sums) or np.shape(sums.density) != canvas.shape:
            raise InputError(
                f"sums={shown(sums)}: expected what morph.sums returns for the same t, of a frame "
                f"of shape {canvas.shape}"
            )
        colors = from_space(sums.colors, morph.particles.path_space)
    n = canvas.shape[0] * canvas.shape[1]
    masses = np.full(n, 1.0 / n)
    if weights == "kernel":
        masses = np.maximum(sums.density.ravel(), 0.0)
        masses = masses * (morph.particles.mass(t) / masses.sum())
    return WeightedPoints(
        _lifted(morph, canvas.positions().reshape(n, 2), colors.reshape(n, 3)), masses
    )


def particle_measure(
    morph: FrameSequence, t: float, *, max_points: int = MERGED_POINTS
) -> tuple[WeightedPoints, float]:
    """Return the particles at time t as a measure, with close ones merged, and the spread.

    Particles are merged to their centers of mass in cells of one size in position and color, the
    smallest size that leaves at most `max_points`. The spread is the root mean square distance of
    particles to the point they were merged to, in image sides; 0 if none were merged.
    """
    check_frame_sequence(morph)
    t = check_number("t", t, 0.0, 1.0)
    max_points = check_integer("max_points", max_points, 16, 1 << 20)
    moving = morph.particles
    mass = (1 - t) * moving.weights[:, 0] + t * moving.weights[:, 1]
    links = moving.links[mass > 0]
    mass = mass[mass > 0]
    at = (1 - t) * moving.table[links[:, 0], :5] + t * moving.table[links[:, 1], :5]
    points = _lifted(morph, at[:, :2], from_space(at[:, 2:], moving.path_space))
    if len(points) <= max_points:
        return WeightedPoints(points, mass), 0.0
    low, high = points.min(axis=0), points.max(axis=0)
    size = float(np.max(high - low)) / 64
    while True:
        # 12 bits an axis: the cell's number in one integer.
        cells = np.minimum((points - low) / size, 4095).astype(np.int64)
        key = cells @ (np.int64(1) << (12 * np.arange(points.shape[1], dtype=np.int64)))
        _, group = np.unique(key, return_inverse=True)
        count = int(group.max()) + 1
        if count <= max_points:
            break
        size *= max(1.05, (count / max_points) ** 0.25)
    merged = np.asarray(np.bincount(group, mass), float)
    centers = np.column_stack(
        [np.bincount(group, mass * points[:, d]) / merged for d in range(points.shape[1])]
    )
    spread = np.sum(mass * np.sum((points - centers[group]) ** 2, axis=1)) / mass.sum()
    return WeightedPoints(centers, merged), float(np.sqrt(spread))


def _lifted(morph: FrameSequence, positions: Array, colors: Array) -> Array:
    """Return (K, 5) points, lifted as by `Measure.points`."""
    source = morph.source
    return Measure(
        positions, colors, np.ones(len(colors)), source.shape, source.color_weight, source.extent,
        source.color_space, source.color_metric,
    ).points  # fmt: skip
