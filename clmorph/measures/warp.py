"""A warp of positions through landmarks that does not fold.

The warp is a base map followed by a flow. The base is the affine map of one picture's border onto
the other's. Landmarks then move on straight lines from where the base puts them to their partners,
and in each of several steps a thin-plate spline (F. L. Bookstein, "Principal warps", IEEE
Transactions on Pattern Analysis and Machine Intelligence 11(6), 567-585, 1989) through their
velocities, which are zero at the border, moves all positions. Small steps do not fold, so neither
does their composition, as long as the lines do not meet (S. C. Joshi and M. I. Miller, "Landmark
matching via large deformation diffeomorphisms", IEEE Transactions on Image Processing 9(8),
1357-1370, 2000). Where the flow still folds or squeezes too much, the base becomes the similarity
that fits the landmarks best, so that the border is free, and then the splines are smoothed more and
more, so that they miss landmarks. One landmark gives a shift, and two a similarity.

Landmarks contradict each other if their order is reversed from one picture to the other.
"""

from typing import NamedTuple

import numpy as np

from clmorph._shared.typing import Array, BoolArray
from clmorph.errors import InputError
from clmorph.measures.measure import Measure

#: Largest stretch with which the border is mapped to the border, of all but a twentieth of the
#: pixels; beyond it the border is free.
MOST_STRETCH = 2.5
#: Steps of the flow.
STEPS = 8
#: Smoothing of the splines, in turn, until the warp does not fold.
SMOOTHING = (0.0, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1)
#: Strictness with which landmarks that are found are chosen.
STRICT = 0.8
#: Least area of a pixel after the warp, in units of its area after the base.
LEAST_AREA = 0.05
#: Fixed points along a side of the image's border.
ALONG_A_SIDE = 5
#: Least distance of a fixed border point from a landmark's way, in sides of the image.
CLEARANCE = 0.03
#: Largest number of positions along a side at which the flow is computed; a cubic spline
#: interpolates between them.
MOST_COMPUTED = 128
#: Landmarks nearer than this, in sides of the image, cannot contradict each other: they are missed
#: a little instead.
NEAR = 0.02
#: Largest ratio of the distances of two landmarks in both pictures, unless both are near.
MOST_STRETCHED = 20.0
#: Share of the spread that a similarity must explain for a picture to count as turned.
TURNED = 0.8
#: Cosine of the angle between the ways from one landmark to another in both pictures, below which
#: they contradict each other.
REVERSED = -0.5


class Warp(NamedTuple):
    """A warp of the positions of a measure."""

    #: The positions in the target's frame: (N, 2) array.
    positions: Array
    #: (N,) Jacobian determinant of the warp at each pixel, relative to that of the base.
    areas: Array
    #: The distance of each warped landmark from its partner, in sides of the image: (n,) array.
    misses: Array


class _Base(NamedTuple):
    """An affine map x -> x @ matrix + shift, applied before the flow."""

    matrix: Array
    shift: Array

    def __call__(self, places: Array) -> Array:
        return places @ self.matrix + self.shift


def warp(starts: Array, ends: Array, source: Measure, target: Measure) -> Warp:
    """Return a warp of the source's positions that moves landmarks, (n, 2), to their partners.

    They are in the frames of source and target; those that contradict each other are refused.
    """
    _check_order(starts, ends)
    fitted = _fitted(starts, ends)
    bases = [fitted]
    if len(starts) > 2:  # one frame is mapped onto the other
        (low, high), (new_low, new_high) = corners(source), corners(target)
        scale = (new_high - new_low) / (high - low)
        bases.insert(0, _Base(np.diag(scale), new_low - low * scale))
    for smoothing in SMOOTHING:
        for base in bases:
            try:
                # Two landmarks at one place need smoothing: without it numbers overflow.
                with np.errstate(all="ignore"):
                    found = _flow(starts, ends, source, base, smoothing)
            except np.linalg.LinAlgError:
                break
            if found.areas.min() > LEAST_AREA and (
                base is fitted or _stretched(found, source.shape) < MOST_STRETCH
            ):
                return found
    return _flow(starts, ends, source, fitted, np.inf)


