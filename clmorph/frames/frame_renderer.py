"""Render the frames of one morph, on one device or several: colors, opacity, and exact ends."""

from collections.abc import Generator, Sequence
from copy import copy
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.typing import Array
from clmorph.backends.interface import Operations
from clmorph.backends.multi_device import members_of, turns
from clmorph.backends.threads import results_in_order
from clmorph.frames.canvas import Canvas, canvas_at
from clmorph.frames.cells import Cells, cells_of_plan
from clmorph.frames.endpoints import EndCorrection, Lacking, brief_share, ladder, make_details
from clmorph.frames.ends import ends_of
from clmorph.frames.growth import take_after
from clmorph.frames.kernel_width import KernelWidth
from clmorph.frames.layers import Layers
from clmorph.frames.particles import Particles, with_ground
from clmorph.frames.render import Sums, Widths, render
from clmorph.frames.sprites import Sprites
from clmorph.images.color import from_space, to_space
from clmorph.measures.measure import Measure
from clmorph.transport.barycentric import Barycentric
from clmorph.transport.plan import Plan

#: Blocks along the longer side of a mosaic.
MOSAIC = 32
#: The share to which coverage may fall at t = 1/2 before opacity falls: particles never spread
#: uniformly, and this alone must not be visible.
THINNEST = 0.5
#: Cracks up to twice this share of the canvas's longer side are closed: where particles part, the
#: background would show as scratches.
CRACK = 0.015
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
        self._measures, self._plan = (source, target), plan
        opaque = source.alpha is None and target.alpha is None
        if detail == "particles" and endpoints == "exact" and opaque:
            particles = with_ground(particles, source, target)
        self._particles = particles
        self._kernel_width, self._endpoints, self._unmatched = kernel_width, endpoints, unmatched
        #: The backend that renders the frames, and what draws them, see `options.Detail`.
        self.operations, self.detail = operations, detail
        self._ends = ends_of((source, target), pictures)
        #: Time and opacity of the frame that was rendered last.
        self._last_opacity: tuple[float, Array] | None = None

    def on(self, operations: Operations, like: "FrameRenderer | None" = None) -> "FrameRenderer":
        """Return this renderer, which has drawn nothing yet, for another device.

        The correction of the ends and the motion of the details come from `like`, or from itself.
        """
        assert not {"_correction", "_moving"} & vars(self).keys(), "its data are of one device"
        other = copy(self)
        other.operations, other._like = operations, like
        return other

    def prepare(self) -> None:
        """Compute what all frames share, which otherwise the first frame does."""
        _ = self._correction, self._moving

    def canvas(self, t: float) -> Canvas:
        """Return the canvas at time t."""
        source, target = self._ends
        return canvas_at(t, source.shape, target.shape, source.extent)

    def frame(self, t: float) -> NDArray[np.floating]:
        """Render the frame at time t: (H, W, 3) or, with opacity, (H, W, 4) array."""
        if t in (0.0, 1.0) and self._is_exact:
            return self._ends[int(t)].colors
        picture = self._picture(t, self._correction)
        if self._correction is not None:
            self._correction.correct(picture, t)
        return picture

    def sums(self, t: float, widths: Widths | None = None) -> Sums:
        """Render colors, coverage and density without the correction of the ends."""
        canvas = self.canvas(t)
        widths = widths or self._kernel_width.widths(t, canvas)
        # Holes are not filled where the frame is invisible.
        fill = True if self._alpha_particles is None else self._opacity(t) > UNSEEN
        mass = self._particles.mass(t)
        return render(self.operations, self._uploaded[0], mass, t, canvas, widths, fill=fill)

    @cached_property
    def _alpha_particles(self) -> Particles | None:
        return alpha_particles(*self._measures, self._plan, self._particles)

    @cached_property
    def _uploaded(self) -> list[Any]:
        """Handles of the particles and, if there is opacity, of those of areas and opacity."""
        return [
            self.operations.upload_particles(each.table, each.links, each.weights)
            for each in (self._particles, self._alpha_particles)
            if each is not None
        ]

    def _opacity(self, t: float) -> Array:
        """Return the opacity of the frame at t, without correction of the ends: (H, W) array."""
        last = self._last_opacity
        if last is not None and last[0] == t:
            return last[1]
        assert self._alpha_particles is not None
        area, canvas = self._alpha_particles.mass(t), self.canvas(t)
        sums = render(
            self.operations, self._uploaded[1], area, t, canvas,
            self._kernel_width.widths(t, canvas), fill=False,
        )  # fmt: skip
        opaque = opacity(sums, area, t)
        self._last_opacity = t, opaque
        return opaque

    def _picture(self, t: float, correction: EndCorrection | None) -> NDArray[np.floating]:
        """Return colors and, if there is one, opacity, before the resting correction is added."""
        canvas = self.canvas(t)
        if self._moving is not None:
            shown = self._moving.frame(t, canvas)
            if not isinstance(self._moving, Cells):
                return shown
            colors = from_space(shown[..., :3], self._particles.path_space)
            return np.clip(np.dstack((colors, shown[..., 3:])), 0.0, 1.0)
        colors = self.sums(t).colors
        if correction is not None:
            width = self._kernel_width.at(t, canvas)
            colors = colors + correction.moving(t, canvas, width, self.operations)
        picture = from_space(colors, self._particles.path_space)
        if self._alpha_particles is None:
            return picture
        return np.dstack((picture, self._opacity(t)))

    @cached_property
    def _moving(self) -> Layers | Cells | Sprites | None:
        """What moves and is drawn in place of the particles; None if these are."""
        if self._like is not None:
            moving = self._like._moving
            return None if moving is None else moving.on(self.operations)
        if self.detail == "layers":
            return Layers(self._ends, self._measures, self._particles, self.operations)
        if self.detail == "pixels":
            return Sprites(self._measures, self._particles, self.operations)
        if self.detail == "cells":
            space = self._particles.path_space
            pictures = [
                np.dstack(
                    (to_space(end.colors, space), *([] if end.alpha is None else [end.alpha]))
                )
                for end in self._ends
            ]
            paths = cells_of_plan(*self._measures, self._plan, MOSAIC)
            canvases = [end.canvas for end in self._ends]
            return Cells(paths, pictures, canvases, self.operations)
        return None

    @property
    def layers(self) -> Layers | None:
        """The layers of both pictures; None if something else draws the frames."""
        return self._moving if isinstance(self._moving, Layers) else None

    @property
    def _is_exact(self) -> bool:
        """Whether the first and the last frame are the pictures, without a correction."""
        return self.layers is not None and self.layers.exact

    @cached_property
    def _correction(self) -> EndCorrection | None:
        """The correction of both ends; None if the frames there stay as the kernel draws them."""
        if self._endpoints == "paper":
            return None
        if self._like is not None:
            return self._like._correction
        if self._is_exact:
            return None
        if self._moving is None:
            lacking = self._lacking(0.0), self._lacking(1.0)
            correction = EndCorrection(
                make_details(self._measures, self._plan, lacking, self._unmatched)
            )
        else:
            correction = EndCorrection((None, None), brief_share)
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


