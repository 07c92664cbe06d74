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

All but both details is smooth, and is computed on a coarse canvas (`coarse_canvas`).

Where pixels have labels, each label has a motion of its own, that of its own particles, and a frame
is the mean of these mixtures, weighted by how much of each label is at a place: so no detail
crosses the borders of labels.
"""

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.enlarging import enlarged
from clmorph._shared.threads import in_order
from clmorph.backends.interface import Operations
from clmorph.backends.numpy import NumPyOperations
from clmorph.backends.records import Motion
from clmorph.frames.canvas import Canvas
from clmorph.frames.endpoints import share
from clmorph.frames.ends import End
from clmorph.frames.halfway import Halfway, mean_displacement, register, sampled
from clmorph.frames.particles import Particles
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
#: From so many pixels on, details are sampled by the device: to build its kernel takes a second.
MANY_PIXELS = 2**20
#: Difference of the lower bands at which c falls to 1/e, and variance of a detail that nobody sees.
#: Both are in Oklab, where the difference from black to white is 2.2; other spaces have their own.
AGREEMENT, FLOOR = 0.1, 1e-5
#: The deviation to which g lowers a mixture, relative to that of both details mixed by t. Between
#: unlike images the lower band is softer than those of the images; a detail a little stronger
#: makes frames as sharp as the images are. At both ends, and where details agree, g is 1 anyway.
CRISPNESS = 1.03
#: Least share of both images from which the motion of a label is registered, and largest number of
#: labels whose detail is carried: each costs a registration, and a share of each frame.
REGISTERED, MOST_LABELS = 0.1, 16
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


class Bands(NamedTuple):
    """An image divided into bands, ready to be sampled.

    Attributes
    ----------
    detail : (H, W, 3) array
        Image less lower band, as coefficients of a cubic spline.
    smooth : (h, w, 7) array
        On a coarse canvas, the lower band, what the particles lack of it at this end, and the local
        variance of the detail.
    canvas, coarse : Canvas
        The canvas of the image, and its `coarse_canvas`.
    """

    detail: _Samples
    smooth: _Samples
    canvas: Canvas
    coarse: Canvas

    @classmethod
    def of(cls, colors: Array, canvas: Canvas, shown: Array | None = None) -> "Bands":
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
        """
        from scipy.ndimage import spline_filter

        coarse = coarse_canvas(canvas)
        width = coarse_band_width(canvas)
        few = reduced(colors, coarse.shape)
        low = _mean_around(few, width)
        detail = np.asarray(colors - enlarged(low, canvas.shape), dtype=np.float64)
        squares: Array = np.einsum("ijk,ijk->ij", detail, detail)[..., None]
        powers = reduced(squares, coarse.shape)
        variance = _mean_around(powers, width)
        coefficients = [
            spline_filter(detail[..., channel], order=3, mode="mirror") for channel in range(3)
        ]
        lacking = np.zeros_like(low) if shown is None else low - shown
        smooth = np.dstack((low, lacking, variance))
        return cls(
            np.stack(coefficients, axis=-1).astype(np.float32), smooth.astype(np.float32),
            canvas, coarse,
        )  # fmt: skip

    def motion(self, canvas: Canvas, displacement: Array) -> Motion:
        """Return where the pixels of a canvas take their detail.

        Parameters
        ----------
        canvas : Canvas
        displacement : (h, w, 2) array
            On a grid over the canvas, in units of the common frame.
        """
        corner = canvas.positions(0, 1)[0, 0]
        pitch = 1.0 / np.maximum(canvas.scale, 1e-9)
        origin, beyond = self.canvas.places(np.stack((corner, corner + pitch))).T
        scaled = (displacement * self.canvas.scale)[..., ::-1]
        return Motion(canvas.shape, tuple(origin), tuple(beyond - origin), scaled)

    def smooth_at(self, positions: Array) -> "Smooth":
        """Sample what is smooth at positions (..., 2) of the common frame."""
        found = sampled(self.smooth, self.coarse.places(positions), order=1)
        return Smooth(found[..., :3], found[..., 3:6], found[..., 6:])


class Smooth(NamedTuple):
    """What is smooth of `Bands`, at some positions: (..., 3) arrays, and (..., 1) variances."""

    low: _Samples
    lacking: _Samples
    variance: _Samples


