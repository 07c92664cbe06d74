"""The baseline that the paper argues against (1, 4.1): each channel transported by itself in 2D.

Red, green and blue are three independent distributions of light over the image plane. A frame is
the sum of their light, so colors that neither image has appear where the channels move differently.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clmorph._shared.options import among, specifications
from clmorph._shared.typing import Array
from clmorph._shared.validation import check_number
from clmorph.backends.interface import Operations
from clmorph.backends.select import Backend, get_backend
from clmorph.frames.canvas import Canvas, canvas_at
from clmorph.frames.kernel_width import KernelWidth, effective_count
from clmorph.frames.options import WIDTH
from clmorph.frames.particles import particles
from clmorph.frames.render import CUT, kernel_sum
from clmorph.images.pixels import as_rgb
from clmorph.measures.lift import lift
from clmorph.pipeline.documentation import documented
from clmorph.pipeline.keywords import MorphKeywords
from clmorph.pipeline.options import PAPER, MorphOptions
from clmorph.transport.options import SolverOptions
from clmorph.transport.plan_building import transport_plan
from clmorph.transport.sinkhorn import sinkhorn

#: The options of `channel_morph`.
CHANNEL_OPTIONS = (
    *specifications(SolverOptions), "sigma_start", "sigma_end", "gamma", "extent", "n_frames",
)  # fmt: skip
#: Light that is added to every pixel, even a black one, so that no channel is empty.
DARKEST = 1e-6


@dataclass(frozen=True)
class ChannelMorph:
    """Three transports, one for each channel, with the frame methods of `clmorph.Morph`.

    Attributes
    ----------
    shapes : ((H, W), (H, W))
        Shapes of source and target.
    times : (n_frames,) array
    channels : three of (uploaded particles, kernel width, light at both ends)
    operations : Operations
    extent : {"true", "unit"}
    """

    shapes: tuple[tuple[int, int], tuple[int, int]]
    times: Array
    channels: list[tuple[Any, KernelWidth, tuple[float, float]]]
    operations: Operations
    extent: str

    def frame(self, t: float) -> NDArray[np.float32]:
        """Render the frame at time t: (H(t), W(t), 3) array, sRGB in [0, 1]."""
        t = check_number("t", t, 0.0, 1.0)
        canvas = canvas_at(t, *self.shapes, self.extent)
        pixels = canvas.shape[0] * canvas.shape[1]
        frame = np.empty((*canvas.shape, 3))
        for channel, (moving, width, (start, end)) in enumerate(self.channels):
            sigma = width.at(t, canvas)
            splats = self.operations.advect(moving, t, canvas.scale, canvas.center)
            _, density = self.operations.splat(splats, canvas.shape, sigma, CUT * sigma)
            light = (1 - t) * start + t * end
            frame[..., channel] = light * pixels * density / _border_share(canvas, sigma)
        return np.clip(frame, 0.0, 1.0).astype(np.float32)

    def iter_frames(self) -> Iterator[NDArray[np.float32]]:
        """Render the frames one by one, without keeping them."""
        return (self.frame(t) for t in self.times)

    @cached_property
    def frames(self) -> list[NDArray[np.float32]]:
        """All frames at `times`."""
        return list(self.iter_frames())


@documented(MorphOptions, CHANNEL_OPTIONS, PAPER)
def channel_morph(
    image_a: ArrayLike,
    image_b: ArrayLike,
    *,
    backend: Backend = "auto",
    **given: Unpack[MorphKeywords],
) -> ChannelMorph:
    """Morph each color channel by itself, by transport in the image plane.

    Parameters
    ----------
    image_a, image_b : arrays
        See `clmorph.images.pixels.as_rgb`. A channel's mass is its light. The mass is scaled to 1
        for the transport, so that balanced transport works for channels of any brightness; the
        total light of the frames changes linearly with time.
    backend : str, object of pyopencl, or Operations
        See `clmorph.get_backend`.
    {options}

    Returns
    -------
    ChannelMorph

    Raises
    ------
    InputError
        If an argument cannot be used.

    Examples
    --------
    >>> import clmorph
    >>> import numpy as np
    >>> left, right = np.zeros((2, 6, 6, 3))
    >>> left[:, :3] = right[:, 3:] = 1.0
    >>> from clmorph.analysis.channel_baseline import channel_morph
    >>> baseline = channel_morph(left, right, n_frames=4, backend="numpy")
    >>> len(baseline.channels), len(baseline.frames)
    (3, 4)
    """
    options = PAPER.replace(**among(given, CHANNEL_OPTIONS))
    start, end, gamma = (
        WIDTH.check("sigma_start", options.sigma_start),
        WIDTH.check("sigma_end", options.sigma_end),
        options.gamma or 0.0,
    )
    operations = get_backend(backend)
    pictures = as_rgb(image_a, "image_a"), as_rgb(image_b, "image_b")
    channels = []
    for channel in range(3):
        light = [np.maximum(picture[..., channel], DARKEST) for picture in pictures]
        source, target = (
            lift(picture, 0.0, weights=values / values.sum(), extent=options.extent)
            for picture, values in zip(pictures, light, strict=True)
        )
        potentials = sinkhorn(source, target, backend=operations, **options.of(SolverOptions))
        plan = transport_plan(source, target, potentials, backend=operations)
        moving = particles(source, target, plan)
        width = KernelWidth(
            start, end, gamma,
            effective_count(source.weights), effective_count(target.weights),
        )  # fmt: skip
        uploaded = operations.upload_particles(moving.table, moving.links, moving.weights)
        channels.append((uploaded, width, (float(light[0].mean()), float(light[1].mean()))))
    shapes = [(picture.shape[0], picture.shape[1]) for picture in pictures]
    return ChannelMorph(
        (shapes[0], shapes[1]),
        np.linspace(0.0, 1.0, options.n_frames),
        channels,
        operations,
        options.extent,
    )


def _border_share(canvas: Canvas, sigma: float) -> Array:
    """Return the kernel mass on each pixel of a uniform spread over the canvas: (H, W) array."""
    if sigma == 0:
        return np.full(canvas.shape, kernel_sum(sigma))
    pixels = [np.arange(side) for side in canvas.shape]
    down, along = (np.exp(-0.5 * ((p - p[:, None]) / sigma) ** 2).sum(axis=1) for p in pixels)
    return np.asarray(down[:, None] * along)