class SpreadRenderer:
    """Renders a morph by the devices of a backend, as `FrameRenderer` does by one device.

    The number of a frame and the devices' speeds decide which device renders it, so that frames
    repeat to the bit. A frame at another time is rendered by the first device, which also computes
    the correction of the ends that all devices use.
    """

    def __init__(self, renderer: FrameRenderer, times: Array) -> None:
        first, *others = members_of(renderer.operations)
        self._first = renderer if not others else renderer.on(first)
        self._renderers = [self._first, *(renderer.on(each, self._first) for each in others)]
        self._times, self.detail = times, renderer.detail
        self._turns = turns(renderer.operations, len(times))
        self._turn_at = {float(t): turn for t, turn in zip(times, self._turns, strict=True)}

    def canvas(self, t: float) -> Canvas:
        """Return the canvas at time t."""
        return self._first.canvas(t)

    def _at(self, t: float) -> FrameRenderer:
        turn = self._turn_at.get(t)
        return self._first if turn is None else self._renderers[turn]

    def frame(self, t: float) -> NDArray[np.floating]:
        """Render the frame at time t; see `FrameRenderer.frame`."""
        return self._at(t).frame(t)

    def sums(self, t: float, widths: Widths | None = None) -> Sums:
        """Render colors, coverage and density at time t; see `FrameRenderer.sums`."""
        return self._at(t).sums(t, widths)

    @property
    def layers(self) -> Layers | None:
        """The layers of both pictures; None if something else draws the frames."""
        return self._first.layers

    @property
    def at_once(self) -> bool:
        """Whether frames are rendered at the same time, by several devices."""
        return len(self._renderers) > 1

    def frames(self, first: int) -> Generator[NDArray[np.float32], None, None]:
        """Render frames, as many at once as there are devices, and yield them from `first` on.

        At most two frames of each device are in memory, beside the one that the caller has.
        """
        # The correction of the ends is computed before the threads start, and so only once.
        self._first.prepare()

        def frame(turn: int, number: int) -> NDArray[np.float32]:
            t = float(self._times[first + number])
            return self._renderers[turn].frame(t).astype(np.float32, copy=False)

        yield from results_in_order(self._turns[first:], frame)


