"""The correction that makes the first and the last frame the images themselves.

A frame at t = 0 is the source, smoothed by a kernel. The correction adds what the kernel removes,
source less frame: it travels with the pixels, drawn with a narrow kernel, so that the first frames
are as sharp as the source; likewise backwards from the target. It depends on the kernel's width at
that time, and fades with `share`, which is 1 at both ends and 0 halfway, where a frame is Eq. 4
alone. A difference that remains at the ends even so (pixels from which nothing travels if unmatched
mass is dropped, or rounding) fades at its place.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.typing import Array
from clmorph.backends.interface import Operations
from clmorph.frames.canvas import Canvas
from clmorph.frames.growth import grown_ends, mean_destinations
from clmorph.frames.render import CUT, kernel_sum
from clmorph.images.resizing import resized
from clmorph.measures.measure import Measure
from clmorph.transport.barycentric import Barycentric
from clmorph.transport.plan import Plan

#: Side of the blocks in which a correction that rests is held, or none is.
BLOCK = 64

#: Kernel width of the correction in units of the pixels' spacing: it hardly reaches the next pixel.
NARROW = 0.3

#: Factor between the kernel widths for which the correction is computed.
STEP = 1.25

#: The time after which `brief_share` is 0. Outlines move, so what rests must be gone soon.
BRIEF = 0.12

#: A correction that travels is left out if it is smaller than the first of these everywhere: nobody
#: sees it. One that rests costs little, and is left out if it is rounding of float32.
NEGLIGIBLE, ROUNDING = 1e-4, 1e-7


def share(t: float) -> float:
    """Return the strength of the correction at time t, from 1 at both ends to 0 halfway."""
    return float(np.cos(np.pi * t) ** 2)


def brief_share(t: float) -> float:
    """Return the strength, at time t, of a correction that is seen near the ends alone."""
    return max(0.0, 1.0 - min(t, 1.0 - t) / BRIEF) ** 2


class Lacking(NamedTuple):
    """Image less frame at one end, for several kernel widths."""

    #: Ascending, in pixels: (L,) array.
    widths: Array
    #: Image less frame, in the space of the path: (L, H, W, 3) array.
    missing: Array

    def at(self, width: float) -> Array:
        """Return image less frame at a width, by linear interpolation: (H, W, 3) array."""
        place = float(np.interp(width, self.widths, np.arange(len(self.widths))))
        below = int(place)
        above = min(below + 1, len(self.widths) - 1)
        return (1 - place + below) * self.missing[below] + (place - below) * self.missing[above]


def ladder(widths: Array) -> Array:
    """Return a few ascending widths between which the correction can be interpolated."""
    low, high = float(np.min(widths)), float(np.max(widths))
    if low <= 0 or high <= low:
        return np.array([low])
    return np.geomspace(low, high, 1 + int(np.ceil(np.log(high / low) / np.log(STEP))))


class _Rest(NamedTuple):
    """What rests at one end: of a drawing little more than its outlines."""

    shape: tuple[int, ...]
    #: Parts of the picture, rows and columns, and what is missing there.
    parts: list[tuple[tuple[slice, ...], NDArray[np.float32]]]


class Details:
    """Image less frame at one end, as particles that travel with the pixels.

    `destinations`, (N, 2), is the mean destination or mean origin of each pixel, and `moving`,
    (N,), the share of it that moves; the rest stays. `backwards` tells whether the pixels arrive,
    as those of the target do.
    """

    def __init__(
        self,
        measure: Measure,
        missing: Lacking,
        destinations: Array,
        moving: Array,
        backwards: bool,
    ) -> None:
        self._spacing, self._missing = measure.spacing, missing
        n = len(measure)
        self._positions = np.concatenate((measure.positions, destinations))
        here, there = np.arange(n), n + np.arange(n)
        path = (there, here) if backwards else (here, there)
        links = np.concatenate((np.column_stack(path), np.column_stack((here, here))))
        weights = np.concatenate((moving, 1.0 - moving)) * np.tile(measure.weights > 0, 2)
        kept = weights > 0
        self._links = links[kept].astype(np.uint32)
        self._weights = np.column_stack((weights, weights))[kept]

    def at(self, t: float, canvas: Canvas, width: float, operations: Operations) -> Array | float:
        """Return the correction, before it is faded, for a kernel's width in pixels: (H, W, 3)."""
        if not len(self._links):
            return 0.0
        colors = np.tile(self._missing.at(width).reshape(-1, 3), (2, 1))
        spacing = np.full(len(colors), self._spacing)
        particles = operations.upload_particles(
            np.column_stack((self._positions, colors, spacing)), self._links, self._weights
        )
        pitch = max(1e-3, self._spacing * 0.5 * sum(canvas.scale))
        sigma = NARROW * pitch
        splats = operations.advect(particles, t, canvas.scale, canvas.center)
        numerator, denominator = operations.splat(splats, canvas.shape, sigma, CUT * sigma)
        # Where pixels have moved apart, the correction is weaker than that of a uniform spread.
        even = kernel_sum(sigma) / pitch**2
        return numerator / np.maximum(denominator, even)[..., None]


