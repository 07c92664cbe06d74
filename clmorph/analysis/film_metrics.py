"""Measures of a film: whether one picture is seen at each place, or two through each other.

All of them look at pictures of 128 pixels along the longer side, opacity laid over gray. None is
enough alone. A cross-fade is sharp and even, and has the right colors on the whole, but shows both
pictures at each place (`ghost`, `crossfade_share`). A wipe in place, in which regions change hands
and nothing moves, shows one picture at each place, but wrong colors (`low_band_distance`). Blurred
particles are soft (`relative_sharpness`), and torn ones leave specks (`relative_crumbs`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np

from clmorph._shared.typing import Array, ArrayLike
from clmorph._shared.validation import check_number, shown
from clmorph.backends.arrays import as_array, as_floats
from clmorph.errors import InputError
from clmorph.images.pixels import as_pixels, split_alpha

#: The longer side of the pictures that are compared, in pixels.
SIDE = 128
#: Side of the windows that are explained, the distance from one to the next, and how far from a
#: window its patch may lie, in pixels.
WINDOW, STRIDE, REACH = 20, 10, 12
#: Root mean square detail of a window below which it is taken for flat.
FAINT = 0.02
#: Share of a window's detail that must be left by one patch, for another one to be looked for.
LEFT = 1e-3
#: Standard deviations that part the low band from the detail, in pixels.
GHOST_BAND, LOW_BAND = SIDE / 12, SIDE / 16
#: Weights of the luma of Rec. 601.
LUMA = np.array([0.299, 0.587, 0.114])
#: The level of gray below opacity.
GRAY = 0.5
#: The difference from the median of 3 x 3 pixels beyond which a pixel is a speck.
SPECK = 0.06
#: Frames whose steps are compared in a film of more, and the fewest by which flicker is told.
EVEN_FRAMES, FLICKER_FRAMES = 9, 25
#: A step so small that frames are equal.
NO_STEP = 1e-9


class FilmMeasures(NamedTuple):
    """The measures of a film; tuples have a value for each of the times.

    Attributes
    ----------
    ghost : float
        Mean of `ghost` over the times, relative to a cross-fade's. Where that is less than 0.03,
        because the pictures are alike or one of them is flat, only `ghost_absolute` counts.
    ghost_absolute, ghost_of_crossfade : float
        Both means.
    crossfade_share : float
        At t = 1/2.
    relative_sharpness, relative_crumbs : tuple of float
    unevenness : float
        Of nine frames, if there are more.
    flicker : float or None
        None for fewer than 25 frames, or an even number of them.
    low_band_distance : tuple of float or None
        None if the particles' frames are not given.
    """

    ghost: float
    ghost_absolute: float
    ghost_of_crossfade: float
    crossfade_share: float
    relative_sharpness: tuple[float, ...]
    relative_crumbs: tuple[float, ...]
    unevenness: float
    flicker: float | None
    low_band_distance: tuple[float, ...] | None


def film_measures(
    frames: Sequence[ArrayLike],
    particles: Sequence[ArrayLike] | None = None,
    times: Sequence[float] = (0.25, 0.5, 0.75),
) -> FilmMeasures:
    """Return all measures of a film.

    Parameters
    ----------
    frames : sequence of (H, W, 3) or (H, W, 4) arrays
        A `Morph`, or at least three frames of any sizes, equally apart in time. The first and the
        last one are the pictures.
    particles : sequence of arrays, optional
        The film of the same pictures by ``detail="particles"``, for `low_band_distance`.
    times : sequence of float
        Times from 0 to 1; the nearest frame is taken for each.

    Returns
    -------
    FilmMeasures

    Raises
    ------
    InputError
        If there are fewer than three frames, a frame is no picture, or a time is not in [0, 1].

    Examples
    --------
    >>> import numpy as np
    >>> from clmorph.analysis.metrics import film_measures
    >>> a, b = np.random.default_rng(0).random((2, 32, 32, 3))
    >>> fade = [(1 - t) * a + t * b for t in np.linspace(0, 1, 5)]
    >>> found = film_measures(fade, times=[0.5])
    >>> round(found.ghost, 3), round(found.crossfade_share, 3), round(found.unevenness, 3)
    (1.0, 1.0, 1.0)
    """
    moments = as_times(times)
    film = _film("frames", frames)
    first, last = film[0], film[-1]
    taken = [(t, _nearest(film, t)) for t in moments]
    ghosts = float(np.mean([_ghost(frame, first, last) for _, frame in taken]))
    fades = float(np.mean([_ghost((1 - t) * first + t * last, first, last) for t in moments]))
    few = [_nearest(film, t) for t in np.linspace(0, 1, EVEN_FRAMES)]
    below = None if particles is None else _film("particles", particles)
    return FilmMeasures(
        ghost=ghosts / max(fades, 1e-9),
        ghost_absolute=ghosts,
        ghost_of_crossfade=fades,
        crossfade_share=_crossfade_share(_nearest(film, 0.5), first, last),
        relative_sharpness=tuple(_relative(_gradient, t, frame, first, last) for t, frame in taken),
        relative_crumbs=tuple(_relative(speck_share, t, frame, first, last) for t, frame in taken),
        unevenness=_unevenness(few if len(film) > EVEN_FRAMES else film),
        flicker=_flicker(film) if len(film) >= FLICKER_FRAMES and len(film) % 2 else None,
        low_band_distance=None
        if below is None
        else tuple(_low_band_distance(frame, _nearest(below, t)) for t, frame in taken),
    )


def ghost(frame: ArrayLike, image_a: ArrayLike, image_b: ArrayLike) -> float:
    """Return the share of a frame's detail by which a second picture is seen through the first.

    Each window of 20 x 20 pixels is explained by the best patch of one picture at most 12 pixels
    away. Of what is left, a patch of the other picture explains a share, and another one by chance:
    that is what the same picture explains when it is turned by 180 degrees or mirrored, in the
    mean. The share beyond chance is the ghost.

    Parameters
    ----------
    frame : (H, W, 3) or (H, W, 4) array
    image_a, image_b : arrays
        Both pictures, of any sizes; they are stretched to the frame's shape.

    Returns
    -------
    float
        About 0 if there is one picture at each place. A cross-fade of two unlike photographs has
        0.1 to 0.2 at its worst time. It can be slightly negative, and it misleads for pictures that
        are alike, because a patch of one of them then explains what one of the other left.

    Examples
    --------
    >>> import numpy as np
    >>> from clmorph.analysis.metrics import ghost
    >>> a, b = np.random.default_rng(0).random((2, 32, 32, 3))
    >>> ghost((a + b) / 2, a, b) > 0.2, ghost(a, a, b)
    (True, 0.0)
    """
    return _ghost(*_like_the_frame(frame, image_a=image_a, image_b=image_b))


def crossfade_share(frame: ArrayLike, image_a: ArrayLike, image_b: ArrayLike) -> float:
    """Return the share of a frame's detail that is a sum of those of both pictures in place.

    Parameters
    ----------
    frame : (H, W, 3) or (H, W, 4) array
    image_a, image_b : arrays
        See `ghost`.

    Returns
    -------
    float
        Coefficient of determination R^2 of the best sum; 1 for a cross-fade.

    Examples
    --------
    >>> import numpy as np
    >>> from clmorph.analysis.metrics import crossfade_share
    >>> a, b, other = np.random.default_rng(0).random((3, 32, 32, 3))
    >>> round(crossfade_share(0.7 * a + 0.3 * b, a, b), 3), crossfade_share(other, a, b) < 0.1
    (1.0, True)
    """
    return _crossfade_share(*_like_the_frame(frame, image_a=image_a, image_b=image_b))


def relative_sharpness(frame: ArrayLike, image_a: ArrayLike, image_b: ArrayLike, t: float) -> float:
    """Return the mean gradient of a frame, relative to the mixture by t of both pictures'.

    Parameters
    ----------
    frame : (H, W, 3) or (H, W, 4) array
    image_a, image_b : arrays
        See `ghost`.
    t : float
        The time of the frame, from 0 to 1.

    Returns
    -------
    float
        About 1 if the frame is as sharp as the pictures.

    Examples
    --------
    >>> import numpy as np
    >>> from clmorph.analysis.metrics import relative_sharpness
    >>> a, b = np.random.default_rng(0).random((2, 32, 32, 3))
    >>> relative_sharpness(a, a, b, 0.0) > 0.9, relative_sharpness(0.5 * a, a, b, 0.0) < 0.5
    (True, True)
    """
    pictures = _like_the_frame(frame, image_a=image_a, image_b=image_b)
    return _relative(_gradient, check_number("t", t, 0.0, 1.0), *pictures)


def relative_crumbs(frame: ArrayLike, image_a: ArrayLike, image_b: ArrayLike, t: float) -> float:
    """Return the share of specks in a frame, relative to the mixture by t of both pictures'.

    Specks are those of `clmorph.analysis.metrics.crumbs`, in the picture of 128 pixels.

    Parameters
    ----------
    frame : (H, W, 3) or (H, W, 4) array
    image_a, image_b : arrays
        See `ghost`.
    t : float
        The time of the frame, from 0 to 1.

    Returns
    -------
    float
        About 1 if the frame has as much fine detail as the pictures; more if it is torn.

    Examples
    --------
    >>> import numpy as np
    >>> from clmorph.analysis.metrics import relative_crumbs
    >>> a, b = np.random.default_rng(0).random((2, 128, 128, 3))
    >>> relative_crumbs(a, a, b, 0.0) > 0.9, relative_crumbs(np.ones((9, 9, 3)), a, b, 0.5)
    (True, 0.0)
    """
    pictures = _like_the_frame(frame, image_a=image_a, image_b=image_b)
    return _relative(speck_share, check_number("t", t, 0.0, 1.0), *pictures)


def low_band_distance(frame: ArrayLike, particles: ArrayLike) -> float:
    """Return how far the smooth part of a frame is from that of the particles' frame.

    It is large where a frame has not the masses and colors of the interpolation.

    Parameters
    ----------
    frame, particles : (H, W, 3) or (H, W, 4) arrays
        Frames at the same time: any one, and that by ``detail="particles"``.

    Returns
    -------
    float
        Root mean square difference in CIELAB of what a Gaussian of a sixteenth of the longer side
        leaves. Halfway a wipe in place has 5 to 13.

    Examples
    --------
    >>> import numpy as np
    >>> from clmorph.analysis.metrics import low_band_distance
    >>> black, white = np.zeros((8, 8, 3)), np.ones((16, 16, 3))
    >>> low_band_distance(black, black), round(low_band_distance(black, white))
    (0.0, 100)
    """
    return _low_band_distance(*_like_the_frame(frame, particles=particles))


def unevenness(frames: Sequence[ArrayLike]) -> float:
    """Return the largest step from a frame to the next, relative to the mean step.

    Steps are root mean square differences. A film of n frames that are all the same but for a hard
    cut has n - 1, an even one has 1, and one in which nothing changes has 0.

    Parameters
    ----------
    frames : sequence of (H, W, 3) or (H, W, 4) arrays
        At least three.

    Examples
    --------
    >>> import numpy as np
    >>> from clmorph.analysis.metrics import unevenness
    >>> levels = [np.full((4, 4, 3), level) for level in (0.0, 0.25, 0.5, 0.75, 1.0)]
    >>> unevenness(levels), unevenness([levels[0]] * 3 + [levels[-1]])
    (1.0, 3.0)
    """
    return _unevenness(_film("frames", frames))


def flicker(frames: Sequence[ArrayLike]) -> float:
    """Return the way that a film goes from frame to frame, relative to that by every second frame.

    Ways are sums of root mean square differences. Without flicker it is about 1, provided that
    there are frames enough (49, say), and 0 if nothing changes.

    Parameters
    ----------
    frames : sequence of (H, W, 3) or (H, W, 4) arrays
        An odd number, at least three.

    Examples
    --------
    >>> import numpy as np
    >>> from clmorph.analysis.metrics import flicker
    >>> levels = [np.full((4, 4, 3), level) for level in (0.0, 0.25, 0.5, 0.75, 1.0)]
    >>> flicker(levels), flicker([levels[number] for number in (0, 2, 1, 3, 2)])
    (1.0, 3.0)
    """
    film = _film("frames", frames)
    if len(film) % 2 == 0:
        raise InputError(f"frames hold {len(film)} pictures: expected an odd number")
    return _flicker(film)


def as_times(times: ArrayLike) -> list[float]:
    """Return times from 0 to 1 as floats; refuse others, and none."""
    moments = np.atleast_1d(as_floats("times", times, "times from 0 to 1"))
    if moments.ndim > 1 or not moments.size:
        raise InputError(f"times have shape {moments.shape}: expected (n,) times from 0 to 1")
    return [check_number("times", float(t), 0.0, 1.0) for t in moments]


def speck_share(luma: Array) -> float:
    """Return the share of pixels whose luma (H, W) is far from the median of 3 x 3 pixels."""
    from scipy.ndimage import median_filter

    return float(np.mean(np.abs(luma - median_filter(luma, 3, mode="nearest")) > SPECK))


# --- pictures of one shape ------------------------------------------------------------------


def _film(name: str, frames: Sequence[ArrayLike]) -> list[Array]:
    """Return at least three frames in the small shape of the middle one."""
    if not isinstance(frames, Sequence | np.ndarray) or not np.iterable(frames):
        raise InputError(f"{name}={shown(frames)}: expected a sequence of arrays (H, W, 3)")
    if len(frames) < 3:
        raise InputError(f"{name} hold {len(frames)} pictures: expected at least 3")
    pictures = [_over_gray(f"{name}[{number}]", frame) for number, frame in enumerate(frames)]
    return _like(pictures[len(pictures) // 2], pictures)


def _like_the_frame(frame: ArrayLike, **others: ArrayLike) -> list[Array]:
    """Return a frame and others in the frame's small shape."""
    pictures = [_over_gray(name, value) for name, value in {"frame": frame, **others}.items()]
    return _like(pictures[0], pictures)


