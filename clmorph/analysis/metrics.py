"""Measures of frames: divergence on the path (paper, 4.3, Table 2), holes, sharpness, specks.

Those of whole films stand in `clmorph.analysis.film_metrics`, and are names of this module too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from clmorph._shared.typing import Array
from clmorph._shared.validation import check_choice, check_integer, check_progress, shown
from clmorph.analysis.film_metrics import (
    FilmMeasures,
    as_times,
    crossfade_share,
    film_measures,
    flicker,
    ghost,
    low_band_distance,
    relative_crumbs,
    relative_sharpness,
    speck_share,
    steps,
    unevenness,
)
from clmorph.backends.arrays import as_floats
from clmorph.backends.multi_device import members_of
from clmorph.backends.select import Backend, get_backend
from clmorph.errors import InputError
from clmorph.frames.as_measure import FRAME_WEIGHTS, MERGED_POINTS, frame_measure, particle_measure
from clmorph.frames.render import is_torn
from clmorph.frames.sequence import check_frame_sequence
from clmorph.images.resizing import resized
from clmorph.measures.lift import LUMINANCE
from clmorph.measures.points import WeightedPoints
from clmorph.pipeline.result import Morph
from clmorph.transport.divergence import Divergence, sinkhorn_divergence
from clmorph.transport.options import SolverOptions
from clmorph.transport.regularization import regularization

__all__ = [
    "FilmMeasures",
    "crossfade_share",
    "crumbs",
    "film_measures",
    "flicker",
    "frame_measure",
    "ghost",
    "hole_fraction",
    "low_band_distance",
    "mean_gradient",
    "particle_measure",
    "path_divergence",
    "relative_crumbs",
    "relative_sharpness",
    "sharpness",
    "step_sizes",
    "unevenness",
]


#: The measures with which frames can be compared: the target image, or the particles.
REFERENCES = ("target", "particles")

#: The largest value that a coverage or a frame may have, whose square is still finite.
LARGEST = 1e30


def path_divergence(
    morph: Morph,
    times: Sequence[float],
    to: str = "target",
    *,
    weights: str | None = None,
    blur: float | None = None,
    reach: float | None = None,
    tol: float = SolverOptions.tol,
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
        "target" is Table 2 of the paper. "particles" is mu_t itself, which the frame depicts.
    weights : {"uniform", "kernel"}, optional
        See `frame_measure`; "uniform" for the target, "kernel" for particles if not given.
    blur, reach : float, optional
        Those of the morph if not given. One reach applies to both measures; infinity stands for
        balanced transport.
    tol : float
        Tolerance of each solve, in units of epsilon.
    max_points : int
        See `particle_measure`; intervals hold for the merged particles.
    backend : str, object of pyopencl, or Operations, optional
        That of the morph if not given.
    progress : callable, optional

    Returns
    -------
    list of Divergence
        One divergence per time, each with an interval that certainly contains it.

    Raises
    ------
    InputError
        If an option cannot be used, or the morph's reach is a pair and none is given.

    Examples
    --------
    >>> import clmorph
    >>> import numpy as np
    >>> left, right = np.zeros((2, 6, 6, 3))
    >>> left[:, :3] = right[:, 3:] = 1.0
    >>> morph = clmorph.morph(left, right, n_frames=5, backend="numpy")
    >>> from clmorph.analysis.metrics import path_divergence
    >>> first, last = path_divergence(morph, [0.0, 1.0])
    >>> last.value < first.value
    True
    """
    check_frame_sequence(morph)
    check_choice("to", to, REFERENCES)
    report = check_progress(progress)
    if morph.source.has_metric_map:
        raise InputError("a cost with a metric for each source pixel is not a distance")
    blur = morph.potentials.blur if blur is None else blur
    given = regularization(blur, morph.potentials.reach if reach is None else reach)
    own_reach = given.reach
    if isinstance(own_reach, tuple):
        raise InputError(f"the reach is {own_reach}: give one reach for both measures")
    # Divergences are computed one after the other.
    device = members_of(get_backend(morph.operations if backend is None else backend))[0]
    if weights is None:
        weights = "uniform" if to == "target" else "kernel"
    max_points = check_integer("max_points", max_points, 16, 1 << 20)
    check_choice("weights", weights, FRAME_WEIGHTS)
    moments = as_times(times)
    result = []
    # Frames have no landmarks and no features: pictures are compared.
    plainly = replace(morph.target, warped=None, features=None)
    for number, t in enumerate(moments):
        frame = frame_measure(morph, t, weights=weights)
        other = (
            WeightedPoints(plainly.points, plainly.weights)
            if to == "target"
            else particle_measure(morph, t, max_points=max_points)[0]
        )
        result.append(sinkhorn_divergence(frame, other, given.blur, own_reach, tol, backend=device))
        report((number + 1) / len(moments))
    return result


