"""Frames whose fine detail comes from the images themselves, carried along the mean motion.

The particles of a plan average the colors of many pixels, so a frame halfway is soft. Here the
particles give a frame's lower band alone: they are drawn with a kernel as wide as `band_width`.
What the images have above it is sampled where the motion halfway (`halfway`) says, and mixed:

    frame = (1 - c) particles + c [(1 - t) low A + t low B] + g [(1 - k) high A + k high B]

- k is t where both details are equally strong; elsewhere the stronger one prevails, so that fewer
  outlines lie upon one another.
- g lowers the local standard deviation of the mixture to that of both details mixed by t, and
  `CRISPNESS` of it: without g a detail that prevails would not fade.
- To the particles is added what they lack of the lower band at either end; it is sampled as the
  detail is, and fades towards the middle with `endpoints.share`.
- c is near 1 where both lower bands agree along the motion, so that a picture and its own smooth
  deformation need nothing of the particles.
"""

from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clmorph.frames.canvas import Canvas
from clmorph.frames.endpoints import share
from clmorph.frames.halfway import mean_displacement, register, sampled
from clmorph.frames.particles import Particles
from clmorph.images.color import to_space
from clmorph.measures.measure import Measure

Array = NDArray[np.float64]
_Samples = NDArray[np.float32]

#: Standard deviation of the Gaussian between both bands: a share of the longer side, and at least
#: this number of pixels.
BAND_SHARE, NARROWEST_BAND = 0.016, 1.5
#: Difference of the lower bands at which c falls to 1/e, and variance of a detail that nobody sees.
#: Both are in Oklab, where the difference from black to white is 2.2; other spaces have their own.
AGREEMENT, FLOOR = 0.1, 1e-5
#: The deviation to which g lowers a mixture, relative to that of both details mixed by t. Between
#: unlike images the lower band is softer than those of the images; a detail a little stronger
#: makes frames as sharp as the images are. At both ends, and where details agree, g is 1 anyway.
CRISPNESS = 1.03


def band_width(shape: tuple[int, int]) -> float:
    """Return the standard deviation of the Gaussian between both bands, in pixels."""
    return max(NARROWEST_BAND, BAND_SHARE * max(shape))


class Bands(NamedTuple):
    """An image divided into bands, ready to be sampled.

    Attributes
    ----------
    detail : (H, W, 3) array
        Image less lower band, as coefficients of a cubic spline.
    smooth : (H, W, 7) array
        The lower band, what the particles lack of it at this end, and the local variance of the
        detail.
    canvas : Canvas
        The canvas of the image.
    """

    detail: _Samples
    smooth: _Samples
    canvas: Canvas

    @classmethod
    def of(cls, colors: Array, canvas: Canvas, shown: Array | None = None) -> "Bands":
        """Divide an image into bands.

        Parameters
        ----------
        colors : (H, W, 3) array
            The image in the space of the path.
        canvas : Canvas
        shown : (H, W, 3) array, optional
            What the particles show at this end, drawn with a kernel of `band_width`. It differs
            from the lower band where pixels have unequal masses, or where a plan leaves some out.
        """
        from scipy.ndimage import spline_filter

        width = band_width(canvas.shape)
        low = _mean_around(colors, width)
        detail = colors - low
        variance = _mean_around((detail**2).sum(axis=-1)[..., None], width)
        coefficients = [
            spline_filter(detail[..., channel], order=3, mode="mirror") for channel in range(3)
        ]
        lacking = np.zeros_like(low) if shown is None else low - shown
        smooth = np.dstack((low, lacking, variance))
        return cls(
            np.stack(coefficients, axis=-1).astype(np.float32), smooth.astype(np.float32), canvas
        )

    def at(self, positions: Array) -> "Samples":
        """Sample the bands at positions (H, W, 2) of the common frame."""
        places = self.canvas.places(positions)
        smooth = sampled(self.smooth, places, order=1)
        return Samples(
            sampled(self.detail, places, order=3),
            smooth[..., :3],
            smooth[..., 3:6],
            smooth[..., 6:],
        )


