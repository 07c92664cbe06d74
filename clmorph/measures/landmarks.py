"""Landmarks: pairs of points that correspond in two images, and the cost that keeps them so.

A warp of the source's positions alone does not hold landmarks: transport spreads mass evenly and so
undoes it. Three things together hold them. The cost compares the target's positions with those of
the source under a warp T (`clmorph.measures.warp`), which maps each landmark to its partner. The
source's masses are multiplied by the Jacobian determinant of T, so that T itself transports them
where both images have even masses. And both sides have bumps around the landmarks as further
coordinates,

    phi(z) = (z, h exp(-|z - q|^2 / (2 r^2))),

a function of the position z in the target's frame: it costs nothing along T and makes every other
way past a landmark longer.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from clmorph._shared.typing import Array, IntArray
from clmorph.backends.interface import MAX_LIFTED
from clmorph.errors import InputError
from clmorph.measures.landmark_options import Landmarks
from clmorph.measures.measure import Measure, with_more
from clmorph.measures.warp import corners, warp

#: Standard deviation of a bump, in sides of the image, and its height, in units of the cost's
#: coordinates. Lower ones hold less against colors, and broader ones are mistaken for those with
#: which they share a coordinate (``tools/draw_landmarks.py --measure``).
RADIUS, HEIGHT = 0.04, 1.5
#: Rounds in which landmarks choose a coordinate.
ROUNDS = 10
#: Least standard deviation, in pixels: the grid must resolve a bump.
LEAST_PIXELS = 3.0


class Guided(NamedTuple):
    """Measures between which transport keeps landmarks together; see `guided`."""

    source: Measure
    target: Measure
    misses: Array


def guided(
    source: Measure,
    target: Measure,
    landmarks: Landmarks,
    shapes: Sequence[tuple[int, int]] | None = None,
) -> Guided:
    """Return measures between which transport keeps landmarks together.

    A landmark ((x, y), (x', y')) is a point of the source and its partner in the target, in pixels
    of images of `shapes` (height, width), by default those of the measures: x to the right, y down,
    from the center of the first pixel. The measures are copies with `warped` positions and masses
    of the source, and `features` on both sides, whose total mass is unchanged. `misses`, (n,),
    tells how far the warp misses each partner, in pixels of the target's image as it was given.
    """
    if not landmarks:
        return Guided(source, target, np.zeros(0))
    if source.has_metric_map:
        raise InputError(
            "landmarks cannot be combined with a color_metric for each pixel: give one metric for "
            "all pixels, or no landmarks"
        )
    pairs = np.asarray(landmarks, float).reshape(-1, 2, 2)
    shapes = shapes or (source.shape, target.shape)
    starts = _in_frame(pairs[:, 0], source, shapes[0], "a")
    ends = _in_frame(pairs[:, 1], target, shapes[1], "b")
    warped, areas, missed = warp(starts, ends, source, target)
    masses = source.weights * areas
    total = masses.sum()
    channels = _channels(ends, MAX_LIFTED - source.points.shape[1])
    radius = bump_radius(source, target)
    moved = replace(source, warped=warped, weights=masses * (source.mass / total))
    return Guided(
        with_more(moved, _bumps(warped, ends, channels, radius)),
        with_more(target, _bumps(target.positions, ends, channels, radius)),
        missed * max(shapes[1]),
    )


def _in_frame(pixels: Array, measure: Measure, shape: tuple[int, int], which: str) -> Array:
    """Return the positions of pixels (n, 2) of an image, which the measure shows, in its frame."""
    size = np.array(shape[::-1], float)
    outside = np.any((pixels < -0.5) | (pixels > size - 0.5), axis=1)
    if outside.any():
        k = int(np.argmax(outside))
        x, y = pixels[k]
        raise InputError(
            f"landmark {k + 1} is at ({x:g}, {y:g}), outside image_{which} of {shape[1]} x "
            f"{shape[0]} pixels: expected 0 to {shape[1] - 1} and 0 to {shape[0] - 1}"
        )
    if min(measure.shape) < 4:
        raise InputError(
            f"landmarks need images of 4 x 4 pixels or more, but image_{which} has "
            f"{measure.shape[1]} x {measure.shape[0]}"
        )
    low, high = corners(measure)
    # The frame's corners are the centers of the outermost pixels.
    inner = np.array(measure.shape[::-1], float)
    pixel = (pixels + 0.5) / size * inner - 0.5
    return low + pixel / (inner - 1) * (high - low)


def _channels(places: Array, most: int) -> IntArray:
    """Assign landmarks (n, 2) to coordinates, so that those which share one are far apart.

    Each landmark in turn joins the coordinate whose nearest landmark is the farthest from it, in
    several rounds, the first of which finds the coordinates empty.
    """
    if most < 1:
        raise InputError(
            f"landmarks need a coordinate of the cost, but it has {MAX_LIFTED} at most, and all "
            "are taken: give fewer features"
        )
    if len(places) <= most:
        return np.arange(len(places))
    distances = np.linalg.norm(places[:, None] - places, axis=2)
    np.fill_diagonal(distances, np.inf)
    found = np.full(len(places), -1, np.int64)
    for _ in range(ROUNDS):
        for k, row in enumerate(distances):
            taken = found >= 0
            nearest = np.full(most, np.inf)
            np.minimum.at(nearest, found[taken], row[taken])
            found[k] = int(np.argmax(nearest))
    return found


def bump_radius(source: Measure, target: Measure) -> float:
    """Return the standard deviation of the bumps between two measures, in sides of the image."""
    return max(RADIUS, LEAST_PIXELS * max(source.spacing, target.spacing))


def _bumps(positions: Array, places: Array, channels: IntArray, radius: float) -> Array:
    """Return the bumps around landmarks at positions (N, 2): (N, coordinates) array."""
    found = np.zeros((len(positions), int(channels.max()) + 1))
    for place, channel in zip(places, channels, strict=True):
        squares = np.sum((positions - place) ** 2, axis=1)
        found[:, channel] += HEIGHT * np.exp(-squares / (2 * radius**2))
    return found