def _over_gray(name: str, frame: ArrayLike) -> Array:
    """Return a picture (H, W, 3) or (H, W, 4) as opaque colors (H, W, 3)."""
    array = as_array(name, frame, "an array (H, W, 3) or (H, W, 4)")
    if array.ndim != 3 or array.shape[2] not in (3, 4):
        raise InputError(f"{name} has shape {array.shape}: expected (H, W, 3) or (H, W, 4)")
    colors, alpha = split_alpha(as_pixels(array, name))
    return colors if alpha is None else GRAY + (colors - GRAY) * alpha[..., None]


def _like(model: Array, pictures: list[Array]) -> list[Array]:
    """Return pictures in the shape of one of them, reduced or enlarged to 128 pixels."""
    from skimage.transform import resize

    scale = SIDE / max(model.shape[:2])
    # A window has room to move.
    shape = tuple(max(WINDOW + 4, round(side * scale)) for side in model.shape[:2])
    return [np.asarray(resize(each, shape, order=1, anti_aliasing=True)) for each in pictures]


def _nearest(film: list[Array], t: float) -> Array:
    return film[round(t * (len(film) - 1))]


# --- measures of pictures of one shape ------------------------------------------------------


def _detail(picture: Array, band: float) -> Array:
    """Return the luma (H, W) without its low band."""
    from scipy.ndimage import gaussian_filter

    luma = picture @ LUMA
    return np.asarray(luma - gaussian_filter(luma, band))


