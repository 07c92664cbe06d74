"""Landmarks: pairs of points that correspond in two images, and the cost that keeps them so.

A warp of the source's positions alone does not hold landmarks: transport spreads mass evenly and so
undoes the warp. Three things together hold them. The cost compares the target's positions with
those of the source under a thin-plate spline T, which maps each landmark to its partner and the
border to the border (Bookstein, 1989). The source's masses are multiplied by the Jacobian
determinant of T, as the masses of a change of variables are, so that T itself transports them where
both images have even masses. And both sides have bumps around the landmarks as further coordinates,
phi(z) = (z, h exp(-|z - q|^2 / (2 r^2))), a function of the position z in the target's frame: it
costs nothing along T and makes every other way past a landmark longer.

References
----------
Bookstein (1989), "Principal warps: thin-plate splines and the decomposition of deformations", IEEE
Transactions on Pattern Analysis and Machine Intelligence 11(6), 567-585.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from clmorph._shared.typing import Array, IntArray
from clmorph.backends.interface import MAX_DIMENSION
from clmorph.errors import InputError
from clmorph.measures.landmark_options import Landmarks
from clmorph.measures.measure import Measure

#: Standard deviation of a bump, in sides of the image, and its height, in units of the cost's
#: coordinates. Lower ones hold less against colors, and broader ones are mistaken for those with
#: which they share a coordinate (``tools/draw_landmarks.py --measure``).
RADIUS, HEIGHT = 0.04, 1.5
#: Rounds in which landmarks choose a coordinate.
ROUNDS = 10
#: Least standard deviation, in pixels: the grid must resolve a bump.
LEAST_PIXELS = 3.0
#: Fixed points along a side of the image's border.
ALONG_A_SIDE = 5
#: Least distance of a fixed border point from a landmark, in sides of the image.
CLEARANCE = 0.03


def guided(
    source: Measure,
    target: Measure,
    landmarks: Landmarks,
    shapes: Sequence[tuple[int, int]] | None = None,
) -> tuple[Measure, Measure]:
    """Return measures between which transport keeps landmarks together.

    Parameters
    ----------
    source, target : Measure
        Lifted images, as `clmorph.measures.lift_pair.lift_pair` returns them.
    landmarks : sequence of ((x, y), (x', y'))
        A point of the source and its partner in the target, in pixels: x to the right, y down, and
        (0, 0) the center of the first pixel.
    shapes : pair of (height, width), optional
        Shapes of the images in whose pixels the landmarks are given; those of the measures if
        missing.

    Returns
    -------
    source, target : Measure
        Copies with `warped` positions and masses of the source, and `features` on both sides. The
        total of the masses is unchanged.

    Raises
    ------
    InputError
        If a landmark is outside its image, two landmarks are the same point, the warp through the
        pairs folds, or the cost has no room for features.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> from clmorph.measures.landmarks import guided
    >>> flat = clmorph.lift(np.ones((33, 33)))
    >>> source, target = guided(flat, flat, [((16, 16), (18, 16))])
    >>> (32 * source.warped[16 * 33 + 16]).round(6).tolist()
    [18.0, 16.0]
    >>> source.points.shape, target.points.shape
    ((1089, 6), (1089, 6))
    """
    if not landmarks:
        return source, target
    if source.has_metric_map:
        raise InputError(
            "landmarks and a color_metric of each pixel exclude one another: give one metric for "
            "all pixels, or no landmarks"
        )
    pairs = np.asarray(landmarks, float).reshape(-1, 2, 2)
    sides = [
        _in_frame(pairs[:, side], measure, shapes[side] if shapes else measure.shape, "ab"[side])
        for side, measure in enumerate((source, target))
    ]
    for side, (places, measure) in enumerate(zip(sides, (source, target), strict=True)):
        _check_apart(places, measure, "ab"[side])
    warped = _warp(sides[0], sides[1], source, target)
    masses = source.weights * _jacobian(warped, source, target, sides[0])
    total = masses.sum()
    if total <= 0:
        raise InputError("landmarks: the warp leaves no mass in image_a; move them less")
    channels = _channels(sides[1], MAX_DIMENSION - source.points.shape[1])
    radius = bump_radius(source, target)
    return (
        replace(
            source, warped=warped, weights=masses * (source.mass / total),
            features=_joined(source.features, _bumps(warped, sides[1], channels, radius)),
        ),
        replace(
            target,
            features=_joined(target.features, _bumps(target.positions, sides[1], channels, radius)),
        ),
    )  # fmt: skip


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
    low, high = _corners(measure)
    # The frame's corners are the centers of the outermost pixels.
    inner = np.array(measure.shape[::-1], float)
    pixel = (pixels + 0.5) / size * inner - 0.5
    return low + pixel / (inner - 1) * (high - low)


def _corners(measure: Measure) -> tuple[Array, Array]:
    return measure.positions.min(axis=0), measure.positions.max(axis=0)


def _check_apart(places: Array, measure: Measure, which: str) -> None:
    """Refuse two landmarks within a pixel, between which no spline can distinguish."""
    from scipy.spatial import cKDTree

    near = sorted(cKDTree(places).query_pairs(0.999 * measure.spacing))
    if near:
        one, other = near[0]
        raise InputError(
            f"landmarks {one + 1} and {other + 1} are the same pixel of image_{which}, at the size "
            "at which it is drawn: leave one out, or give a larger size"
        )


def _warp(starts: Array, ends: Array, source: Measure, target: Measure) -> Array:
    """Return the source's positions under the thin-plate spline: (N, 2) array."""
    from scipy.interpolate import RBFInterpolator
    from scipy.spatial import cKDTree

    steps = np.linspace(0.0, 1.0, ALONG_A_SIDE)
    grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    border = grid[np.any((grid == 0) | (grid == 1), axis=1)]
    both = [low + border * (high - low) for low, high in map(_corners, (source, target))]
    clear = np.ones(len(border), bool)
    for fixed, marks in zip(both, (starts, ends), strict=True):
        clear &= cKDTree(marks).query(fixed)[0] > CLEARANCE
    knots = [np.vstack((marks, fixed[clear]))
             for marks, fixed in zip((starts, ends), both, strict=True)]  # fmt: skip
    spline = RBFInterpolator(knots[0], knots[1], kernel="thin_plate_spline")
    return np.asarray(spline(source.positions), float)