class Samples(NamedTuple):
    """Bands at the positions of a frame, see `Bands`: (H, W, 3) arrays, and (H, W, 1) variances."""

    detail: _Samples
    low: _Samples
    lacking: _Samples
    variance: _Samples


class CarriedDetail:
    """The bands of both images and the motion between them.

    Parameters
    ----------
    measures : (source, target)
        Measures of opaque images.
    particles : Particles
        The particles of their plan.
    canvases : three of Canvas
        At t = 0, 1/2 and 1.
    shown : (source's, target's)
        What the particles show at t = 0 and t = 1, drawn with `band_width`: (H, W, 3) arrays in the
        space of the path.
    """

    def __init__(
        self,
        measures: tuple[Measure, Measure],
        particles: Particles,
        canvases: tuple[Canvas, Canvas, Canvas],
        shown: tuple[Array, Array],
    ) -> None:
        start, middle, end = canvases
        colors = [measure.colors.reshape(*measure.shape, 3) for measure in measures]
        first, second = (to_space(image, "oklab")[..., 0] for image in colors)
        displacement, grid = mean_displacement(particles, middle)
        self._motion = register((first, second), (start, end), displacement, grid)
        self._bands = [
            Bands.of(to_space(image, particles.path_space), canvas, low)
            for image, canvas, low in zip(colors, (start, end), shown, strict=True)
        ]

        white = [float(np.max(to_space(np.ones(3), s))) for s in (particles.path_space, "oklab")]
        #: The unit of the path's color space, where that of Oklab is 1.
        self._unit = white[0] / white[1]

    def kernel_width(self, t: float) -> float:
        """Return the kernel width with which particles are drawn at time t, in pixels."""
        start, end = (band_width(bands.canvas.shape) for bands in self._bands)
        return (1 - t) * start + t * end

    def frame(self, t: float, canvas: Canvas, colors: Array) -> Array:
        """Return a frame in the space of the path: (H, W, 3) array.

        Parameters
        ----------
        t : float
        canvas : Canvas
            The canvas at t.
        colors : (H, W, 3) array
            What the particles show, drawn with `kernel_width`.
        """
        positions = canvas.positions()
        # The displacement is smooth, so a coarse grid of it is enough.
        coarse = canvas.reduced(max(self._motion.displacement.shape))
        displacement = self._motion.at(t, coarse.positions())
        if coarse.shape != canvas.shape:
            displacement = sampled(displacement, coarse.places(positions), order=1)
        paths = positions - t * displacement, positions + (1 - t) * displacement
        with ThreadPoolExecutor(2) as pool:  # SciPy samples without Python's lock
            a, b = pool.map(Bands.at, self._bands, paths)
        floor = FLOOR * self._unit**2
        strong_a = (1 - t) * np.sqrt(a.variance + floor)
        strong_b = t * np.sqrt(b.variance + floor)
        k = strong_b / (strong_a + strong_b)
        detail = (1 - k) * a.detail + k * b.detail
        together = _mean_around((a.detail * b.detail).sum(axis=-1)[..., None], self.kernel_width(t))
        found = (1 - k) ** 2 * a.variance + k**2 * b.variance + 2 * k * (1 - k) * together
        wanted = CRISPNESS * (strong_a + strong_b)
        gain = np.minimum(1.0, wanted / np.sqrt(np.maximum(found, 0.0) + floor))
        differ = ((a.low - b.low) ** 2).sum(axis=-1)[..., None]
        agree = np.exp(-differ / (AGREEMENT * self._unit) ** 2)
        shown = colors + share(t) * ((1 - t) * a.lacking + t * b.lacking)
        low = (1 - agree) * shown + agree * ((1 - t) * a.low + t * b.low)
        return np.asarray(low + gain * detail, dtype=np.float64)


def _mean_around(image: NDArray[np.floating], width: float) -> Array:
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