def _ghost(frame: Array, first: Array, last: Array) -> float:
    detail, *ends = (_detail(picture, GHOST_BAND) for picture in (frame, first, last))
    # Each picture as it is, and turned and mirrored for what chance explains.
    turned = [(end, end[::-1, ::-1], end[:, ::-1]) for end in ends]
    energy, seconds = 0.0, np.zeros(3)
    starts = (range(0, side - WINDOW + 1, STRIDE) for side in detail.shape)
    for row, column in product(*starts):
        window = detail[row : row + WINDOW, column : column + WINDOW]
        window = window - window.mean()
        norm = float(np.linalg.norm(window))
        if norm < FAINT * WINDOW:
            continue
        energy += norm**2
        (likeness, patch), (other_likeness, other_patch) = (
            _best_patch(window, end, row, column) for end in ends
        )
        others = turned[1]
        if other_likeness > likeness:
            likeness, patch, others = other_likeness, other_patch, turned[0]
        rest = window - np.vdot(window, patch) * patch
        if np.linalg.norm(rest) <= LEFT * norm:
            continue
        for number, other in enumerate(others):
            second = _best_patch(rest, other, row, column)[1]
            beyond = _explained(window, patch, second) - max(likeness, 0.0) ** 2
            seconds[number] += max(beyond, 0.0) * norm**2
    return float((seconds[0] - seconds[1:].mean()) / energy) if energy else 0.0


