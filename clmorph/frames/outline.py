"""The outline of the figures of a frame: a level of the mean of the layers' signed distances.

The level is that at which the figure has an area. Where both layers count alike, the mean is
smoothed, so that outlines which nearly meet are one line. It is computed on as many pixels as its
smoothness asks for: in a frame of 4096 pixels that is a fraction of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.typing import Array, BoolArray
from clmorph.frames.canvas import Canvas
from clmorph.frames.fields import affine, blurred, slopes
from clmorph.frames.resampling import Enlarged, Float32

#: Rounds of bisection by which a level is found; pixels of a large frame that are looked at in one.
ROUNDS, TOGETHER = 40, 1 << 21
#: Width of the Gaussian that smooths an outline where both pictures count alike, twice: a share of
#: the longer side, and at least some pixels.
SMOOTH, NARROWEST = 0.006, 1.2
#: Outlines of layers that are so many points of the stage apart are smoothed more: by a Gaussian so
#: many times as wide, whose width falls to none at the ends of a film, at this rate.
ROUGH, ROUGH_WIDTH, FADING = 6.0, 3.0, 3.0
#: By how much the mean of two distances, halfway, may be made steeper; the least slope, which
#: distances far from all outlines do not have.
STEEPER, FLATTEST = 1.5, 0.25
#: Distance beyond the edge that counts as far, as a share of the longer side: the mean of two
#: distances is then inside where most of the mass is, and not where one figure is broadest.
FAR = 1 / 16
#: Pixels across the width of a Gaussian on the canvas on which what it smooths is computed.
ACROSS = 3.0
#: Half of the width up to which a line is thin, as a share of the longer side: one of two thin
#: lines that do not meet is seen, as their mean is no line.
THIN = 1 / 64
#: Half of the width of a fine line, as a share of the width of the Gaussian under which their share
#: in a figure is taken; the least area that counts, and the share from which it does.
FINE, LITTLE, MOSTLY = 0.375, 0.02, 0.7
#: What fine lines give of a figure's area, as a share of what the rest gives.
LEAST_FIRM = 0.05
#: The largest share of the wider smoothing that nobody sees.
FAINT = 0.01


class Outline(NamedTuple):
    """The outline of the figures of one frame."""

    canvas: Canvas
    #: Signed distance from it in the common frame, positive inside: (h, w) array on that canvas.
    distance: Float32
    #: Width over which it is drawn, likewise.
    edge: Float32
    #: The level of the mean distance that it is; None if all pixels are inside.
    level: float | None

    def on(self, canvas: Canvas) -> Callable[[slice], Float32]:
        """Return a function of rows of a canvas: how far their pixels lie inside, from 0 to 1."""
        if self.level is None:
            return lambda rows: np.ones((1, 1), np.float32)
        way = affine(canvas, self.canvas)
        distance, edge = (
            Enlarged(image, way, canvas.shape) for image in (self.distance, self.edge)
        )
        return lambda rows: np.clip(0.5 + distance.rows(rows) / edge.rows(rows), 0.0, 1.0)

    def reached(self, stage: Canvas) -> BoolArray:
        """Return which points of a stage stand near what is inside: no others show the figure."""
        from scipy.ndimage import maximum_filter

        inside = self.distance > -0.5 * self.edge
        way = affine(stage, self.canvas)
        reach = [2 * int(np.ceil(abs(step))) + 1 for step in way.step]
        wider = maximum_filter(inside, reach) if self.level is not None else inside | True
        rows, columns = (
            np.clip(np.rint(origin + step * np.arange(many)), 0, few - 1).astype(int)
            for origin, step, many, few in zip(
                way.origin, way.step, stage.shape, inside.shape, strict=True
            )
        )
        return around(wider[np.ix_(rows, columns)])


def bounded(distance: Float32, edge: float, far: float) -> Float32:
    """Return signed distances that beyond the edge grow by at most `far`; the array is used up.

    Within a soft edge they are what is drawn, and stay as they are.
    """
    near = np.clip(distance, -edge, edge)
    distance -= near
    distance /= far
    np.tanh(distance, out=distance)
    distance *= far
    distance += near
    return distance


def around(some: BoolArray) -> BoolArray:
    """Return some points of a grid with all that are next to them."""
    from scipy.ndimage import maximum_filter

    return np.asarray(maximum_filter(some, 3))


def outline_of(
    distance_on: Callable[[Canvas], Float32],
    canvas: Canvas,
    apart: Array,
    lines: Array,
    stage: Canvas,
    *,
    halfway: float,
    smoothing: float,
    area: float,
    softness: float,
    most: float,
) -> Outline:
    """Return the outline of a figure with an area, a share of the canvas, in one frame.

    `distance_on` gives the mean distance on a canvas in the common frame; `apart`, on the stage, by
    how many of its points the layers' own differ, and `lines`, from 0 to 1, where it has fine
    lines, which keep their width. `halfway` is 1 less the larger share of the pictures, and
    `smoothing`, from 0 to 1, how much the outline is smoothed there. `softness` is its width in
    pixels, and `most` the largest level.
    """
    longest = max(canvas.shape)
    whole = max(NARROWEST, SMOOTH * longest) * smoothing

    def smooth(width: float) -> tuple[Float32, Canvas]:
        fewer = max(1.0, width / ACROSS)
        on = canvas.reduced(max(1, round(longest / fewer))) if fewer > 1.0 else canvas
        return blurred(distance_on(on), width * max(on.shape) / longest), on

    distance, fine = smooth(whole * halfway)
    if whole * halfway > 0.0 and lines.max() > FAINT:
        sharp, on = smooth(0.0)
        share = Enlarged(lines.astype(np.float32), affine(on, stage), on.shape).rows()
        distance = Enlarged(distance, affine(on, fine), on.shape).rows()
        distance, fine = distance + share * (sharp - distance), on
    # Where they are far apart, their mean has the tears of both.
    rough = np.clip(blurred(apart, 2.0) / ROUGH, 0.0, 1.0)
    if smoothing * halfway > 0.0 and rough.max() > FAINT:
        wide, on = smooth(ROUGH_WIDTH * whole * min(1.0, FADING * halfway))
        wide = Enlarged(wide, affine(fine, on), fine.shape).rows()
        share = Enlarged(rough.astype(np.float32), affine(fine, stage), fine.shape).rows()
        distance = distance + share * (wide - distance)
    unit, grain = max(*canvas.scale, 1e-9), longest / max(fine.shape)
    # Where both layers differ, the mean has slopes unlike 1, with which its edge would be soft.
    least = max(FLATTEST, 1.0 - STEEPER * halfway * smoothing)
    edge = np.full(distance.shape, np.float32(softness / unit))
    if least < 1.0:
        steep = np.hypot(*slopes(distance * np.float32(unit / grain)))
        edge *= np.clip(steep, np.float32(least), np.float32(1.0))
    if area >= 1 - 0.5 / (canvas.shape[0] * canvas.shape[1]):
        return Outline(fine, distance, edge, None)
    firm = np.maximum(1.0 - lines, LEAST_FIRM)
    firm = Enlarged((firm / firm.max()).astype(np.float32), affine(fine, stage), fine.shape).rows()
    level = level_of(distance / firm, area, edge * np.float32(grain) / firm, most)
    return Outline(fine, distance - np.float32(level) * firm, edge, level)


def level_of(
    distance: NDArray[np.floating], area: float, softness: NDArray[np.floating], most: float
) -> float:
    """Return the level of distance at which the figure has an area, a share of the canvas.

    Pixels within half a `softness`, (H, W), of it count in part. It is at most `most` off zero.
    """
    far = float(softness.max())
    low, high = float(distance.min()) - far, float(distance.max()) + far
    low, high = max(low, -most), min(high, most)
    if low > high:
        low = high = float(np.clip(0.0, high, low))
    wanted, inside = area * distance.size, 0.0
    parts = -(-distance.size // TOGETHER)
    still = [np.array_split(each.ravel(), parts) for each in (distance, softness)]
    unsure = list(zip(*still, strict=True))
    level = low
    for _ in range(ROUNDS):
        level = 0.5 * (low + high)
        found = inside + sum(
            np.clip(0.5 + (open_ - level) / width, 0.0, 1.0).sum(dtype=float)
            for open_, width in unsure
        )
        low, high = (level, high) if found > wanted else (low, level)
        # Pixels that are inside, or outside, at each level that is left need no further look.
        for number, (open_, width) in enumerate(unsure):
            sure = open_ - high >= 0.5 * width
            left = ~sure & (low - open_ < 0.5 * width)
            inside += float(sure.sum())
            unsure[number] = open_[left], width[left]
    return level


def thinness(distances: Sequence[Array]) -> tuple[Array, Array]:
    """Return from 0 to 1 where all figures have thin lines or one but fine ones, and the latter.

    The mean of the distances from broad figures and from fine lines has no lines. Distances,
    (h, w), are in points.
    """
    from scipy.ndimage import maximum_filter

    half = THIN * max(distances[0].shape)
    widest = maximum_filter(np.max(distances, axis=0), 2 * int(2 * half) + 1)
    thin = blurred(np.clip(2.0 - widest / half, 0.0, 1.0), half)
    fine = np.max([fineness(each) for each in distances], axis=0)
    return np.maximum(thin, fine), fine


def fineness(distance: Array) -> Array:
    """Return from 0 to 1 where what one figure has around a place is fine lines."""
    from scipy.ndimage import distance_transform_edt

    width = 2 * THIN * max(distance.shape)
    inside, broad = distance > 0, distance > FINE * width
    # Broad parts go as far as a disk of the width of a fine line does.
    lines = inside & (distance_transform_edt(~broad) > FINE * width + 1) if broad.any() else inside
    share = blurred(lines.astype(float), width)
    share /= np.maximum(blurred(inside.astype(float), width), LITTLE)
    return np.clip((share - MOSTLY) / (1 - MOSTLY), 0.0, 1.0)