def corners(measure: Measure) -> tuple[Array, Array]:
    """Return the least and the largest coordinates of a measure's positions."""
    return measure.positions.min(axis=0), measure.positions.max(axis=0)


def _fitted(starts: Array, ends: Array) -> _Base:
    """Return the similarity that maps landmarks best: a shift for one of them."""
    middle, goal = starts.mean(axis=0), ends.mean(axis=0)
    turn = _turn(starts - middle, ends - goal)
    matrix = np.array([[turn.real, turn.imag], [-turn.imag, turn.real]])
    return _Base(matrix, goal - middle @ matrix)


def _turn(starts: Array, ends: Array) -> complex:
    """Return the scale and the rotation of the best similarity of vectors, as a complex number."""
    one, other = (places[:, 0] + 1j * places[:, 1] for places in (starts, ends))
    size = float(np.sum(np.abs(one) ** 2))
    found = complex(np.vdot(one, other)) / size if size > 0 else 1.0 + 0.0j
    return found if abs(found) > 1e-3 else 1.0 + 0.0j


def _whole_turn(starts: Array, ends: Array) -> complex:
    """Return the rotation of the picture as a whole, as a complex number: 1 if there is none."""
    still = np.hypot(*(ends - starts).T) < NEAR
    if still.sum() >= max(1, len(starts) - 2):
        return 1.0 + 0.0j
    one, other = (places - places.mean(axis=0) for places in (starts, ends))
    turn = _turn(one, other)
    # The share of the second picture's spread that rotation and scale explain.
    explained = abs(turn) * np.linalg.norm(one) / max(float(np.linalg.norm(other)), 1e-12)
    return turn / abs(turn) if explained > TURNED else 1.0 + 0.0j


def _contradictions(starts: Array, ends: Array, strictness: float = 1.0) -> Array:
    """Return how strongly each pair of landmarks contradicts: (n, n), -inf where it does not.

    With a strictness below 1 more pairs do, so that rounding makes none of the others contradict.
    """
    ways = [places[None] - places[:, None] for places in (starts, ends)]
    lengths = [np.hypot(way[..., 0], way[..., 1]) for way in ways]
    apart = np.minimum(*lengths) > strictness * NEAR
    one, other = (way[..., 0] + 1j * way[..., 1] for way in ways)
    turn = _whole_turn(starts, ends)
    cosines = np.real(np.conj(one * turn) * other) / np.where(apart, lengths[0] * lengths[1], 1.0)
    # Two at one place of a picture, but not of the other one.
    torn = np.maximum(*lengths) > strictness * np.maximum(
        2 * NEAR, MOST_STRETCHED * np.minimum(*lengths)
    )
    wrong = torn | (apart & (cosines < strictness * REVERSED))
    degree = wrong.sum(axis=1)
    return np.where(wrong, degree[:, None] + degree - 0.5 * cosines, -np.inf)


def _check_order(starts: Array, ends: Array) -> None:
    """Refuse landmarks whose order is reversed, and name the two that do so the most."""
    votes = _contradictions(starts, ends)
    if votes.max() == -np.inf:
        return
    first, second = sorted(divmod(int(np.argmax(votes)), len(starts)))
    raise InputError(
        f"landmarks {first + 1} and {second + 1} contradict each other: one lies beyond the other "
        "in only one of the pictures; exchange their partners, correct them, or leave one out"
    )


