"""The pictures of a film or of mixes, and how a frame is put together from their layers.

Only the lowest band of photographs is drawn partly towards the mean of both. Before a flat or
transparent ground the figures alone move. Their outline at time t is a level of the mean of both
layers' signed distances, (1 - t) of the one and t of the other; the level is that at which the
figure's area goes linearly from the one to the other (`figures`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from functools import partial, reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.threads import in_order
from clmorph._shared.typing import Array
from clmorph.backends.interface import Operations
from clmorph.backends.records import LayerView
from clmorph.frames.canvas import Canvas
from clmorph.frames.ends import End
from clmorph.frames.fields import CELLS, POINTS, Layer, affine, blurred, led_to
from clmorph.frames.figures import Figure, beyond, mixed_ground
from clmorph.frames.outline import FAR, around, bounded, outline_of, thinness
from clmorph.frames.resampling import Enlarged, Float32, reduced
from clmorph.images.color import PART, from_space, to_space

#: How far the lowest band is drawn towards the mean of both layers; its width as a share of the
#: longer side, and the pixels along that side by which it is computed.
MEAN_SHARE, LOW, LOW_PIXELS = 0.3, 1 / 16, 64
#: A layer is sampled from a copy with half the pixels where a frame has a pixel for so many.
CLOSE = 1.5
#: The largest level of distance, in the common frame, that keeps a figure's area.
LEVEL = 0.06
#: Points of the stage by which outlines that have met may differ.
MET = 1.0
#: Points of the stage by which outlines may differ where pictures agree at another time.
NEAR = 2.0
#: Width, as a share of the longer side, over which figures are continued beyond the borders of
#: their pictures, so that distances from outlines go on there.
MARGIN = 1 / 8
#: Pixels along the longer side of a picture by which distances are continued there.
MARGIN_PIXELS = 1024
#: Points of the stage over which a layer stops being seen beyond its own figure.
COVER = 2.0
#: Agreement below this is none: nobody sees the share of a color that it has.
FAINT = 1 / 512
#: Pixels of a large frame or picture that are made at a time.
BAND = 1 << 21


class Channels:
    """A picture of three or four channels, ready to be sampled at any scale.

    `images`, (H, W, C) each, have its channels. With an `edge` the fourth one is the distance from
    an outline of that width: it goes on in a margin, and the others as their border is.
    """

    def __init__(
        self,
        images: Sequence[Float32],
        canvas: Canvas,
        operations: Operations,
        edge: float | None = None,
    ) -> None:
        self.canvas, self._operations, self._edge = canvas, operations, edge
        # Large pictures are needed once: copies with half the pixels are enough for the others.
        half = self._canvas_at(1).shape
        self._levels = {0: self._uploaded(images, canvas)}
        self._half = [reduced(image, half) for image in images]

    def _canvas_at(self, halvings: int) -> Canvas:
        return self.canvas.reduced(max(1, round(max(self.canvas.shape) / 2**halvings)))

    def level(self, halvings: int) -> tuple[Any, Canvas]:
        """Return the picture with fewer pixels, and these."""
        if halvings not in self._levels:
            small = self._canvas_at(halvings)
            self._levels[halvings] = self._uploaded(self._half, small)
        return self._levels[halvings]

    def _uploaded(self, images: Sequence[Float32], small: Canvas) -> tuple[Any, Canvas]:
        from scipy.ndimage import spline_filter

        wide, margin = (small, 0) if self._edge is None else _with_margin(small)
        spline = np.zeros((*wide.shape, 4), np.float32)
        channels = (image[..., c] for image in images for c in range(image.shape[2]))
        for number, channel in enumerate(channels):
            plane = reduced(channel, small.shape)
            if number == 3 and self._edge is not None:
                far = FAR * max(small.shape) / max(*small.scale, 1e-9)
                wider = bounded(_continued(plane, small), self._edge, far)
            else:
                wider = np.pad(plane, margin, mode="edge")
            spline[..., number] = spline_filter(wider, order=3, mode="mirror", output=np.float32)
        return self._operations.upload_spline(spline), wide


def _with_margin(canvas: Canvas) -> tuple[Canvas, int]:
    """Return a canvas with a margin on all sides, and the margin in pixels."""
    margin = round(MARGIN * max(canvas.shape))
    height, width = canvas.shape
    return Canvas((height + 2 * margin, width + 2 * margin), canvas.scale), margin


def _continued(distance: Float32, canvas: Canvas) -> Float32:
    """Continue a signed distance from an outline, on a canvas, by its margin.

    Figures that end within a pixel of the border end there; others go on as they are at the border.
    """
    from scipy.ndimage import distance_transform_edt

    few, (wide, margin) = canvas.reduced(MARGIN_PIXELS), _with_margin(canvas)
    if few.shape != canvas.shape:
        coarse = _continued(reduced(distance, few.shape), few)
        wider = Enlarged(coarse, affine(wide, _with_margin(few)[0]), wide.shape).rows()
        wider[margin:-margin, margin:-margin] = distance
        return wider
    pixel = 1 / max(*canvas.scale, 1e-9)
    goes_on = np.pad(distance > 0.75 * pixel, margin, mode="edge")
    inside = np.pad(distance > 0, margin) | goes_on
    if inside.all() or not inside.any():
        return np.pad(distance, margin, mode="edge")
    wider = np.where(inside, np.float32(-0.5), np.float32(0.5))
    wider += distance_transform_edt(inside)
    wider -= distance_transform_edt(~inside)
    wider *= np.float32(pixel)
    height, width = distance.shape
    wider[margin : margin + height, margin : margin + width] = distance
    return wider


def stage_of(canvases: Sequence[Canvas]) -> Canvas:
    """Return a grid over everything that some canvases show."""
    shapes = np.array([canvas.shape for canvas in canvases], float)
    scales = np.array([canvas.scale[::-1] for canvas in canvases], float)
    extents = np.divide(shapes, scales, out=np.ones_like(shapes), where=scales > 0).max(axis=0)
    longest = max(max(canvas.shape) for canvas in canvases)
    per_unit = min(POINTS, longest) / float(extents.max())
    height, width = (max(1, round(extent * per_unit)) for extent in extents)
    return Canvas((height, width), (per_unit, per_unit))


class Pictures:
    """The pictures of a film or of mixes: what layers sample, and how a frame is put together.

    `figures` stand before their grounds; None if all pixels belong to the pictures. `space` is that
    of the path.
    """

    def __init__(
        self,
        ends: Sequence[End],
        figures: Sequence[Figure] | None,
        space: str,
        operations: Operations,
    ) -> None:
        self._space, self._operations = space, operations
        self.canvases = [end.canvas for end in ends]
        self._ends, self.figures = ends, figures
        self._areas = [figure.area for figure in figures or ()]
        #: How far outlines on the way are smoothed, from 0 to 1: not at all where they coincide.
        self.smoothing = 1.0
        #: Weights of a color's coordinates in its lightness.
        self.lightness = np.array(
            [0.3, 0.59, 0.11] if space in ("srgb", "linear") else [1.0, 0.0, 0.0]
        )
        #: Whether frames have opacity.
        self.clear = any(end.alpha is not None for end in ends)
        self.stage = stage_of(self.canvases)
        self._per_unit = max(*self.stage.scale, 1e-9)
        self._upload()

    def _upload(self) -> None:
        #: Copies with a pixel for each point of a field: the pictures, and those whose figures are
        #: continued; these with a pixel for each cell too.
        self.own: list[Any] = []
        self.continued: list[Any] = []
        self.cells: list[Any] = []
        self._channels: dict[str, list[Channels]] = {}
        for number, canvas in enumerate(self.canvases):
            points, cells = (canvas.reduced(side).shape for side in (POINTS, CELLS))
            own, continued, sampled = self._images(number)
            self.own.append(reduced(own, points))
            self.continued.append(reduced(continued, points))
            self.cells.append(reduced(continued, cells))
            del own, continued
            for name, images in sampled.items():
                edge = None
                if self.figures is not None and name == "figure":
                    edge = self.figures[number].softness / max(*canvas.scale, 1e-9)
                channels = Channels(images, canvas, self._operations, edge)
                self._channels.setdefault(name, []).append(channels)

    def _images(self, number: int) -> tuple[Float32, Float32, dict[str, list[Float32]]]:
        """Return one picture, with its figure continued too, and what is sampled, by name."""
        end = self._ends[number]
        own = _in_space(end.colors, self._space)
        if self.figures is None:
            return own, own, {"own": [own]}
        figure, scale = self.figures[number], max(*self.canvases[number].scale, 1e-9)
        continued = beyond(own, figure.pure)
        sampled = {"figure": [continued, figure.distance[..., None] / np.float32(scale)]}
        if not self.clear:
            return own, continued, sampled | {"own": [own]}
        opacity = np.ones(end.shape) if end.alpha is None else end.alpha
        # Transparent pixels have the colors of the figure beside them.
        own = np.where(opacity[..., None] > 0, own, continued)
        sampled["own"] = [own, opacity[..., None].astype(np.float32)]
        if any(each.translucent for each in self.figures):
            black = np.broadcast_to(np.float32(0), (*figure.alpha.shape, 3))
            sampled["alpha"] = [black, figure.alpha[..., None]]
        return own, continued, sampled

    def on(self, operations: Operations) -> Pictures:
        """Return the same pictures for another device."""
        other = copy(self)
        other._operations = operations
        other._upload()
        return other

    def frame(
        self,
        layers: Sequence[Layer],
        ways: Sequence[float],
        shares: Sequence[float],
        weights: Sequence[Array],
        agreement: Array,
        thin: Array,
        canvas: Canvas,
    ) -> NDArray[np.floating]:
        """Return a frame: (H, W, 3) array of sRGB, or (H, W, 4) with opacity.

        For each picture `layers` has its layer, `ways` the share of its way that it has gone,
        `shares` its share in the frame, and `weights`, (h, w), how much of it is seen at each place
        of the stage; shares and weights have the sum 1. `agreement` and `thin`, (h, w), are how far
        all pictures agree there, and how far figures are but thin lines halfway, from 0 to 1.
        """
        even = [np.full(self.stage.shape, share) for share in shares]
        drawn = partial(self._drawn, layers, ways)
        if self.figures is None:
            coarse = canvas.reduced(LOW_PIXELS)
            apart = drawn("own", [e - w for e, w in zip(even, weights, strict=True)], even, coarse)
            low = MEAN_SHARE * blurred(apart.astype(float), LOW * max(coarse.shape))
            low[..., 3] = 0.0
            return self._shown(drawn("own", weights, even, canvas, low)[..., :3])
        distances = self._distances(layers, ways)
        covered = _where_covered(distances, shares, weights)
        now, fine = thinness(distances)
        thin = thin * now
        fine = np.minimum(thin, fine)
        lines = [each + thin * (weight - each) for each, weight in zip(even, weights, strict=True)]

        def distance_on(on: Canvas) -> Float32:
            found = np.empty(on.shape, np.float32)
            for rows in _bands(on.shape):
                found[rows] = drawn("figure", covered, lines, on, rows=rows)[..., 3]
            return found

        outline = outline_of(
            distance_on, canvas, np.ptp(distances, axis=0) * (1.0 - thin), fine, self.stage,
            halfway=1.0 - float(max(shares)), smoothing=self.smoothing,
            area=float(np.dot(shares, self._areas)),
            softness=float(np.dot(shares, [each.softness for each in self.figures])),
            most=np.inf if any(each.pure.all() for each in self.figures) else LEVEL,
        )  # fmt: skip
        led = layers
        if self.smoothing > 0.0 and max(shares) < 1.0:
            way = affine(self.stage, outline.canvas)
            edge = Enlarged(outline.distance, way, self.stage.shape).rows() * self._per_unit
            led = [
                led_to(layer, own, edge.astype(float), share, self.stage, self._operations)
                for layer, own, share in zip(layers, distances, ways, strict=True)
            ]
        inside = outline.reached(self.stage)
        within = [weight * inside for weight in covered]
        none = [np.zeros(self.stage.shape)] * len(within)
        # What agrees is a warp of both pictures, with the edges that they have.
        meet = np.exp(-((np.ptp(np.clip(distances, -2 * NEAR, 2 * NEAR), axis=0) / NEAR) ** 2))
        # Where the area asks for another outline, the pictures' own ones would be halos.
        meet *= np.exp(-(((outline.level or 0.0) * max(*canvas.scale, 1e-9) / MET) ** 2))
        seen = agreement * meet
        seen = np.where(seen < FAINT, 0.0, seen)
        there = [share * around(seen > 0.0) for share in even]
        translucent = "alpha" in self._channels
        on_canvas = Enlarged(seen.astype(np.float32), affine(canvas, self.stage), canvas.shape)
        lies_inside = outline.on(canvas)
        grounds = [(each.ground, each.ground_alpha) for each in self.figures]
        ground = mixed_ground(shares, grounds, self._space)
        frame = np.empty((*canvas.shape, 4 if self.clear else 3), np.float32)
        for rows in _bands(canvas.shape):
            figure = self._drawn(led, ways, "figure", within, none, canvas, rows=rows)
            own = drawn("own", there, there, canvas, rows=rows) if seen.any() else None
            opacity = (
                drawn("alpha", weights, even, canvas, rows=rows)[..., 3] if translucent else None
            )
            self._put_together(frame, rows, figure, lies_inside, opacity, ground, own, on_canvas)
        return frame

    def _put_together(
        self,
        frame: Float32,
        rows: slice,
        figure: Float32,
        inside: Callable[[slice], Float32],
        opacity: Float32 | None,
        ground: tuple[Array, float],
        own: Float32 | None,
        seen: Enlarged,
    ) -> None:
        """Fill rows of a frame by a figure before its ground, where `seen` by the pictures' own."""
        color, alpha = ground[0].astype(np.float32), np.float32(ground[1])
        behind_all = self._shown(color[None])[0]

        def put(part: slice) -> None:
            here = slice(rows.start + part.start, rows.start + part.stop)
            opaque = np.broadcast_to(inside(here), (part.stop - part.start, frame.shape[1]))
            share = seen.rows(here)
            frame[here, :, :3], frame[here, :, 3:] = behind_all, alpha
            some = np.flatnonzero(((opaque > 0) | (share > 0)).any(axis=0))
            if not len(some):
                return
            # Beside these columns there is but the ground.
            columns = slice(some[0], some[-1] + 1)
            opaque = opaque[:, columns, None]
            if opacity is not None:
                opaque = opaque * np.clip(opacity[part, columns, None], 0, 1)
            behind = (1 - opaque) * alpha
            whole = opaque + behind
            colors = opaque * figure[part, columns, :3] + behind * color
            colors /= np.maximum(whole, 1e-6)
            if own is not None:
                share = share[:, columns, None]
                colors += share * (own[part, columns, :3] - colors)
                if self.clear:
                    whole = whole + share * (own[part, columns, 3:] - whole)
            frame[here, columns, :3] = self._shown(colors)
            if self.clear:
                frame[here, columns, 3:] = np.clip(whole, 0.0, 1.0)

        for _ in in_order(put, _bands((rows.stop - rows.start, frame.shape[1]), PART)):
            pass

    def _distances(self, layers: Sequence[Layer], ways: Sequence[float]) -> list[Array]:
        """Return the signed distance from each layer's outline, in points of the stage."""
        zero, one = np.zeros(self.stage.shape), np.ones(self.stage.shape)
        found = []
        for number in range(len(layers)):
            alone = [one if other == number else zero for other in range(len(layers))]
            none = [zero] * len(layers)
            drawn = self._drawn(layers, ways, "figure", none, alone, self.stage)
            found.append(drawn[..., 3].astype(float) * self._per_unit)
        return found

    def _shown(self, colors: NDArray[np.floating]) -> Array:
        """Return colors of the path as sRGB."""
        return np.clip(from_space(colors, self._space), 0.0, 1.0)

    def _drawn(
        self,
        layers: Sequence[Layer],
        ways: Sequence[float],
        name: str,
        weights: Sequence[Array],
        fourth: Sequence[Array],
        canvas: Canvas,
        low: Array | None = None,
        rows: slice | None = None,
    ) -> Float32:
        """Return the sum of all layers, by weights of their colors and of their fourth channel.

        Where both weights of a layer are 0 it is not sampled.
        """
        views = []
        for layer, channels, way, weight, share in zip(
            layers, self._channels[name], ways, weights, fourth, strict=True
        ):
            step = max(abs(each) for each in affine(canvas, channels.canvas).step)
            halvings = int(max(0.0, np.ceil(np.log2(max(step, 1e-9) / CLOSE))))
            picture, small = channels.level(halvings)
            field = layer.field.canvas
            views.append(LayerView(
                picture, layer.handle, way, affine(canvas, self.stage), affine(canvas, field),
                affine(field, small), weight.astype(np.float32), share.astype(np.float32),
            ))  # fmt: skip
        if len(views) % 2:
            none = np.zeros_like(views[-1].weights)
            views.append(views[-1]._replace(weights=none, shares=none))
        nothing = np.zeros((1, 1, 4), np.float32)
        band = nothing if low is None else low.astype(np.float32)
        draw = self._operations.draw_layers
        drawn = (
            draw(views[first : first + 2], nothing if first else band, canvas.shape, rows)
            for first in range(0, len(views), 2)
        )
        return reduce(np.add, drawn)


