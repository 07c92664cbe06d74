"""Images divided into bands, and the mixture of such images along motions.

A mixture of images with shares w_i shows, at each place,

    (1 - c) particles + c sum_i w_i low_i + g sum_i k_i high_i,

where each image is sampled where its motion says (`clmorph.frames.carried_detail` explains the
factors c, g and k).
"""

import math
from collections.abc import Sequence
from functools import partial
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.enlarging import enlarged
from clmorph._shared.threads import in_order
from clmorph.backends.interface import Operations
from clmorph.backends.numpy import NumPyOperations
from clmorph.backends.records import Motion
from clmorph.frames.canvas import Canvas
from clmorph.frames.halfway import sampled
from clmorph.frames.resampling import reduced
from clmorph.images.color import to_space

Array = NDArray[np.float64]
_Samples = NDArray[np.float32]

#: Standard deviation of the Gaussian between both bands: a share of the longer side, and at least
#: this number of pixels.
BAND_SHARE, NARROWEST_BAND = 0.016, 1.5
#: What is as smooth as the lower band is computed with so many pixels for each standard deviation.
FINENESS = 2.0
#: The largest number of pixels of a strip of a frame that one thread computes at a time.
STRIP_PIXELS = 2**18
#: The details of images with so many pixels are sampled by the device: to build its kernel takes
#: a second.
MANY_PIXELS = 2**20
#: Difference of the lower bands at which c falls to 1/e, and variance of a detail that nobody sees.
#: Both are in Oklab, where the difference from black to white is 2.2; other spaces have their own.
AGREEMENT, FLOOR = 0.1, 1e-5
#: The deviation to which g lowers a mixture, relative to that of both details mixed by t. Between
#: unlike images the lower band is softer than those of the images; a detail a little stronger
#: makes frames as sharp as the images are. At both ends, and where details agree, g is 1 anyway.
CRISPNESS = 1.03
ALL_ROWS = slice(None)


def band_width(shape: tuple[int, int]) -> float:
    """Return the standard deviation of the Gaussian between both bands, in pixels."""
    return max(NARROWEST_BAND, BAND_SHARE * max(shape))


def coarse_canvas(canvas: Canvas) -> Canvas:
    """Return the canvas on which what is as smooth as the lower band is computed."""
    longest = max(canvas.shape)
    return canvas.reduced(math.ceil(FINENESS * longest / band_width(canvas.shape)))


def coarse_band_width(canvas: Canvas) -> float:
    """Return the standard deviation of the Gaussian between both bands, in coarse pixels."""
    return band_width(canvas.shape) * max(coarse_canvas(canvas).shape) / max(canvas.shape)


def color_unit(space: str) -> float:
    """Return the unit of a color space, where that of Oklab is 1."""
    white, usual = (float(np.max(to_space(np.ones(3), each))) for each in (space, "oklab"))
    return white / usual


