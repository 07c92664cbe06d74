"""Fields of two pictures are refined until details, or outlines, of both meet halfway.

Both pictures are drawn at t = 1/2. Registration (Lucas and Kanade, 1981, as iterated by Le
Besnerais and Champagnat, ICIP 2005) says how far like details are apart there. Where both agree
after it, they get one displacement D on the domain halfway (Liao et al., "Automating image morphing
using structural similarity on a halfway domain", 2014): what stands at m at t = 1/2 is at m - D / 2
in the source and at m + D / 2 in the target. Elsewhere the pictures have nothing in common, and
fields stay as they were.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from clmorph._shared.typing import Array
from clmorph.backends.interface import Operations
from clmorph.frames.canvas import Canvas
from clmorph.frames.fields import Field, affine, blurred, sampled
from clmorph.frames.pictures import Pictures
from clmorph.frames.resampling import reduced

#: Steps of a whole path, and rounds of each.
STEPS, PATH_ROUNDS = 48, 4
#: Steps of the way to t = 1/2 while fields are refined.
HALF_STEPS = 12


class Round(NamedTuple):
    """One round of registration, on a grid with at most so many points along a side."""

    side: int

    #: Width in grid points of the Gaussian over which contrast is measured, or distance from an
    #: outline at which it ends.
    width: float
    #: Radius in grid points of the window in which displacements are estimated.
    radius: int


#: Rounds for details: one that compares what is large, so that a line of text is not taken for the
#: next one, before one that compares what is small; and rounds for outlines.
COARSE, FINE = Round(128, 6.0, 8), Round(256, 4.0, 7)
DETAILS = (COARSE, FINE, COARSE, FINE, FINE, Round(256, 4.0, 5))
OUTLINES = (
    Round(128, 8.0, 12), Round(128, 8.0, 8), Round(128, 4.0, 6), Round(128, 4.0, 5),
    Round(256, 4.0, 6), Round(256, 4.0, 6),
)  # fmt: skip
#: The longest correction of a round, as a share of the grid's longer side: of details, of outlines.
LONGEST, LONGEST_OUTLINE = 0.045, 0.06
#: Rounds of an estimate, each of which moves the second image by what is known.
WARPS = 6
#: Mean square of slopes below which a window does not tell displacements.
FLAT = 1e-3
#: Width of the Gaussian that smooths a correction, in grid points.
SOFTENING = 2.0
#: Correlation of both contrasts from which details begin to agree, and at which they do: while they
#: are searched, and at last. It is taken under a Gaussian of this share of the longer side, and of
#: so many points of a small picture at least: among fewer, unlike pictures agree by chance.
SEARCHED, AGREED, CORRELATED, FEWEST_CORRELATED = (0.4, 0.65), (0.6, 0.85), 0.02, 5.0
#: If after the first rounds these shares of the pictures do not agree, they have nothing in common.
FEWEST_AGREE = (0.03, 0.18)
#: Places around which others agree take their displacement: the share of the longer side over which
#: they are averaged, and the share of agreement from and up to which this counts.
AROUND, AGREEING = 0.06, (0.2, 0.5)
#: Width of the Gaussian that smooths what agrees, in grid points.
TRUST_WIDTH = 4.0
#: Contrast below this lightness is treated as noise.
NOISE = 0.045
#: Product of both contrasts' variances below which their correlation is that of noise.
FAINT = 1e-3
#: Images with a side below this number of grid points are not registered.
FEWEST = 16
#: Rounds of the iterations that invert a displacement.
INVERSE = 8


class Shown(NamedTuple):
    """One picture at t = 1/2 on the grid: places in the common frame, colors, and outline."""

    places: Array  # (H, W, 2)
    own: Array  # (H, W, 3): the picture's colors, those of its figure continued over the ground
    colors: Array  # (H, W, 3): the picture's colors, half changed into the other picture's
    change: Array  # (H, W, 3): that half change
    outline: Array  # (H, W): signed distance, in grid points


class Scene:
    """The pictures of a morph and their fields, which can be drawn at t = 1/2 and meet there."""

    def __init__(self, fields: Sequence[Field], pictures: Pictures, operations: Operations) -> None:
        self.fields, self._figures = list(fields), pictures.figures is not None
        shapes = [field.canvas.shape for field in fields]
        # Signed distances from the edges of figures, in the common frame.
        outlines = [np.zeros(shape) for shape in shapes]
        if pictures.figures is not None:
            outlines = [
                reduced(figure.distance, shape).astype(float) / max(*canvas.scale, 1e-9)
                for figure, canvas, shape in zip(
                    pictures.figures, pictures.canvases, shapes, strict=True
                )
            ]
        self._images = [
            np.dstack(each) for each in zip(pictures.own, pictures.continued, outlines, strict=True)
        ]
        self._operations, self._lightness = operations, pictures.lightness
        self.stage = self._whole = pictures.stage
        self._given = list(fields)

    def halves(self) -> list[Shown]:
        """Return both pictures at t = 1/2."""
        found = []
        for field, image in zip(self.fields, self._images, strict=True):
            to_field = affine(self.stage, field.canvas)
            path = self._operations.follow_paths(
                0.5 * field.steps(), to_field, self.stage.shape, HALF_STEPS, PATH_ROUNDS
            )
            at = np.moveaxis(to_field.places(self.stage.shape) + path[-1], -1, 0)
            scale = np.maximum(field.canvas.scale, 1e-9)
            places = (np.moveaxis(at[::-1], 0, -1) - field.canvas.center) / scale + 0.5
            shown = sampled(np.dstack((image, 0.5 * field.change)), at)
            colors, own, outline, change = np.split(shown, (3, 6, 7), axis=-1)
            outline = outline[..., 0] * max(self.stage.scale)
            found.append(Shown(places, own, colors + change, change, outline))
        return found

    def meet_outlines(self) -> None:
        """Move outlines of both figures onto one another."""
        if min(self.stage.shape) < FEWEST:
            return
        for each in OUTLINES:
            self.stage = self._whole.reduced(each.side)
            halves = self.halves()
            images = [
                blurred(np.clip(half.outline / each.width, -1, 1), each.width / 4)
                for half in halves
            ]
            flow = _flow(images, each.radius, LONGEST_OUTLINE, each.width / 2)
            first, second = self._moved(halves, flow, lambda half: half.places)
            self._set(_on_middle(first, second, second - first, self.stage), None)
            self.fields = [field._replace(move=blurred(field.move, 1.5)) for field in self.fields]
        self.stage, self._given = self._whole, list(self.fields)

    def meet_details(self) -> Array:
        """Register details; return how far both pictures agree at each point, from 0 to 1."""
        nothing = np.zeros(self.stage.shape)
        if min(self.stage.shape) < FEWEST:
            return nothing
        for number, each in enumerate(DETAILS):
            stage = self.stage = self._whole.reduced(each.side)
            longest = max(stage.shape)
            halves = self.halves()
            images = [_contrast(half.colors @ self._lightness, each.width) for half in halves]
            flow = _flow(images, each.radius, LONGEST, SOFTENING)
            first, second = self._moved(halves, flow, lambda half: half.places)
            shown = self._moved(halves, flow, lambda half: half.colors)
            agree = _ramp(self._correlation(*shown), SEARCHED)
            few = number < len(FEWEST_AGREE) and agree.mean() < FEWEST_AGREE[number]
            if few and not self._figures:
                self.stage, self.fields = self._whole, list(self._given)
                return nothing
            agree = blurred(agree, 3.0)[..., None]
            owns = self._moved(halves, flow, lambda half: half.own)
            change = blurred(owns[1] - owns[0], CORRELATED * longest)
            way = np.dstack((second - first, change, 0.5 * (first + second) - stage.positions()))
            around = blurred(agree[..., 0], AROUND * longest)[..., None]
            means = blurred(agree * way, AROUND * longest) / np.maximum(around, 1e-6)
            filled = (1 - agree) * _ramp(around, AGREEING)
            trust = agree + filled
            way = (agree * way + filled * means) / np.maximum(trust, 1e-6)
            way[..., 5:] *= np.minimum(1.0, 4 * trust)
            middle = stage.positions() + way[..., 5:]
            half = 0.5 * way[..., :2]
            self._set(
                _on_middle(middle - half, middle + half, way[..., :5], stage, trust), self._given
            )
        stage = self.stage = self._whole
        agree = blurred(
            _ramp(self._correlation(*(half.colors for half in self.halves())), AGREED), TRUST_WIDTH
        )
        # Where the pictures do not agree after all, the fields are those of the plan.
        for which, given in enumerate(self._given):
            field = self.fields[which]
            places = stage.places(field.canvas.positions() + 0.5 * field.move)
            kept = np.minimum(1.0, 2 * sampled(agree[..., None], places))
            self.fields[which] = field._replace(
                move=given.move + kept * (field.move - given.move),
                change=given.change + kept * (field.change - given.change),
            )
        return agree

    def _correlation(self, first: Array, second: Array) -> Array:
        """Return the local correlation of the contrasts of two images (H, W, 3): (H, W) array."""
        a, b = (_contrast(image @ self._lightness, FINE.width) for image in (first, second))
        width = max(CORRELATED, FEWEST_CORRELATED / max(self._whole.shape)) * max(a.shape)
        product = blurred(a * a, width) * blurred(b * b, width)
        return np.asarray(blurred(a * b, width) / np.sqrt(product + FAINT))

    def _moved(
        self, halves: Sequence[Shown], flow: Array, part: Callable[[Shown], Array]
    ) -> list[Array]:
        """Return a part of both pictures, each moved by half of the flow towards the other."""
        grid = np.indices(self.stage.shape).astype(float)
        return [
            sampled(part(half), grid + share * flow)
            for half, share in zip(halves, (-0.5, 0.5), strict=True)
        ]

    def _set(self, way: Array, given: Sequence[Field] | None) -> None:
        """Give both fields the displacement, and the change of color, on the middle domain.

        `way` is the displacement, (H, W, 2), or with change of color and how much of both counts,
        (H, W, 6). Elsewhere the fields `given` count.
        """
        for which, sign in enumerate((1.0, -1.0)):
            field = self.fields[which]
            here = field.canvas.positions()
            old = field if given is None else given[which]
            own = sign * way[..., :2]
            trust = np.ones((*way.shape[:2], 1)) if given is None else way[..., 5:]
            moves = np.dstack((own * trust, trust))
            middle = here + 0.5 * field.move
            for _ in range(INVERSE):
                found = sampled(moves, self.stage.places(middle))
                move = found[..., :2] + (1 - found[..., 2:]) * old.move
                middle = 0.5 * (middle + here + 0.5 * move)
            change = field.change
            if given is not None:
                kept = found[..., 2:]
                found = sampled(way[..., 2:5], self.stage.places(middle))
                change = old.change + kept * (sign * found - old.change)
            self.fields[which] = field._replace(move=move, change=change)


def _on_middle(
    first: Array, second: Array, way: Array, stage: Canvas, trust: Array | None = None
) -> Array:
    """Return values, given where their places in both pictures have met, on the middle of both."""
    points = stage.positions()
    apart = 0.5 * (first + second) - points
    found = points
    for _ in range(INVERSE):
        found = 0.5 * (found + points - sampled(apart, stage.places(found)))
    values = way if trust is None else np.dstack((way, trust))
    return sampled(values, stage.places(found))


def _flow(images: Sequence[Array], radius: int, longest: float, width: float) -> Array:
    """Return how far the second image is from the first at each point: (2, H, W) array.

    In windows without contrast, and along straight edges, nothing is known, and it is 0.
    """
    flow = _estimated(images[0], images[1], radius)
    limit = longest * max(images[0].shape)
    flow *= np.minimum(1.0, limit / np.maximum(np.hypot(*flow), 1e-9))
    return np.stack([blurred(part, width) for part in flow])


def _estimated(first: Array, second: Array, radius: int) -> Array:
    """Return an estimate of how far the second image is from the first, from coarse to fine.

    `FLAT` keeps windows without contrast out of every round: they would add but rounding errors.
    """
    from scipy.ndimage import uniform_filter
    from skimage.transform import pyramid_reduce

    shape = first.shape
    flow = np.zeros((2, *shape))
    if min(shape) > 2 * FEWEST:
        less = [pyramid_reduce(image, channel_axis=None) for image in (first, second)]
        coarse = _estimated(less[0], less[1], radius)
        scale = np.divide(shape, coarse.shape[1:])[:, None, None]
        points = (np.indices(shape) + 0.5) / scale - 0.5
        flow = np.moveaxis(sampled(np.moveaxis(coarse * scale, 0, -1), points), -1, 0)
    grid = np.indices(shape).astype(float)
    for _ in range(WARPS):
        moved = sampled(second[..., None], grid + flow)[..., 0]
        y, x = np.gradient(moved)
        apart = y * flow[0] + x * flow[1] + first - moved
        yy, yx, xx, down, along = (
            uniform_filter(each, 2 * radius + 1, mode="mirror")
            for each in (y * y, y * x, x * x, y * apart, x * apart)
        )
        yy, xx = yy + FLAT, xx + FLAT
        flow = np.stack((xx * down - yx * along, yy * along - yx * down)) / (yy * xx - yx * yx)
    return flow


def _contrast(lightness: Array, width: float) -> Array:
    """Return lightness less its local mean, divided by its local standard deviation."""
    detail = lightness - blurred(lightness, width)
    return np.asarray(detail / np.sqrt(blurred(detail**2, width) + NOISE**2))


def _ramp(values: Array, limits: tuple[float, float]) -> Array:
    """Return 0 up to the first limit, 1 from the second one, and what is linear in between."""
    return np.clip((values - limits[0]) / (limits[1] - limits[0]), 0.0, 1.0)