def _jacobian(warped: Array, source: Measure, target: Measure, marks: Array) -> Array:
    """Return the Jacobian determinant of the warp at each pixel, (N,), in units of its mean.

    Raises
    ------
    InputError
        If it is not positive somewhere: there the warp folds the image.
    """
    height, width = source.shape
    field = warped.reshape(height, width, 2)
    down: Array = np.asarray(np.gradient(field, axis=0))
    right: Array = np.asarray(np.gradient(field, axis=1))
    found = (right[..., 0] * down[..., 1] - right[..., 1] * down[..., 0]).ravel()
    low, high = _corners(target)
    usual = float(np.prod((high - low) / (np.array([width, height]) - 1)))
    least = int(np.argmin(found))
    if found[least] <= 0.0:
        near = int(np.argmin(np.sum((marks - source.positions[least]) ** 2, axis=1)))
        y, x = divmod(least, width)
        raise InputError(
            f"landmarks: the warp through them folds the image near landmark {near + 1} (around "
            f"pixel {x}, {y} of image_a as drawn): neighbors cross or move too differently; "
            "correct or leave out one of them"
        )
    return found / usual


def _channels(places: Array, most: int) -> IntArray:
    """Assign landmarks (n, 2) to coordinates, so that those which share one are far apart.

    Each landmark in turn joins the coordinate whose nearest landmark is the farthest from it, in
    several rounds, the first of which finds the coordinates empty.
    """
    if most < 1:
        raise InputError(
            f"landmarks need a coordinate of the cost, but it has {MAX_DIMENSION} at most, and all "
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


def _joined(features: Array | None, more: Array) -> Array:
    return more if features is None else np.column_stack((features, more))