def alpha_particles(
    source: Measure, target: Measure, plan: Plan | Barycentric, moving: Particles
) -> Particles | None:
    """Return area and opacity of the plan's particles, as particles; None if all is opaque.

    They are particles on the same paths, and resting particles at opaque pixels without mass. Their
    masses are areas, whose sum is at most 1 at both ends, and their first color is opacity.
    """
    if source.alpha is None and target.alpha is None:
        return None
    n = len(source)
    alphas = [
        np.ones(len(measure)) if measure.alpha is None else measure.alpha
        for measure in (source, target)
    ]
    # A particle covers the same share of its pixel's area as it has of its mass.
    per_mass = [
        np.divide(1.0 / len(m), m.weights, out=np.zeros(len(m)), where=m.weights > 0)
        for m in (source, target)
    ]
    if isinstance(plan, Barycentric):
        arriving = plan.column_mass / max(float(plan.column_mass.sum()), np.finfo(float).tiny)
        for ends in (alphas, per_mass):
            ends[1] = np.concatenate((ends[1], np.full(len(plan), ends[1] @ arriving)))
    table = moving.table.copy()
    table[:, 2:5] = 0.0
    known = len(table) - moving.n_grown
    table[:known, 2] = np.concatenate(alphas)
    links = moving.links.astype(np.int64)
    # Mass that grows or shrinks has the opacity of its own pixel all the way.
    take_after(table[:, 2], links, known)
    areas = np.zeros_like(moving.weights)
    # No other particle starts at the target or ends at the source than those that die or are born.
    starts, stops = links[:, 0] < n, (links[:, 1] >= n) & (links[:, 1] < known)
    areas[starts, 0] = moving.weights[starts, 0] * per_mass[0][links[starts, 0]]
    areas[stops, 1] = moving.weights[stops, 1] * per_mass[1][links[stops, 1] - n]
    for end, measure in enumerate((source, target)):
        weightless = np.flatnonzero((measure.weights == 0) & (alphas[end][: len(measure)] > 0))
        place = weightless + end * n
        links = np.concatenate((links, np.column_stack((place, place))))
        fading = np.zeros((len(place), 2))
        fading[:, end] = 1.0 / len(measure)
        areas = np.concatenate((areas, fading))
    return Particles(table, links.astype(np.uint32), areas)


def opacity(sums: Sums, area: float, t: float) -> Array:
    """Return the opacity of each pixel, with narrow cracks closed: (H, W) array.

    `sums` is a rendering of `alpha_particles` without filled holes, and `area` their total mass at
    time t.
    """
    enough = 1.0 - 4 * t * (1 - t) * (1.0 - THINNEST)
    covered = np.clip(sums.coverage * area / enough, 0.0, 1.0)
    opaque = np.asarray(np.clip(sums.colors[..., 0], 0.0, 1.0) * covered)
    reach = int(CRACK * max(opaque.shape))
    if reach == 0:
        return opaque
    from scipy.ndimage import grey_closing

    side = 2 * reach + 1
    return np.asarray(grey_closing(opaque, (side, side), mode="nearest"))
