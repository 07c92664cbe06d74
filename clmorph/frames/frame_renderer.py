"""Render the frames of one morph: colors, opacity, and exact ends."""

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clmorph.backends.interface import Operations
from clmorph.frames.canvas import Canvas, canvas_at
from clmorph.frames.cells import Cells, cells_of_plan
from clmorph.frames.endpoints import (
    EndCorrection,
    Lacking,
    brief_share,
    ladder,
    make_details,
    share,
)
from clmorph.frames.ends import ends_of
from clmorph.frames.kernel_width import KernelWidth
from clmorph.frames.layers import Layers
from clmorph.frames.opacity import alpha_particles, opacity
from clmorph.frames.particles import Particles, with_ground
from clmorph.frames.render import Sums, Widths, render
from clmorph.frames.sprites import Sprites
from clmorph.images.color import from_space, to_space
from clmorph.measures.measure import Measure
from clmorph.transport.barycentric import Barycentric
from clmorph.transport.plan import Plan

#: Blocks along the longer side of a mosaic.
MOSAIC = 32
#: The opacity below which a pixel is invisible in 8 bits.
UNSEEN = 1 / 1024


class FrameRenderer:
    """Renders a morph at any time, and keeps the data that its frames share.

    Particles are uploaded to the device, and the correction of the ends is computed, when the first
    frame needs them. `pictures`, (H, W, 3) each, are what frames show at both ends if it has more
    pixels than the measures: opaque images, for layers and cells alone.
    """

    def __init__(
        self,
        source: Measure,
        target: Measure,
        plan: Plan | Barycentric,
        particles: Particles,
        kernel_width: KernelWidth,
        operations: Operations,
        endpoints: str,
        unmatched: str,
        detail: str,
        pictures: Sequence[NDArray[np.floating]] | None = None,
    ) -> None:
        #: The renderer on another device, whose data on the host this one uses.
        self._like: FrameRenderer | None = None
        self._measures, self._plan, self._given = (source, target), plan, particles
        opaque = source.alpha is None and target.alpha is None
        if detail == "particles" and endpoints == "exact" and opaque:
            particles = with_ground(particles, source, target)
        self._particles = particles
        self._kernel_width, self._operations = kernel_width, operations
        self._endpoints, self._unmatched, self._detail = endpoints, unmatched, detail
        self._pictures, self._ends = pictures, ends_of((source, target), pictures)
        #: Time and opacity of the frame that was rendered last.
        self._last_opacity: tuple[float, NDArray[np.float64]] | None = None

    @property
    def operations(self) -> Operations:
        """The backend that renders the frames."""
        return self._operations

    @property
    def detail(self) -> str:
        """What draws the frames, see `clmorph.frames.options.Detail`."""
        return self._detail

    def on(self, operations: Operations, like: "FrameRenderer | None" = None) -> "FrameRenderer":
        """Return a renderer of the same morph on another device.

        The correction of the ends and the motion of the details come from `like`, or from itself.
        """
        other = FrameRenderer(
            *self._measures, self._plan, self._given, self._kernel_width, operations,
            self._endpoints, self._unmatched, self._detail, self._pictures,
        )  # fmt: skip
        other._like = like
        return other

    def prepare(self) -> None:
        """Compute what all frames share, which otherwise the first frame does."""
        _ = self._correction, self.layers, self._cells, self._sprites

    def canvas(self, t: float) -> Canvas:
        """Return the canvas at time t."""
        source, target = self._ends
        return canvas_at(t, source.shape, target.shape, source.extent)

    def frame(self, t: float) -> NDArray[np.floating]:
        """Render the frame at time t: (H, W, 3) or, with opacity, (H, W, 4) array."""
        if t in (0.0, 1.0) and self.layers is not None and self.layers.exact:
            return self._ends[int(t)].colors
        picture = self._picture(t, self._correction)
        if self._correction is not None:
            self._correction.correct(picture, t)
        return picture

    def sums(self, t: float, widths: Widths | None = None, canvas: Canvas | None = None) -> Sums:
        """Render colors, coverage and density without the correction of the ends.

        `widths` and `canvas` replace those of the morph at time t.
        """
        canvas = canvas or self.canvas(t)
        widths = widths or self._kernel_width.widths(t, canvas)
        # Holes are not filled where the frame is invisible.
        fill = True if self._alpha_particles is None else self._opacity(t) > UNSEEN
        mass = self._particles.mass(t)
        return render(self._operations, self._uploaded, mass, t, canvas, widths, fill=fill)

    @cached_property
    def _uploaded(self) -> Any:
        return self._upload(self._particles)

    @cached_property
    def _alpha_particles(self) -> Particles | None:
        return alpha_particles(*self._measures, self._plan, self._particles)

    @cached_property
    def _uploaded_alpha(self) -> Any:
        assert self._alpha_particles is not None  # the caller has checked it
        return self._upload(self._alpha_particles)

    def _upload(self, particles: Particles) -> Any:
        return self._operations.upload_particles(
            particles.table, particles.links, particles.weights
        )

    def _opacity(self, t: float) -> NDArray[np.float64]:
        """Return the opacity of the frame at t, without correction of the ends: (H, W) array."""
        last = self._last_opacity
        if last is not None and last[0] == t:
            return last[1]
        assert self._alpha_particles is not None
        area, canvas = self._alpha_particles.mass(t), self.canvas(t)
        sums = render(
            self._operations, self._uploaded_alpha, area, t, canvas,
            self._kernel_width.widths(t, canvas), fill=False,
        )  # fmt: skip
        opaque = opacity(sums, area, t)
        self._last_opacity = t, opaque
        return opaque

    def _picture(self, t: float, correction: EndCorrection | None) -> NDArray[np.floating]:
        """Return colors and, if there is one, opacity, before the resting correction is added."""
        canvas = self.canvas(t)
        if self.layers is not None:
            return self.layers.frame(t, canvas)
        if self._cells is not None:
            shown = self._cells.frame(t, canvas)
            colors = from_space(shown[..., :3], self._particles.path_space)
            return np.clip(np.dstack((colors, shown[..., 3:])), 0.0, 1.0)
        if self._sprites is not None:
            return self._sprites.frame(t, canvas)
        colors = self.sums(t).colors
        if correction is not None:
            colors = colors + correction.moving(t, canvas, self._kernel_width.at(t, canvas))
        picture = from_space(colors, self._particles.path_space)
        if self._alpha_particles is None:
            return picture
        return np.dstack((picture, self._opacity(t)))

    @cached_property
    def layers(self) -> Layers | None:
        """The layers of both pictures; None if particles draw the frames."""
        if self._detail != "layers":
            return None
        if self._like is not None:
            layers = self._like.layers
            return None if layers is None else layers.on(self._operations)
        return Layers(
            self._ends, self._measures, self._particles, (self.canvas(0.0), self.canvas(1.0)),
            self._operations,
        )  # fmt: skip

    @cached_property
    def _sprites(self) -> Sprites | None:
        """The parts of sprites, whole pixels of which move; None if something else is drawn."""
        if self._detail != "pixels":
            return None
        if self._like is not None:
            sprites = self._like._sprites
            return None if sprites is None else sprites.on(self._operations)
        return Sprites(self._measures, self._particles, self._operations)

    @cached_property
    def _cells(self) -> Cells | None:
        """The moving cells of both pictures; None if something else is drawn."""
        if self._detail != "cells":
            return None
        if self._like is not None:
            cells = self._like._cells
            return None if cells is None else cells.on(self._operations)
        space = self._particles.path_space
        pictures = []
        for end in self._ends:
            opacity = [] if end.alpha is None else [end.alpha[..., None]]
            pictures.append(np.dstack((to_space(end.colors, space), *opacity)))
        paths = cells_of_plan(*self._measures, self._plan, MOSAIC)
        return Cells(paths, pictures, [self.canvas(0.0), self.canvas(1.0)], self._operations)

    @cached_property
    def _correction(self) -> EndCorrection | None:
        """The correction of both ends; None if the frames there stay as the kernel draws them."""
        if self._endpoints == "paper":
            return None
        if self._like is not None:
            correction = self._like._correction
            return None if correction is None else correction.on(self._operations)
        if self.layers is not None and self.layers.exact:
            return None
        layered = any((self.layers, self._cells, self._sprites))
        correction = EndCorrection((None, None), brief_share if layered else share)
        if not layered:
            lacking = self._lacking(0.0), self._lacking(1.0)
            correction = EndCorrection(
                make_details(self._operations, self._measures, self._plan, lacking, self._unmatched)
            )
        for number, end in enumerate(self._ends):
            picture = self._picture(float(number), correction)
            rest = end.colors - picture[..., :3]
            if picture.shape[2] == 4:
                alpha = np.ones(end.shape) if end.alpha is None else end.alpha
                rest = np.dstack((np.where(alpha[..., None] > 0, rest, 0.0), alpha))
                rest[..., 3] -= picture[..., 3]
            correction.set_rest(number, rest)
        return correction

    def _lacking(self, end: float) -> Lacking:
        """Return image less frame at t = 0 or 1, for the kernel widths near that end."""
        times = np.linspace(end, 0.5, 9)
        widths = ladder(np.array([self._kernel_width.at(t, self.canvas(t)) for t in times]))
        measure = self._measures[round(end)]
        wanted = to_space(measure.colors, self._particles.path_space).reshape(*measure.shape, 3)
        own = self._kernel_width.widths(end, self.canvas(end))
        frames = [self.sums(end, own._replace(sigma=width)).colors for width in widths]
        return Lacking(widths, wanted - np.array(frames))