class EndCorrection:
    """The correction, of a strength `share` at each time, that brings both ends to the images.

    An end whose details are None needs no correction.
    """

    def __init__(
        self,
        details: tuple[Details | None, Details | None],
        share: Callable[[float], float] = share,
    ) -> None:
        self._details, self._share = details, share
        self._rest: list[_Rest | None] = [None, None]

    def moving(
        self, t: float, canvas: Canvas, width: float, operations: Operations
    ) -> Array | float:
        """Return the correction of the colors at time t, in the space of the path."""
        total: Array | float = 0.0
        share = self._share(t)
        for end, details in zip(((1 - t), t), self._details, strict=True):
            if details is not None and end * share > 0:
                total = total + end * share * details.at(t, canvas, width, operations)
        return total

    def set_rest(self, end: int, missing: Array) -> None:
        """Set the difference that remains at an end, 0 or 1, after correction: (H, W, C) array."""
        rest = _Rest(missing.shape, [])
        for top, left in np.ndindex(*(-(-side // BLOCK) for side in missing.shape[:2])):
            block = tuple(slice(BLOCK * at, BLOCK * (at + 1)) for at in (top, left))
            part = missing[block]
            if max(part.max(), -part.min()) > ROUNDING:
                rest.parts.append((block, part.astype(np.float32)))
        if rest.parts:
            self._rest[end] = rest

    def correct(self, frame: NDArray[np.floating], t: float) -> None:
        """Add the correction that rests to the finished frame at t, (H, W, C), in place."""
        share = self._share(t)
        for end, rest in zip(((1 - t), t), self._rest, strict=True):
            if rest is None or end * share == 0:
                continue
            strength = float(end * share)
            missing = frame if rest.shape == frame.shape else np.zeros(rest.shape, np.float32)
            for block, part in rest.parts:
                missing[block] += strength * part
            if missing is not frame:
                frame += resized(missing, frame.shape[:2]).astype(np.float32)
        np.clip(frame, 0.0, 1.0, out=frame)


def make_details(
    measures: tuple[Measure, Measure],
    plan: Plan | Barycentric,
    missing: tuple[Lacking, Lacking],
    unmatched: str,
) -> tuple[Details | None, Details | None]:
    """Return the corrections of both ends, which travel by the plan's mean displacements.

    With `unmatched` "fade" alone detail stays in place, as the mass that dies or is born.
    """
    source, target = measures
    masses = plan.marginals
    destinations = mean_destinations(source, target, plan)
    grown = grown_ends(source, target, plan) if unmatched == "grow" else None
    result: list[Details | None] = []
    for end, measure in enumerate(measures):
        if np.abs(missing[end].missing).max() <= NEGLIGIBLE:
            result.append(None)
            continue
        moved, own = masses[end], measure.weights
        moving = np.divide(moved, own, out=np.zeros_like(own), where=own > 0)
        there = np.where(moved[:, None] > 0, destinations[end], measure.positions)
        moving = np.minimum(moving, 1.0)
        if grown is not None:
            there = moving[:, None] * there + (1.0 - moving[:, None]) * grown[end]
            moving = np.ones_like(moving)
        elif unmatched == "drop":
            moving = (moving > 0).astype(float)
        result.append(Details(measure, missing[end], there, moving, backwards=end == 1))
    return result[0], result[1]