def _best_patch(window: Array, picture: Array, row: int, column: int) -> tuple[float, Array]:
    """Return the best correlation of a window with a patch near it, and that patch, normed."""
    from skimage.feature import match_template

    rows, columns = (slice(max(0, at - REACH), at + WINDOW + REACH) for at in (row, column))
    near = picture[rows, columns]
    found = match_template(near, window)
    u, v = np.unravel_index(np.argmax(found), found.shape)
    patch = near[u : u + WINDOW, v : v + WINDOW]
    patch = patch - patch.mean()
    return float(found[u, v]), np.asarray(patch / max(float(np.linalg.norm(patch)), 1e-9))


def _explained(values: Array, *parts: Array) -> float:
    """Return the share of the sum of squares that the best sum of parts explains."""
    columns = np.stack([part.ravel() for part in parts], axis=1)
    wanted = values.ravel()
    rest = wanted - columns @ np.linalg.lstsq(columns, wanted, rcond=None)[0]
    return 1 - float(rest @ rest) / max(float(wanted @ wanted), 1e-12)


def _crossfade_share(frame: Array, first: Array, last: Array) -> float:
    return _explained(*(_detail(picture, LOW_BAND) for picture in (frame, first, last)))


def _gradient(luma: Array) -> float:
    """Return the sum of the mean changes along both axes."""
    return float(sum(np.abs(np.diff(luma, axis=axis)).mean() for axis in (0, 1)))


