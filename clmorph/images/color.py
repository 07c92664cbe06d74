"""Color spaces for the cost and for the path, and metrics of color (paper, section 5).

A space maps sRGB in [0, 1] to three coordinates, divided by one number so that two colors drawn
uniformly from the sRGB cube have the same root mean square distance in every space. A color weight
therefore means the same in all spaces.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import Literal, get_args

import numpy as np

from clmorph._shared.threads import in_order
from clmorph._shared.typing import Array, ArrayLike, BoolArray
from clmorph._shared.validation import check_choice
from clmorph.backends.arrays import as_floats
from clmorph.errors import InputError

#: "srgb": the stored values (as in the paper). "linear": linear light. "lab", "luv": CIE 1976 with
#: D65. "oklab": Ottosson, "A perceptual color space for image processing" (2020).
ColorSpace = Literal["srgb", "linear", "lab", "luv", "oklab"]
COLOR_SPACES = get_args(ColorSpace)

#: Matrices of Oklab: from linear sRGB to cone responses, and from the cube roots of these to
#: lightness and two opponent colors.
_TO_CONES = np.array(
    [
        [0.4122214708, 0.5363325363, 0.0514459929],
        [0.2119034982, 0.6806995451, 0.1073969566],
        [0.0883024619, 0.2817188376, 0.6299787005],
    ]
)
_TO_OPPONENTS = np.array(
    [
        [0.2104542553, 0.7936177850, -0.0040720468],
        [1.9779984951, -2.4285922050, 0.4505937099],
        [0.0259040371, 0.7827717662, -0.8086757660],
    ]
)

#: Number of colors that are converted at a time: they stay in the cache of a core.
PART = 1 << 16

#: Samples of each channel over which the scale of a space is averaged.
_SCALE_STEPS = 17

#: Distance, in coordinates of a space, up to which a color that was clipped counts as the same.
_SAME_COLOR = 1e-3
#: Halvings of the interval in which the largest chroma lies.
_HALVINGS = 10
#: Weights of red, green and blue in luminance (IEC 61966-2-1), for spaces without lightness.
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def to_space(colors: ArrayLike, space: str) -> Array:
    """Convert sRGB (..., 3) in [0, 1] to coordinates of a color space, in this module's unit."""
    check_choice("color space", space, COLOR_SPACES)
    convert, scale = _CONVERSIONS[space][0], _scale(space)
    return _in_parts(lambda part: convert(part) / scale, np.asarray(colors, float))


def from_space(coordinates: ArrayLike, space: str) -> Array:
    """Convert coordinates (..., 3) of a color space to sRGB, clipped: paths can leave the gamut."""
    check_choice("color space", space, COLOR_SPACES)
    convert, scale = _CONVERSIONS[space][1], _scale(space)

    def converted(part: Array) -> Array:
        return np.clip(np.nan_to_num(convert(part * scale)), 0.0, 1.0)

    return _in_parts(converted, np.asarray(coordinates, float))


def into_gamut(coordinates: Array, space: str) -> Array:
    """Convert coordinates (N, 3) to sRGB; colors outside move towards their gray, and keep hue."""
    colors = from_space(coordinates, space)
    # A color that was clipped has a channel at a bound.
    edge = np.flatnonzero(((colors <= 0.0) | (colors >= 1.0)).any(axis=1))
    outside = edge[~_is_same(coordinates[edge], colors[edge], space)]
    if not len(outside):
        return colors
    wanted = coordinates[outside]
    gray = _gray(wanted, space)
    low, high = np.zeros(len(wanted)), np.ones(len(wanted))
    for _ in range(_HALVINGS):
        share = 0.5 * (low + high)
        tried = gray + share[:, None] * (wanted - gray)
        inside = _is_same(tried, from_space(tried, space), space)
        low, high = np.where(inside, share, low), np.where(inside, high, share)
    colors[outside] = from_space(gray + low[:, None] * (wanted - gray), space)
    return colors


def _is_same(coordinates: Array, colors: Array, space: str) -> BoolArray:
    """Return whether colors in sRGB are those of the coordinates: (N,) array of bool."""
    apart = np.abs(to_space(colors, space) - coordinates).max(axis=1)
    return np.asarray(apart <= _SAME_COLOR, bool)


def _gray(coordinates: Array, space: str) -> Array:
    """Return the grays of the lightness of colors, in coordinates of the space."""
    if space in ("srgb", "linear"):
        values = np.repeat((coordinates @ LUMINANCE)[:, None], 3, axis=1)
    else:
        values = np.zeros_like(coordinates)
        values[:, 0] = coordinates[:, 0]
    white = to_space(np.ones(3), space)
    return np.clip(values, 0.0, np.maximum(white, 0.0))