def agreeing(starts: Array, ends: Array) -> BoolArray:
    """Return which landmarks can be kept so that no two of them contradict: (n,) array."""
    kept = np.ones(len(starts), bool)
    while kept.sum() > 1:
        votes = _contradictions(starts[kept], ends[kept], STRICT)
        wrong = votes > -np.inf
        if not wrong.any():
            break
        kept[np.flatnonzero(kept)[int(np.argmax(wrong.sum(axis=1)))]] = False
    return kept


def _flow(starts: Array, ends: Array, source: Measure, base: _Base, smoothing: float) -> Warp:
    """Return the base followed by the flow; smoothing of infinity leaves out the flow."""
    height, width = source.shape
    low, high = corners(source)
    numbers = [min(count, MOST_COMPUTED) for count in (height, width)]
    axes = [np.linspace(low[1 - k], high[1 - k], numbers[k]) for k in (0, 1)]
    y, x = np.meshgrid(*axes, indexing="ij")
    places = base(np.stack((x, y), axis=-1).reshape(-1, 2))
    marks = base(starts)
    border = _border(base, (low, high), marks, ends)
    if len(starts) > 2 and smoothing < np.inf:
        from scipy.interpolate import RBFInterpolator

        for step in range(STEPS):
            speeds = (ends - marks) / (STEPS - step)
            move = RBFInterpolator(
                np.vstack((marks, border)), np.vstack((speeds, np.zeros_like(border))),
                smoothing=np.r_[np.full(len(marks), smoothing), np.zeros(len(border))],
                kernel="thin_plate_spline",
            )  # fmt: skip
            places, marks = places + move(places), marks + move(marks)
    field = places.reshape(*numbers, 2)
    if numbers != [height, width]:
        field = _refined(field, axes, source)
    down, right = (np.asarray(np.gradient(field, axis=k)) for k in (0, 1))
    area = right[..., 0] * down[..., 1] - right[..., 1] * down[..., 0]
    usual = np.linalg.det(base.matrix) * np.prod((high - low) / (np.array([width, height]) - 1))
    return Warp(
        field.reshape(-1, 2), (area / usual).ravel(), np.hypot(*np.moveaxis(ends - marks, -1, 0))
    )


def _stretched(found: Warp, shape: tuple[int, int]) -> float:
    """Return by how much the most distorted parts are longer in one direction than across."""
    field = found.positions.reshape(*shape, 2)
    steps = np.stack([np.gradient(field, axis=k) for k in (0, 1)], axis=-1)
    sizes = np.linalg.svd(steps, compute_uv=False)
    return float(np.quantile(sizes[..., 0] / sizes[..., 1], 0.95))


def _refined(field: Array, axes: list[Array], source: Measure) -> Array:
    """Interpolate a field of positions to all pixels."""
    from scipy.interpolate import RectBivariateSpline

    rows, columns = (np.linspace(axes[k][0], axes[k][-1], source.shape[k]) for k in (0, 1))
    splines = [RectBivariateSpline(axes[0], axes[1], field[..., k]) for k in (0, 1)]
    return np.stack([spline(rows, columns) for spline in splines], axis=-1)


def _border(base: _Base, frame: tuple[Array, Array], marks: Array, ends: Array) -> Array:
    """Return the fixed points of the border, as far as no landmark comes close to them."""
    steps = np.linspace(0.0, 1.0, ALONG_A_SIDE)
    grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    grid = grid[np.any((grid == 0) | (grid == 1), axis=1)]
    border = base(frame[0] + grid * (frame[1] - frame[0]))
    way = ends - marks
    along = np.sum((border[:, None] - marks) * way, axis=-1)
    along = np.clip(along / np.maximum(np.sum(way**2, axis=-1), 1e-300), 0.0, 1.0)
    nearest = marks + along[..., None] * way
    away = np.hypot(*np.moveaxis(border[:, None] - nearest, -1, 0)).min(axis=1)
    clear = away > CLEARANCE
    # The corners keep the spline determined.
    corner = np.all((grid == 0) | (grid == 1), axis=1) & (away > 1e-6)
    return border[clear | corner]