class CarriedDetail:
    """The bands of both images and the motion between them.

    Parameters
    ----------
    ends : (source, target)
        Opaque pictures. If particles have labels, they have one for each pixel of these.
    particles : Particles
        The particles of their plan.
    canvases : three of Canvas
        At t = 0, 1/2 and 1.
    shown : (source's, target's)
        What the particles show at t = 0 and t = 1 on the coarse canvas, drawn with `band_width`:
        (h, w, 3) arrays in the space of the path.
    operations : Operations, optional
        The backend that samples the details of large frames; NumPy by default.
    """

    def __init__(
        self,
        ends: tuple[End, End],
        particles: Particles,
        canvases: tuple[Canvas, Canvas, Canvas],
        shown: tuple[Array, Array],
        operations: Operations | None = None,
    ) -> None:
        start, middle, end = canvases
        colors = [picture.colors for picture in ends]
        first, second = (to_space(image, "oklab")[..., 0] for image in colors)
        #: The motion of each label, and where its pixels are in both images.
        self._layers: list[_Layer] = []
        for part, masks in _labeled(particles, ends):
            displacement, grid = mean_displacement(part, middle)
            # What surrounds a small label would decide its registration.
            large = masks is None or min(float(mask.mean()) for mask in masks) >= REGISTERED
            motion = Halfway(displacement, grid)
            if large:
                motion = register((first, second), (start, end), displacement, grid)
            self._layers.append(_Layer(motion, masks))
        self._bands = [
            Bands.of(to_space(image, particles.path_space), canvas, low)
            for image, canvas, low in zip(colors, (start, end), shown, strict=True)
        ]

        #: The backend that samples large frames, and the splines that it holds.
        self._large = operations or NumPyOperations()
        self._on_device: list[Any] = []

        white = [float(np.max(to_space(np.ones(3), s))) for s in (particles.path_space, "oklab")]
        #: The unit of the path's color space, where that of Oklab is 1.
        self._unit = white[0] / white[1]

    def kernel_width(self, t: float, canvas: Canvas) -> float:
        """Return the kernel width with which particles are drawn at time t on the coarse canvas.

        Parameters
        ----------
        t : float
        canvas : Canvas
            The canvas at t.

        Returns
        -------
        float
            In pixels of the coarse canvas.
        """
        start, end = (band_width(bands.canvas.shape) for bands in self._bands)
        shrink = max(coarse_canvas(canvas).shape) / max(canvas.shape)
        return ((1 - t) * start + t * end) * shrink

    def frame(self, t: float, canvas: Canvas, colors: Array) -> Array:
        """Return a frame in the space of the path: (H, W, 3) array.

        Parameters
        ----------
        t : float
        canvas : Canvas
            The canvas at t.
        colors : (h, w, 3) array
            What the particles show on the coarse canvas, drawn with `kernel_width`.
        """
        if len(self._layers) == 1:
            return self._along(self._displacement(self._layers[0], t, canvas), t, canvas, colors)
        whole, weights = np.zeros((*canvas.shape, 3)), np.zeros((*canvas.shape, 1))
        for layer in self._layers:
            displacement = self._displacement(layer, t, canvas)
            weight = self._weight(layer, t, canvas, displacement)
            rows = np.flatnonzero(weight.any(axis=(1, 2)))
            if len(rows):
                part = slice(int(rows[0]), int(rows[-1]) + 1)
                whole[part] += weight[part] * self._along(displacement, t, canvas, colors, part)
                weights += weight
        # Where no label arrives, particles alone are seen.
        bare = np.maximum(0.0, 1.0 - weights)
        shown = enlarged(colors, canvas.shape) if bare.any() else 0.0
        return np.asarray((whole + bare * shown) / (weights + bare), dtype=np.float64)

    def _displacement(self, layer: "_Layer", t: float, canvas: Canvas) -> Array:
        """Return the displacement at a frame's places; it is smooth, so a coarse grid is enough."""
        grid = canvas.reduced(max(layer.motion.displacement.shape))
        return layer.motion.at(t, grid.positions())

    def _weight(self, layer: "_Layer", t: float, canvas: Canvas, displacement: Array) -> Array:
        """Return how much of a label is at each point of a frame: (H, W, 1) array."""
        assert layer.masks is not None  # there are several layers
        positions, motion = canvas.positions(), enlarged(displacement, canvas.shape)
        first, second = (
            sampled(mask, bands.canvas.places(positions + share_of_path * motion), order=1)
            for mask, bands, share_of_path in zip(
                layer.masks, self._bands, (-t, 1 - t), strict=True
            )
        )
        return np.asarray((1 - t) * first + t * second)

    def _along(
        self,
        displacement: Array,
        t: float,
        canvas: Canvas,
        colors: Array,
        part: slice = ALL_ROWS,
    ) -> Array:
        """Return some rows of a frame along one motion, all by default: (rows, W, 3) array."""
        coarse = coarse_canvas(canvas)
        # Local deviations at the border of the part depend on what is beside it.
        first, last, _ = part.indices(canvas.shape[0])
        beside = math.ceil(4 * self.kernel_width(t, canvas) * canvas.shape[0] / coarse.shape[0])
        wider = slice(max(0, first - beside), last + beside)
        details = self._details(t, canvas, displacement, _strips(canvas, wider))
        places, motion = coarse.positions(), enlarged(displacement, coarse.shape)
        a = self._bands[0].smooth_at(places - t * motion)
        b = self._bands[1].smooth_at(places + (1 - t) * motion)
        floor = FLOOR * self._unit**2
        strong_a = (1 - t) * np.sqrt(a.variance + floor)
        strong_b = t * np.sqrt(b.variance + floor)
        k = strong_b / (strong_a + strong_b)
        product = np.einsum("ijk,ijk->ij", *details)[..., None]
        together = _mean_around(reduced(product, coarse.shape), self.kernel_width(t, canvas))
        found = (1 - k) ** 2 * a.variance + k**2 * b.variance + 2 * k * (1 - k) * together
        wanted = CRISPNESS * (strong_a + strong_b)
        gain = np.minimum(1.0, wanted / np.sqrt(np.maximum(found, 0.0) + floor))
        differ = ((a.low - b.low) ** 2).sum(axis=-1)[..., None]
        agree = np.exp(-differ / (AGREEMENT * self._unit) ** 2)
        shown = colors + share(t) * ((1 - t) * a.lacking + t * b.lacking)
        low = (1 - agree) * shown + agree * ((1 - t) * a.low + t * b.low)
        smooth = np.dstack((low, gain * (1 - k), gain * k))
        picture = np.empty((*canvas.shape, 3))

        def mix(rows: slice) -> None:
            here = enlarged(smooth, canvas.shape, rows.start, rows.stop)
            picture[rows] = here[..., :3]
            picture[rows] += here[..., 3:4] * details[0][rows]
            picture[rows] += here[..., 4:] * details[1][rows]

        for _ in in_order(mix, _strips(canvas, part)):
            pass
        return picture[part]

    def _details(
        self, t: float, canvas: Canvas, displacement: Array, strips: list[slice]
    ) -> tuple[_Samples, _Samples]:
        """Return the details of both images where the motion has brought them at time t.

        Rows outside of the strips are zero.
        """
        found = np.zeros((2, *canvas.shape, 3), np.float32)
        backend, splines = self._sampler(canvas)
        motions = [
            bands.motion(canvas, share_of_path * displacement)
            for bands, share_of_path in zip(self._bands, (-t, 1 - t), strict=True)
        ]

        def sample(rows: slice) -> None:
            for out, spline, motion in zip(found, splines, motions, strict=True):
                out[rows] = backend.sample_spline(spline, motion, rows.start, rows.stop)

        for _ in in_order(sample, strips):
            pass
        return found[0], found[1]

    def _sampler(self, canvas: Canvas) -> tuple[Operations, list[Any]]:
        """Return the backend that samples details for a canvas, and the splines that it holds."""
        details = [bands.detail for bands in self._bands]
        if math.prod(canvas.shape) < MANY_PIXELS:
            backend = NumPyOperations()
            return backend, [backend.upload_spline(detail) for detail in details]
        if not self._on_device:
            self._on_device = [self._large.upload_spline(detail) for detail in details]
        return self._large, self._on_device