def _in_parts(convert: Callable[[Array], Array], colors: Array) -> Array:
    """Convert colors (..., 3); of large images a part at a time, in several threads."""
    if colors.size <= 3 * PART:
        return convert(colors)
    rows = colors.reshape(-1, 3)
    found = np.empty(rows.shape)

    def convert_rows(part: slice) -> None:
        found[part] = convert(rows[part])

    parts = (slice(first, first + PART) for first in range(0, len(rows), PART))
    for _ in in_order(convert_rows, parts):
        pass
    return found.reshape(colors.shape)


def _from_lab(lab: Array) -> Array:
    """Return sRGB of CIELAB, with b limited so that Z is not negative: scikit-image would warn."""
    lightness, green_red, blue_yellow = np.moveaxis(lab, -1, 0)
    # Z grows with (L + 16) / 116 - b / 200. The limit is slightly lower, so that
    # rounding cannot make Z negative.
    most = 200 * ((lightness + 16) / 116 - 1e-9)
    lab = np.stack([lightness, green_red, np.minimum(blue_yellow, most)], axis=-1)
    return _by_skimage("lab2rgb", lab)


def as_metric(metric: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Return a metric of color (paper, 5), one or for each pixel, as (3, 3) or (H * W, 3, 3)."""
    values = as_floats("color_metric", metric, "an array (3, 3), (H, W, 3, 3) or (H, W)")
    constant = values.shape == (3, 3)
    if values.shape == shape and not constant:
        values = values[..., None, None] * np.eye(3)
    if values.shape not in ((3, 3), (*shape, 3, 3)):
        raise InputError(
            f"the color metric has shape {values.shape}: expected (3, 3), or for an image of "
            f"shape {shape} a map of shape {(*shape, 3, 3)} or {shape}"
        )
    if not np.all(np.isfinite(values)):
        raise InputError("the color metric holds NaN or infinity: expected finite numbers")
    values = values.reshape(-1, 3, 3)
    size = np.abs(values).max(axis=(1, 2))
    skew = np.abs(values - np.swapaxes(values, 1, 2)).max(axis=(1, 2))
    if np.any(skew > 1e-9 * size):
        raise InputError("the color metric is not symmetric: expected M equal to its transpose")
    lowest = np.linalg.eigvalsh(values)[:, 0]
    if np.any(lowest < -1e-9 * size) or size.max() > 1e6:
        raise InputError(
            "the color metric has a negative eigenvalue or entries above 1e6: expected a "
            "positive semidefinite matrix, so that distances are real"
        )
    return values[0] if constant else values


def square_root(metric: Array) -> Array:
    """Return L with L L^T = M, for a semidefinite M (Cholesky's factor up to a rotation)."""
    values, vectors = np.linalg.eigh(metric)
    return vectors * np.sqrt(np.maximum(values, 0.0))


def _to_oklab(colors: Array) -> Array:
    return np.asarray(np.cbrt(decode(colors) @ _TO_CONES.T) @ _TO_OPPONENTS.T)


def _from_oklab(values: Array) -> Array:
    cones = (values @ np.linalg.inv(_TO_OPPONENTS).T) ** 3
    return encode(cones @ np.linalg.inv(_TO_CONES).T)


def _by_skimage(name: str, values: Array) -> Array:
    """Convert by a function of `skimage.color`."""
    from skimage import color

    # scikit-image divides by zero, harmlessly, at black in Luv.
    with np.errstate(invalid="ignore", divide="ignore"):
        converted = getattr(color, name)(values.reshape(-1, 1, 3))
    return np.asarray(converted).reshape(values.shape)


@cache
def _scale(space: str) -> float:
    """Return the ratio of the root mean square distances in a space and in sRGB."""
    if space == "srgb":
        return 1.0
    channel = np.linspace(0.0, 1.0, _SCALE_STEPS)
    cube = np.stack(np.meshgrid(channel, channel, channel), axis=-1).reshape(-1, 3)
    spread = [np.sum(np.var(values, axis=0)) for values in (_CONVERSIONS[space][0](cube), cube)]
    return float(np.sqrt(spread[0] / spread[1]))


def decode(srgb: Array) -> Array:
    """Return the linear light of sRGB values (IEC 61966-2-1)."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((np.maximum(srgb, 0) + 0.055) / 1.055) ** 2.4)


def encode(light: Array) -> Array:
    """Return the sRGB values of linear light (IEC 61966-2-1)."""
    positive = np.maximum(light, 0.0)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * positive ** (1 / 2.4) - 0.055)


#: Each space's conversion from sRGB and back, before the division by `_scale`.
_CONVERSIONS: dict[str, tuple[Callable[[Array], Array], Callable[[Array], Array]]] = {
    "srgb": (np.asarray, np.asarray),
    "linear": (decode, encode),
    "lab": (partial(_by_skimage, "rgb2lab"), _from_lab),
    "luv": (partial(_by_skimage, "rgb2luv"), partial(_by_skimage, "luv2rgb")),
    "oklab": (_to_oklab, _from_oklab),
}
assert set(_CONVERSIONS) == set(COLOR_SPACES)
