"""Give a picture the colors of another one."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple, Unpack

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from clmorph._shared.notebook import picture
from clmorph._shared.progress import Report, Share, StageProgress
from clmorph._shared.threads import in_order
from clmorph._shared.typing import Array, ArrayLike
from clmorph._shared.validation import check_progress
from clmorph.backends.arrays import as_array
from clmorph.backends.interface import Operations
from clmorph.backends.select import Backend, get_backend
from clmorph.errors import InputError
from clmorph.images.color import into_gamut, to_space
from clmorph.images.pixels import as_pixels, split_alpha, to_bytes
from clmorph.measures.points import WeightedPoints
from clmorph.pipeline.color_map import ColorMap, color_map
from clmorph.pipeline.documentation import documented
from clmorph.pipeline.keywords import RecolorKeywords
from clmorph.pipeline.recolor_options import RecolorOptions

#: Number of pixels, in rows and columns at even distances, whose colors make the distributions.
SAMPLES = 1 << 19
#: Pixels that are recolored at once.
CHUNK = 1 << 16
#: Levels of a channel of 8 bits.
LEVELS = 256
#: Channels, in sRGB, below which a color counts as near black.
DARK = 16 / 255
#: Largest slope of the map there, and by how much the way to the map of other colors is steeper.
SLOPE, SLOPE_BETWEEN = 1.0, 3.0
#: Grays that count as near black in every picture, each as much as this number of pixels.
GRAYS, WEIGHT = 17, 1e-3


class Recolored(np.ndarray):
    """A recolored picture: an array like any other, which a notebook shows as a picture.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> found = clmorph.recolor(np.zeros((2, 2, 3)), np.ones((2, 2, 3)), backend="numpy")
    >>> isinstance(found, np.ndarray), found.shape
    (True, (2, 2, 3))
    >>> found._repr_html_().startswith("<figure")
    True
    """

    def __array_wrap__(self, array: Any, context: Any = None, return_scalar: bool = False) -> Any:
        """Results of calculations are plain arrays and numbers."""
        return np.asarray(array) if array.ndim else array[()]

    def _repr_html_(self) -> str | None:
        """Show the picture in a notebook; None, for the numbers, if this is none."""
        if self.ndim != 3 or self.shape[2] not in (3, 4) or not self.size:
            return None
        if self.dtype != np.float64 or not ((self >= 0) & (self <= 1)).all():
            return None
        height, width = self.shape[:2]
        return picture(to_bytes(np.asarray(self)), f"Recolored picture, {width} × {height} pixels")


@documented(RecolorOptions)
def recolor(
    image: ArrayLike,
    like: ArrayLike,
    options: RecolorOptions | None = None,
    *,
    mask: ArrayLike | None = None,
    backend: Backend = "auto",
    progress: StageProgress | None = None,
    **given: Unpack[RecolorKeywords],
) -> Recolored:
    """Give a picture the colors of another one, by transport between their distributions of color.

    Every pixel stays in its place, and its color goes where the smooth, debiased map of the
    transport sends it. Pixels of one color keep one color, and gradients stay smooth.

    Parameters
    ----------
    image : array
        The picture to be recolored, see `clmorph.images.pixels.as_pixels`.
    like : array
        The picture that has the colors, of any size. Its pixels count by their opacity.
    options : RecolorOptions, optional
        All options at once; options given by name replace those of this object.
    mask : (H, W) array, optional
        Where the image is recolored, of its height and width: bool, or uint8, uint16 or floats,
        of which the largest value (1 for floats) means in full. Other pixels keep their colors
        exactly, and their colors do not count.
    backend : str, object of pyopencl, or Operations
        See `clmorph.get_backend`.
    progress : callable, optional
        A function that is called with a stage's name and the share of it that is done.
    {options}

    Returns
    -------
    Recolored
        A float64 array (H, W, 3), or (H, W, 4) if the image has opacity, which notebooks show:
        sRGB in [0, 1]; opacity is that of the image. Colors that sRGB cannot show lose chroma, and
        keep lightness and hue.

    Raises
    ------
    InputError
        If an argument cannot be used.
    DeviceError
        If the device cannot be found or fails.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> gray = np.linspace(0.0, 1.0, 5)[None]
    >>> blue = gray[..., None] * [0.2, 0.4, 1.0]
    >>> clmorph.recolor(gray, blue, reach=None, backend="numpy").round(2)[0, -1].tolist()
    [0.2, 0.4, 1.0]
    >>> bool((clmorph.recolor(gray, blue, strength=0, backend="numpy")[..., 0] == gray).all())
    True
    """
    chosen = RecolorOptions.of_call(options, given, "strength=0.5")
    check_for_picture(chosen)
    report = check_progress(progress)
    pixels, other = as_pixels(image, "image"), as_pixels(like, "like")
    amount = as_mask(mask, (pixels.shape[0], pixels.shape[1]))
    return recolored(pixels, other, chosen, amount, backend, report)[0].view(Recolored)


def recolored(
    pixels: Array,
    like: Array,
    options: RecolorOptions,
    mask: Array | None,
    backend: Backend,
    report: StageProgress,
) -> tuple[Array, Look | None]:
    """Recolor a picture by checked arguments; the look is returned too, None if nothing changes."""
    found = pixels.copy()
    mask = feathered(mask, options.feather)
    look = look_of(pixels, like, options, mask, get_backend(backend), report)
    if look is not None:
        shares = np.ones(pixels.shape[:2]) if mask is None else mask
        _apply(found, look, options.strength * shares, report)
    return found, look


def look_of(
    pixels: Array,
    like: Array,
    options: RecolorOptions,
    mask: Array | None,
    operations: Operations,
    report: StageProgress,
) -> Look | None:
    """Return the look that gives a picture the colors of another one; None if nothing changes."""
    visible = weights_of(like)
    colors, alpha = split_alpha(pixels)
    masses = np.ones(colors.shape[:2]) if mask is None else mask
    masses = masses if alpha is None else masses * alpha
    if options.strength == 0 or not masses.any():
        return None
    return fitted_look(
        (colors, masses), (like[..., :3], visible), options, operations,
        lambda share: report("colors", share),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Look:
    """What becomes of each color: a map in a color space, and its limit near black."""

    change: ColorMap
    space: str
    strength: float
    dark: NearBlack

    def moved(self, colors: Array, report: StageProgress, shares: Array | None = None) -> Array:
        """Return colors (N, 3) after shares (N,) of their steps, in full if None, part by part."""
        shares = np.full(len(colors), self.strength) if shares is None else shares

        def moved(part: slice) -> Array:
            return self._moved(colors[part], shares[part])

        found = np.empty_like(colors)
        for part, result in in_order(moved, _parts(len(colors))):
            found[part] = result
            report("pixels", Share(min(1.0, part.stop / len(colors))))
        return found

    def _moved(self, colors: Array, shares: Array) -> Array:
        found = _stepped(colors, shares, self.change, self.space)
        near = np.flatnonzero(self.dark.far(colors) < 1.0)
        whole = shares[near] == self.strength
        ours, moved = colors[near], found[near]
        found[near[whole]] = self.dark.limited(ours[whole], moved[whole])
        # Where the mask is soft, ways are straight near black, and bent as in the space elsewhere.
        chosen, ours, moved = near[~whole], ours[~whole], moved[~whole]
        if len(chosen):
            full = np.full(len(chosen), self.strength)
            free = _stepped(ours, full, self.change, self.space)
            parts = (shares[chosen] / self.strength)[:, None]
            bent = (moved - ours) - parts * (free - ours)
            way = parts * (self.dark.limited(ours, free) - ours)
            found[chosen] = np.clip(ours + way + self.dark.far(ours) * bent, 0.0, 1.0)
        return found


def fitted_look(
    source: tuple[Array, Array],
    target: tuple[Array, Array],
    options: RecolorOptions,
    operations: Operations,
    report: Report,
) -> Look:
    """Return the look that gives colors (H, W, 3) of masses (H, W) those of others."""
    space, strength = options.color_space, options.strength
    colors, masses = _sampled(*source)
    pair = [
        WeightedPoints(to_space(values, space), weights)
        for values, weights in ((colors, masses), _sampled(*target))
    ]
    change = color_map(pair[0], pair[1], options.blur, options.reach, operations, report)
    dark = near_black(
        colors, masses,
        lambda chosen: _stepped(chosen, np.full(len(chosen), strength), change, space),
    )  # fmt: skip
    return Look(change, space, strength, dark)


class NearBlack(NamedTuple):
    """The map of colors near black: mean + slope (color - middle), no steeper than the picture.

    Color spaces are steep at black: in Oklab the cube root makes the levels 0 and 3 of 8 bits as
    different as 60 and 90, and where dark noise is a large part of a picture, a map that gives it
    the other picture's colors spreads it over all of them.
    """

    #: Mean of the picture's colors near black, and of what the map makes of them: (3,) arrays.
    middle: Array
    mean: Array
    slope: float

    def far(self, colors: Array) -> Array:
        """Return how far colors may be from the line, (N, 1): at 1 `limited` changes nothing."""
        apart = SLOPE_BETWEEN * (colors.max(axis=1) - DARK)
        return np.clip(apart, 0.0, 1.0)[:, None]

    def limited(self, colors: Array, moved: Array) -> Array:
        """Return what a map makes of colors, (N, 3), limited around the line, continuously."""
        line = self.mean + self.slope * (colors - self.middle)
        far = self.far(colors)
        return np.clip(np.clip(moved, line - far, line + far), 0.0, 1.0)


def near_black(colors: Array, weights: Array, move: Callable[[Array], Array]) -> NearBlack:
    """Fit a line of slope 0 to `SLOPE` to what a map makes of colors (N, 3) near black."""
    dark = colors.max(axis=1) <= DARK
    grays = np.repeat(np.linspace(0.0, DARK, GRAYS)[:, None], 3, axis=1)
    before = np.concatenate((colors[dark], grays))
    share = np.concatenate((weights[dark], np.full(GRAYS, WEIGHT)))
    share = (share / share.sum())[:, None]
    after = move(before)
    middle, mean = (share * before).sum(axis=0), (share * after).sum(axis=0)
    apart = before - middle
    slope = float((share * apart * (after - mean)).sum() / (share * apart**2).sum())
    return NearBlack(middle, mean, float(np.clip(slope, 0.0, SLOPE)))


def _stepped(colors: Array, shares: Array, change: ColorMap, space: str) -> Array:
    """Return colors (N, 3) after shares (N,) of their steps, without a limit."""
    coordinates = to_space(colors, space)
    return into_gamut(coordinates + shares[:, None] * change.steps(coordinates), space)


def lattice(size: int) -> Array:
    """Return the colors (size³, 3) of a table, red slowest."""
    levels = np.linspace(0.0, 1.0, size)
    return np.stack(np.meshgrid(levels, levels, levels, indexing="ij"), axis=-1).reshape(-1, 3)


def weights_of(like: Array) -> Array:
    """Return how much each pixel (H, W) of a picture counts whose colors are taken."""
    visible = np.ones(like.shape[:2]) if like.shape[2] == 3 else like[..., 3]
    if not visible.any():
        raise InputError("like: every pixel is transparent; expected colors to take")
    return visible


def feathered(mask: Array | None, width: float) -> Array | None:
    """Return a mask, if there is one, whose edges are softened over a width in pixels."""
    if mask is None or not width:
        return mask
    return np.clip(gaussian_filter(mask, 0.5 * width, mode="nearest"), 0.0, 1.0)


def check_for_picture(options: RecolorOptions) -> None:
    """Raise InputError if an option is given that concerns clips."""
    if options.reference_frame is not None:
        raise InputError(
            f"reference_frame={options.reference_frame} belongs to a clip; leave it out for a "
            "picture"
        )


def as_mask(mask: Any, shape: tuple[int, int]) -> Array | None:
    """Return a mask for an image of this shape as an (H, W) array in [0, 1]; None without one."""
    if mask is None:
        return None
    expected = f"an array (H, W) = {shape} as the image has, with values in [0, 1]"
    values = as_array("mask", mask, expected)
    if values.shape != shape:
        raise InputError(f"mask has shape {values.shape}: expected {expected}")
    return np.ascontiguousarray(as_pixels(values, "mask")[..., 0])


def _sampled(colors: Array, masses: Array) -> tuple[Array, Array]:
    """Return the colors (N, 3) of an image, or of a sample of its pixels, and their masses."""
    step = max(1, int(np.ceil(np.sqrt(masses.size / SAMPLES))))
    if masses[::step, ::step].any():
        colors, masses = colors[::step, ::step], masses[::step, ::step]
    seen = masses > 0
    return colors[seen], masses[seen]


def _apply(pixels: Array, look: Look, amounts: Array, report: StageProgress) -> None:
    """Recolor pixels in place, by the shares `amounts`."""
    flat, shares = pixels.reshape(amounts.size, -1), amounts.ravel()
    chosen = np.flatnonzero(shares > 0)
    shares = shares[chosen]
    codes = _codes(flat, chosen) if np.all(shares == shares[0]) else None
    if codes is None:
        flat[chosen, :3] = look.moved(flat[chosen, :3], report, shares)
        return
    # Pictures of 8 bits have many more pixels than colors.
    known = np.zeros(LEVELS**3, bool)
    known[codes] = True
    distinct = np.flatnonzero(known)
    colors = np.stack(np.unravel_index(distinct, (LEVELS,) * 3), axis=1) / (LEVELS - 1.0)
    found = look.moved(colors, report, shares[: len(distinct)])
    places = np.zeros(LEVELS**3, np.int32)
    places[distinct] = np.arange(len(distinct))
    for part in _parts(len(chosen)):
        flat[chosen[part], :3] = found[places[codes[part]]]


def _parts(count: int) -> Iterator[slice]:
    """Return the parts of `count` pixels that are worked on at once."""
    return (slice(start, start + CHUNK) for start in range(0, count, CHUNK))


def _codes(flat: Array, chosen: NDArray[np.intp]) -> NDArray[np.int32] | None:
    """Return one number for each color of 8 bits a channel; None if not all are such colors."""
    codes = np.empty(len(chosen), np.int32)
    for part in _parts(len(chosen)):
        colors = flat[chosen[part], :3]
        levels = np.rint((LEVELS - 1.0) * colors).astype(np.int32)
        if not np.array_equal(levels / (LEVELS - 1.0), colors):
            return None
        codes[part] = (levels[:, 0] * LEVELS + levels[:, 1]) * LEVELS + levels[:, 2]
    return codes