def hole_fraction(coverage: ArrayLike) -> float:
    """Return the share of pixels that are holes: empty, or far less covered than those around them.

    Parameters
    ----------
    coverage : (H, W) array
        The coverage as returned by `Morph.coverage`.

    Examples
    --------
    >>> import numpy as np
    >>> from clmorph.analysis.metrics import hole_fraction
    >>> coverage = np.ones((10, 10))
    >>> coverage[4, 4] = 0.0
    >>> hole_fraction(coverage)
    0.01
    """
    values = _as_array("coverage", coverage, (2,))
    return float(np.mean(is_torn(values)))


def sharpness(frame: ArrayLike) -> float:
    """Return the root mean square gradient of a frame's luma, per pixel.

    Parameters
    ----------
    frame : (H, W, C) array

    Examples
    --------
    >>> import numpy as np
    >>> from clmorph.analysis.metrics import sharpness
    >>> stripes = np.zeros((4, 4, 3))
    >>> stripes[:, ::2] = 1.0
    >>> round(sharpness(stripes), 4), sharpness(np.ones((4, 4, 3)))
    (0.7071, 0.0)
    """
    luma = _luma(frame)
    slopes = [np.diff(luma, axis=axis) ** 2 for axis in (0, 1)]
    count = sum(slope.size for slope in slopes)
    return float(np.sqrt(sum(slope.sum() for slope in slopes) / max(1, count)))


def crumbs(frame: ArrayLike) -> float:
    """Return the share of pixels whose luma is more than 0.06 from the median of 3 x 3 pixels.

    Particles whose neighbors have traveled elsewhere leave such specks. Fine detail of a picture
    counts too, so a frame is compared with the images of its ends.

    Parameters
    ----------
    frame : (H, W, C) array

    Examples
    --------
    >>> import numpy as np
    >>> from clmorph.analysis.metrics import crumbs
    >>> frame = np.zeros((10, 10, 3))
    >>> frame[4, 4] = 1.0
    >>> crumbs(frame)
    0.01
    """
    return speck_share(_luma(frame))


def mean_gradient(frame: ArrayLike) -> float:
    """Return the mean length of the gradient of a frame's luma, per pixel.

    Unlike `sharpness` it grows with the length of outlines in proportion to their contrast, so that
    a cross-fade of unrelated pictures has about the mean of theirs.

    Parameters
    ----------
    frame : (H, W, C) array of at least 2 x 2 pixels

    Examples
    --------
    >>> import numpy as np
    >>> from clmorph.analysis.metrics import mean_gradient
    >>> ramp = np.repeat(np.linspace(0, 1, 5)[None, :, None], 3, axis=2).repeat(4, axis=0)
    >>> mean_gradient(ramp)
    0.25
    """
    luma = _luma(frame)
    if min(luma.shape) < 2:
        raise InputError(f"frame of {luma.shape} pixels: expected at least (2, 2)")
    down, right = np.diff(luma, axis=0)[:, :-1], np.diff(luma, axis=1)[:-1]
    return float(np.hypot(down, right).mean())


def step_sizes(frames: Sequence[ArrayLike]) -> Array:
    """Return the root mean square change from each frame to the next: (n - 1,) array.

    Parameters
    ----------
    frames : sequence of (H, W, C) arrays
        Smaller ones are enlarged to the largest sides first; opacity is left out.

    Examples
    --------
    >>> import numpy as np
    >>> from clmorph.analysis.metrics import step_sizes
    >>> frames = [np.full((4, 4, 3), level) for level in (0.0, 0.25, 1.0)]
    >>> step_sizes(frames).tolist()
    [0.25, 0.75]
    """
    if not isinstance(frames, Sequence | np.ndarray) or not np.iterable(frames):
        raise InputError(f"frames={shown(frames)}: expected a sequence of arrays (H, W, 3)")
    pictures = [_as_array("frame", frame, (3,))[..., :3] for frame in frames]
    if len(pictures) < 2:
        raise InputError(f"{len(pictures)} frames: expected at least 2, to have steps between them")
    height, width = (max(picture.shape[axis] for picture in pictures) for axis in (0, 1))
    pictures = [resized(picture, (height, width)) for picture in pictures]
    return np.array(steps(pictures))


def _luma(frame: ArrayLike) -> Array:
    """Return the luma of a frame without its opacity: (H, W) array."""
    return np.asarray(_as_array("frame", frame, (3,))[..., :3] @ LUMINANCE)


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
