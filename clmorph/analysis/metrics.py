"""How good frames are: divergences on the path (paper, 4.3, Table 2), holes, sharpness, steps."""

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clmorph._shared.arrays import as_floats
from clmorph._shared.validation import (
    check_choice,
    check_integer,
    check_number,
    check_progress,
    shown,
)
from clmorph.backends.select import Backend
from clmorph.errors import InputError
from clmorph.frames.filling import is_torn
from clmorph.frames.render import Canvas, Sums
from clmorph.images.color import from_space
from clmorph.images.pixels import resized
from clmorph.measures.lift import LUMINANCE
from clmorph.measures.measure import Measure
from clmorph.measures.points import WeightedPoints
from clmorph.pipeline import presets as defaults
from clmorph.pipeline.result import Morph
from clmorph.transport.divergence import Divergence, sinkhorn_divergence
from clmorph.transport.regularization import regularization

Array = NDArray[np.float64]

#: How a frame is taken as a measure: every pixel the same mass (the paper), or its kernel mass.
FRAME_WEIGHTS = ("kernel", "uniform")
#: What frames are compared with: the target image, or the particles themselves.
REFERENCES = ("target", "particles")

#: The largest value that a coverage or a frame may have: its squares are still numbers.
LARGEST = 1e30
#: Points to which particles are merged before they are compared.
MERGED_POINTS = 8192


def frame_measure(
    morph: Morph, t: float, *, weights: str = "kernel", sums: Sums | None = None
) -> WeightedPoints:
    """Take a frame as a measure, lifted as the images were.

    Parameters
    ----------
    morph : Morph
    t : float
    weights : {"kernel", "uniform"}
        A pixel's mass: what the particles' kernels give it, of the particles' mass in all; or
        the same for every pixel, of sum 1 (the paper's way, which cannot see holes).
    sums : Sums, optional
        What `morph.sums(t)` or another rendering returned; the frame itself if not given.

    Returns
    -------
    WeightedPoints

    Raises
    ------
    InputError
        If an option is none of these.
    """
    check_morph(morph)
    t = check_number("t", t, 0.0, 1.0)
    check_choice("weights", weights, FRAME_WEIGHTS)
    canvas = morph.canvas(t)
    if sums is None:
        sums = morph.sums(t)
        colors = morph.frame(t)[..., :3].astype(float)
    else:
        _check_sums(sums, canvas)
        colors = from_space(sums.colors, morph.particles.path_space)
    n = canvas.shape[0] * canvas.shape[1]
    masses = np.full(n, 1.0 / n)
    if weights == "kernel":
        masses = np.maximum(sums.density.ravel(), 0.0)
        masses = masses * (morph.particles.mass(t) / masses.sum())
    return WeightedPoints(_lifted(morph, _frame_positions(canvas), colors.reshape(n, 3)), masses)


def particle_measure(
    morph: Morph, t: float, *, max_points: int = MERGED_POINTS
) -> tuple[WeightedPoints, float]:
    """Return the particles at time t as a measure, those near each other merged.

    Parameters
    ----------
    morph : Morph
    t : float
    max_points : int
        Particles are merged to their centers of mass in cells of one size, in position and
        color, the smallest that leaves no more points than this.

    Returns
    -------
    measure : WeightedPoints
    spread : float
        Root mean square distance of particles to the point they were merged to, in image sides;
        0 if none was.
    """
    check_morph(morph)
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


def path_divergence(
    morph: Morph,
    times: Sequence[float],
    to: str = "target",
    *,
    weights: str | None = None,
    blur: float | None = None,
    reach: float | None = None,
    tol: float = defaults.TOL,
    max_points: int = MERGED_POINTS,
    backend: Backend | None = None,
    progress: Callable[[float], None] | None = None,
) -> list[Divergence]:
    """Return the Sinkhorn divergence of frames to the target, or to the particles.

    Parameters
    ----------
    morph : Morph
    times : sequence of float
    to : {"target", "particles"}
        Table 2 of the paper; or mu_t itself, of which the frame is to be a picture.
    weights : {"uniform", "kernel"}, optional
        See `frame_measure`; "uniform" for the target, "kernel" for particles if not given.
    blur, reach : float, optional
        The morph's own if not given; one reach for both measures, infinity is balanced.
    tol : float
        Of each solve, in units of epsilon.
    max_points : int
        See `particle_measure`; intervals hold for the merged particles.
    backend : str or Operations, optional
        The morph's own if not given.
    progress : callable, optional

    Returns
    -------
    list of Divergence
        With certain intervals.

    Raises
    ------
    InputError
        If an option cannot be used, or the morph's reach is a pair and none is given.
    """
    check_morph(morph)
    check_choice("to", to, REFERENCES)
    report = check_progress(progress)
    if morph.source.has_metric_map:
        raise InputError("a cost with a metric for each source pixel is no distance")
    blur = morph.potentials.blur if blur is None else blur
    given = regularization(blur, morph.potentials.reach if reach is None else reach)
    own_reach = given.reach
    if isinstance(own_reach, tuple):
        raise InputError(f"the reach is {own_reach}: give one reach for both measures")
    operations = morph.operations if backend is None else backend
    if weights is None:
        weights = "uniform" if to == "target" else "kernel"
    max_points = check_integer("max_points", max_points, 16, 1 << 20)
    check_choice("weights", weights, FRAME_WEIGHTS)
    moments = np.atleast_1d(as_floats("times", times, "times from 0 to 1"))
    if moments.ndim > 1 or not moments.size:
        raise InputError(f"times have shape {moments.shape}: expected (n,) times from 0 to 1")
    for t in moments:
        check_number("times", float(t), 0.0, 1.0)
    result = []
    for number, t in enumerate(moments):
        frame = frame_measure(morph, t, weights=weights)
        other = (
            WeightedPoints(morph.target.points, morph.target.weights)
            if to == "target"
            else particle_measure(morph, t, max_points=max_points)[0]
        )
        result.append(
            sinkhorn_divergence(frame, other, given.blur, own_reach, tol, backend=operations)
        )
        report((number + 1) / len(moments))
    return result