class Bands(NamedTuple):
    """An image divided into bands, ready to be sampled.

    Attributes
    ----------
    sampler : Operations
        The backend that samples the detail.
    detail
        Image less lower band, as a spline that the sampler holds.
    smooth : (h, w, 7) array
        On a coarse canvas, the lower band, what the particles lack of it at this end, and the local
        variance of the detail.
    canvas, coarse : Canvas
        The canvas of the image, and its `coarse_canvas`.
    """

    sampler: Operations
    detail: Any
    smooth: _Samples
    canvas: Canvas
    coarse: Canvas

    @classmethod
    def of(
        cls,
        colors: Array,
        canvas: Canvas,
        shown: Array | None = None,
        operations: Operations | None = None,
    ) -> "Bands":
        """Divide an image into bands.

        Parameters
        ----------
        colors : (H, W, 3) array
            The image in the space of the path.
        canvas : Canvas
        shown : (h, w, 3) array, optional
            What the particles show at this end, drawn on the coarse canvas with a kernel of
            `band_width`. It differs from the lower band where pixels have unequal masses, or where
            a plan leaves some out.
        operations : Operations, optional
            The backend that samples the detail of large images; NumPy by default.
        """
        from scipy.ndimage import spline_filter

        coarse = coarse_canvas(canvas)
        width = coarse_band_width(canvas)
        few = reduced(colors, coarse.shape)
        low = mean_around(few, width)
        detail = np.asarray(colors - enlarged(low, canvas.shape), dtype=np.float64)
        squares: Array = np.einsum("ijk,ijk->ij", detail, detail)[..., None]
        powers = reduced(squares, coarse.shape)
        variance = mean_around(powers, width)
        channels = np.moveaxis(detail, -1, 0)
        filtered = in_order(partial(spline_filter, order=3, mode="mirror"), channels)
        coefficients = [coefficient for _, coefficient in filtered]
        lacking = np.zeros_like(low) if shown is None else low - shown
        smooth = np.dstack((low, lacking, variance))
        many = math.prod(canvas.shape) >= MANY_PIXELS
        sampler = operations if many and operations is not None else NumPyOperations()
        spline = sampler.upload_spline(np.stack(coefficients, axis=-1).astype(np.float32))
        return cls(sampler, spline, smooth.astype(np.float32), canvas, coarse)

    def motion(self, canvas: Canvas, displacement: Array) -> Motion:
        """Return where the pixels of a canvas take their detail.

        Parameters
        ----------
        canvas : Canvas
        displacement : (h, w, 2) array
            From a place of the canvas to that of the image, on a grid over the canvas, in units of
            the common frame.
        """
        corner = canvas.positions(0, 1)[0, 0]
        pitch = 1.0 / np.maximum(canvas.scale, 1e-9)
        origin, beyond = self.canvas.places(np.stack((corner, corner + pitch))).T
        step = beyond - origin
        scaled = (displacement * self.canvas.scale)[..., ::-1]
        return Motion(
            canvas.shape, (float(origin[0]), float(origin[1])), (float(step[0]), float(step[1])),
            scaled,
        )  # fmt: skip

    def detail_at(self, motion: Motion, rows: slice) -> _Samples:
        """Sample the detail for some rows of a canvas."""
        return self.sampler.sample_spline(self.detail, motion, rows.start, rows.stop)

    def smooth_at(self, positions: Array) -> "Smooth":
        """Sample what is smooth at positions (..., 2) of the common frame."""
        found = sampled(self.smooth, self.coarse.places(positions))
        return Smooth(found[..., :3], found[..., 3:6], found[..., 6:])


class Smooth(NamedTuple):
    """What is smooth of `Bands`, at some positions: (..., 3) arrays, and (..., 1) variances."""

    low: _Samples
    lacking: _Samples
    variance: _Samples


def kernel_width(bands: Sequence[Bands], shares: Sequence[float], canvas: Canvas) -> float:
    """Return the kernel width of particles that show the lower band of a mixture.

    Parameters
    ----------
    bands : sequence of Bands
    shares : sequence of float
        The share of each image, with the sum 1.
    canvas : Canvas
        The canvas of the frame.

    Returns
    -------
    float
        In pixels of the coarse canvas.
    """
    shrink = max(coarse_canvas(canvas).shape) / max(canvas.shape)
    widths = [band_width(each.canvas.shape) for each in bands]
    return sum(share * width for share, width in zip(shares, widths, strict=True)) * shrink