def _in_space(colors: NDArray[np.floating], space: str) -> Float32:
    """Return sRGB colors (H, W, 3) in the space of a path, some rows at a time."""
    found = np.empty(colors.shape, np.float32)
    for rows in _bands(colors.shape):
        found[rows] = to_space(colors[rows], space)
    return found


def _bands(shape: tuple[int, ...], most: int = BAND) -> list[slice]:
    """Return the rows of a picture in parts of a few pixels, which take little memory."""
    together = max(1, most // shape[1])
    return [slice(row, min(row + together, shape[0])) for row in range(0, shape[0], together)]


def _where_covered(
    distances: Sequence[Array], shares: Sequence[float], weights: Sequence[Array]
) -> list[Array]:
    """Return weights by which no layer is seen beyond its own figure where another has one."""
    short = [np.minimum(distance, 0.0) for distance in distances]
    nearest = np.max(short, axis=0)
    covers = [np.clip(1 + (each - nearest) / COVER, 0, 1) for each in short]
    # What a layer does not show goes to those that have a figure there.
    left = 1.0 - sum(w * cover for w, cover in zip(weights, covers, strict=True))
    parts = [share * cover for share, cover in zip(shares, covers, strict=True)]
    total = np.maximum(sum(parts), np.finfo(float).tiny)
    return [
        weight * cover + left * part / total
        for weight, cover, part in zip(weights, covers, parts, strict=True)
    ]