def hole_fraction(coverage: ArrayLike) -> float:
    """Return the share of pixels that are holes: torn out of what surrounds them, or empty.

    Parameters
    ----------
    coverage : (H, W) array
        By `Morph.coverage`.
    """
    values = _as_array("coverage", coverage, (2,))
    return float(np.mean(is_torn(values)))


def sharpness(frame: ArrayLike) -> float:
    """Return the root mean square gradient of a frame's luma, per pixel.

    Parameters
    ----------
    frame : (H, W, C) array
    """
    luma = _as_array("frame", frame, (3,))[..., :3] @ LUMINANCE
    slopes = [np.diff(luma, axis=axis) ** 2 for axis in (0, 1)]
    count = sum(slope.size for slope in slopes)
    return float(np.sqrt(sum(slope.sum() for slope in slopes) / max(1, count)))


def step_sizes(frames: Sequence[ArrayLike]) -> Array:
    """Return the root mean square change from each frame to the next: (n - 1,) array.

    Parameters
    ----------
    frames : sequence of (H, W, C) arrays
        Smaller ones are enlarged to the largest sides first; opacity is left out.
    """
    if not isinstance(frames, Sequence | np.ndarray) or not np.iterable(frames):
        raise InputError(f"frames={shown(frames)}: expected a sequence of arrays (H, W, 3)")
    pictures = [_as_array("frame", frame, (3,))[..., :3] for frame in frames]
    if len(pictures) < 2:
        raise InputError(f"{len(pictures)} frames: expected at least 2, to have steps between them")
    height, width = (max(picture.shape[axis] for picture in pictures) for axis in (0, 1))
    pictures = [resized(picture, (height, width)) for picture in pictures]
    return np.array(
        [np.sqrt(np.mean((after - before) ** 2)) for before, after in pairwise(pictures)]
    )


def check_morph(morph: Morph) -> None:
    """Raise InputError unless this is a Morph."""
    if not isinstance(morph, Morph):
        raise InputError(f"morph={shown(morph)}: expected a Morph, as clmorph.morph returns it")


def _check_sums(sums: Sums, canvas: Canvas) -> None:
    if not isinstance(sums, Sums) or np.shape(sums.density) != canvas.shape:
        raise InputError(
            f"sums={shown(sums)}: expected what morph.sums returns for the same t, of a frame of "
            f"shape {canvas.shape}"
        )


def _as_array(name: str, values: ArrayLike, dimensions: tuple[int, ...]) -> Array:
    """Return an array of one of these numbers of dimensions; pictures have 3 or 4 channels."""
    wanted = "(H, W)" if dimensions == (2,) else "(H, W, 3) or (H, W, 4)"
    array = as_floats(name, values, f"an array {wanted}")
    pictured = array.ndim < 3 or array.shape[-1] in (3, 4)
    if array.ndim not in dimensions or array.size == 0 or not pictured:
        raise InputError(f"{name} has shape {array.shape}: expected {wanted}")
    if not np.all(np.abs(array) <= LARGEST):
        raise InputError(f"{name} holds NaN, infinity or numbers above {LARGEST:g}")
    return array


def _frame_positions(canvas: Canvas) -> Array:
    """Where the pixels of a canvas stand in the common frame."""
    y, x = np.mgrid[: canvas.shape[0], : canvas.shape[1]].reshape(2, -1)
    pixels = np.column_stack((x, y)) - np.asarray(canvas.center)
    return 0.5 + pixels / np.maximum(canvas.scale, 1e-9)


def _lifted(morph: Morph, positions: Array, colors: Array) -> Array:
    """(K, 5) points, as `Measure.points` lifts them."""
    source = morph.source
    return Measure(
        positions, colors, np.ones(len(colors)), source.shape, source.color_weight, source.extent,
        source.color_space, source.color_metric,
    ).points  # fmt: skip