def _strips(canvas: Canvas, part: slice) -> list[slice]:
    """Return rows of a canvas in some strips, which threads compute at the same time."""
    first, last, _ = part.indices(canvas.shape[0])
    rows = max(1, min(-(-(last - first) // 4), STRIP_PIXELS // canvas.shape[1]))
    return [slice(row, min(row + rows, last)) for row in range(first, last, rows)]


class _Layer(NamedTuple):
    """The motion of one label, and its pixels in both images, or None for all: (H, W, 1) arrays."""

    motion: Halfway
    masks: tuple[Array, Array] | None


def labels_to_carry(particles: Particles) -> NDArray[np.int64]:
    """Return the labels of particles; none if they have none."""
    labels = particles.labels
    return np.zeros(0, np.int64) if labels is None else np.union1d(*labels)


def _labeled(
    particles: Particles, ends: tuple[End, End]
) -> list[tuple[Particles, tuple[Array, Array] | None]]:
    """Return the particles of each label, and its pixels in both images; or all particles."""
    labels, names = particles.labels, labels_to_carry(particles)
    if labels is None or len(names) < 2:
        return [(particles, None)]
    # A particle starts or ends at a pixel of an image, or both; the rows of its label come first.
    rows = np.concatenate(labels)
    links = particles.links.astype(np.int64)
    known = np.where(links[:, 0] < len(rows), links[:, 0], links[:, 1])
    own = rows[known]
    found: list[tuple[Particles, tuple[Array, Array] | None]] = []
    for name in names:
        mine = own == name
        masks = [
            (each == name).astype(float).reshape(*end.shape, 1)
            for each, end in zip(labels, ends, strict=True)
        ]
        part = replace(particles, links=particles.links[mine], weights=particles.weights[mine])
        found.append((part, (masks[0], masks[1])))
    return found


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