def _relative(
    measure: Callable[[Array], float], t: float, frame: Array, first: Array, last: Array
) -> float:
    """Return a measure of a frame's luma, relative to the mixture of those of both ends."""
    own, start, end = (measure(picture @ LUMA) for picture in (frame, first, last))
    return own / ((1 - t) * start + t * end + 1e-3)


def _low_band_distance(frame: Array, particles: Array) -> float:
    from scipy.ndimage import gaussian_filter
    from skimage.color import rgb2lab

    if particles.shape != frame.shape:
        frame, particles = _like(frame, [frame, particles])
    bands = [
        gaussian_filter(rgb2lab(picture), (LOW_BAND, LOW_BAND, 0)) for picture in (frame, particles)
    ]
    return float(np.sqrt(((bands[0] - bands[1]) ** 2).sum(axis=-1).mean()))


def steps(film: list[Array]) -> list[float]:
    """Return the root mean square change from each picture to the next."""
    return [float(np.sqrt(np.mean((after - before) ** 2))) for before, after in pairwise(film)]


def _unevenness(film: list[Array]) -> float:
    found = steps(film)
    return max(found) / max(float(np.mean(found)), NO_STEP)


def _flicker(film: list[Array]) -> float:
    return sum(steps(film)) / max(sum(steps(film[::2])), NO_STEP)