def mixed(
    bands: Sequence[Bands],
    shares: Sequence[float],
    motions: Sequence[Array],
    canvas: Canvas,
    colors: Array,
    fade: float,
    unit: float,
    part: slice = ALL_ROWS,
) -> Array:
    """Return some rows of a mixture of images along motions, all by default: (rows, W, 3) array.

    Parameters
    ----------
    bands : sequence of Bands
    shares : sequence of float
        The share of each image, with the sum 1.
    motions : sequence of (h, w, 2) arrays
        From a place of the frame to the place of each image that is seen there, on a grid of any
        fineness over the canvas, in units of the common frame.
    canvas : Canvas
    colors : (h, w, 3) array
        What the particles show on the coarse canvas, drawn with `kernel_width`.
    fade : float
        Share of what particles lack of the lower bands that is added to them.
    unit : float
        Unit of the color space, where that of Oklab is 1.
    part : slice
        The rows.
    """
    coarse = coarse_canvas(canvas)
    width = kernel_width(bands, shares, canvas)
    # Local deviations at the border of the part depend on what is beside it.
    first, last, _ = part.indices(canvas.shape[0])
    beside = math.ceil(4 * width * canvas.shape[0] / coarse.shape[0])
    wider = slice(max(0, first - beside), last + beside)
    details = _details(bands, motions, canvas, _strips(canvas, wider))
    places = coarse.positions()
    smooth = [
        each.smooth_at(places + enlarged(motion, coarse.shape))
        for each, motion in zip(bands, motions, strict=True)
    ]
    floor = FLOOR * unit**2
    strong = [
        share * np.sqrt(each.variance + floor) for share, each in zip(shares, smooth, strict=True)
    ]
    strongest = sum(strong)
    k = [each / strongest for each in strong]
    found = sum(ki**2 * each.variance for ki, each in zip(k, smooth, strict=True))
    differ, pairs = 0.0, 0.0
    for i, j in combinations(range(len(bands)), 2):
        product = np.einsum("ijk,ijk->ij", details[i], details[j])[..., None]
        found = found + 2 * k[i] * k[j] * mean_around(reduced(product, coarse.shape), width)
        weight = shares[i] * shares[j]
        differ = differ + weight * ((smooth[i].low - smooth[j].low) ** 2).sum(axis=-1)[..., None]
        pairs += weight
    gain = np.minimum(1.0, CRISPNESS * strongest / np.sqrt(np.maximum(found, 0.0) + floor))
    # A single image agrees with itself.
    agree = np.exp(-differ / (pairs or 1.0) / (AGREEMENT * unit) ** 2)
    lacking = sum(share * each.lacking for share, each in zip(shares, smooth, strict=True))
    lows = sum(share * each.low for share, each in zip(shares, smooth, strict=True))
    low = (1 - agree) * (colors + fade * lacking) + agree * lows
    layers = np.dstack((low, *(gain * ki for ki in k)))
    picture = np.empty((*canvas.shape, 3))

    def mix(rows: slice) -> None:
        here = enlarged(layers, canvas.shape, rows.start, rows.stop)
        picture[rows] = here[..., :3]
        for number, detail in enumerate(details):
            picture[rows] += here[..., 3 + number, None] * detail[rows]

    for _ in in_order(mix, _strips(canvas, part)):
        pass
    return picture[part]


def _details(
    bands: Sequence[Bands], motions: Sequence[Array], canvas: Canvas, strips: list[slice]
) -> list[_Samples]:
    """Return the details of images where the motions have brought them.

    Rows outside of the strips are zero.
    """
    found = [np.zeros((*canvas.shape, 3), np.float32) for _ in bands]

    taken = [each.motion(canvas, own) for each, own in zip(bands, motions, strict=True)]

    def sample(rows: slice) -> None:
        for out, each, motion in zip(found, bands, taken, strict=True):
            out[rows] = each.detail_at(motion, rows)

    for _ in in_order(sample, strips):
        pass
    return found


def _strips(canvas: Canvas, part: slice) -> list[slice]:
    """Return rows of a canvas in some strips, which threads compute at the same time."""
    first, last, _ = part.indices(canvas.shape[0])
    rows = max(1, min(-(-(last - first) // 4), STRIP_PIXELS // canvas.shape[1]))
    return [slice(row, min(row + rows, last)) for row in range(first, last, rows)]


def mean_around(image: NDArray[np.floating], width: float) -> Array:
    """Return the mean of an image (H, W, C) under a Gaussian, of pixels inside the image alone."""
    from scipy.ndimage import gaussian_filter, gaussian_filter1d

    down, along = (
        gaussian_filter1d(np.ones(side, dtype=image.dtype), width, mode="constant")
        for side in image.shape[:2]
    )
    channels = [
        gaussian_filter(image[..., channel], width, mode="constant")
        for channel in range(image.shape[2])
    ]
    return np.stack(channels, axis=-1) / (down[:, None] * along)[..., None]
