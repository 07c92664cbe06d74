"""When each place of a film changes from the one picture to the other.

Two pictures that are seen through each other are a double exposure, so each place changes hands
within a short part of the film: region by region, along the edges of both, first where both are
most alike.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clmorph._shared.enlarging import enlarged
from clmorph._shared.typing import Array
from clmorph.backends.interface import Operations
from clmorph.backends.records import LIKE
from clmorph.frames.canvas import Canvas
from clmorph.frames.fields import CELLS, LIKE_CELLS, SIGMA, SIGMA_FINE, blurred, slopes
from clmorph.frames.resampling import reduced

#: Share of the film within which a place changes hands.
DURATION = 0.1
#: Widths, as shares of the longer side, over which both pictures are compared: details, regions;
#: and of the random order of regions, with its strength beside the order by likeness.
DETAIL, REGION, DISORDER, STRENGTH = 0.01, 1 / 24, 0.1, 0.7
#: Points of that disorder along the longer side.
NOISE_POINTS = 40
#: Rounds of the mean over like neighbors, and the factor of its tolerance: it compares two colors.
ROUNDS, BOTH = 3, np.sqrt(2.0)
#: Width, likewise, over which the order of thin lines is smoothed.
THIN_WIDTH = 0.04
#: What a change of color, and a place without any detail, weigh relative to the mean detail.
CHANGING, PLAIN = 0.3, 0.2
#: What a place that only one picture shows weighs beside one that both show.
UNSHARED = 1e-3


def switching_times(
    halves: Sequence[Array],
    lightness: Array,
    stage: Canvas,
    operations: Operations,
    shared: Array | None = None,
    thin: Array | None = None,
) -> Array:
    """Return the time, from 0 to 1, at which each place changes hands: (H, W) array.

    The halves are both pictures at t = 1/2; `lightness`, (3,), weighs the coordinates of a color.
    Only places that both pictures show change hands: `shared`, (H, W), says how far they do. Where
    there are but thin lines, as `thin`, (H, W), says, the order does not follow the edges of both,
    which are those of the lines.
    """
    longest = max(stage.shape)
    first, second = (blurred(half, DETAIL * longest) for half in halves)
    shared = np.ones(stage.shape) if shared is None else np.maximum(shared, UNSHARED)
    unlike = np.linalg.norm(first - second, axis=2)
    # The same disorder at all sizes, so that a preview shows what the film will.
    shape = [max(1, round(NOISE_POINTS * side / longest)) for side in stage.shape]
    noise = np.random.default_rng(0).standard_normal((*shape, 1))
    noise = enlarged(blurred(noise, DISORDER * NOISE_POINTS), stage.shape)[..., 0]
    around = blurred(unlike * shared, REGION * longest) / blurred(shared, REGION * longest)
    order = _standard(around, shared) + STRENGTH * _standard(noise, shared)
    cells = stage.reduced(CELLS)
    fine = np.concatenate(list(halves), axis=2)
    guide = reduced(fine, cells.shape).astype(np.float32)
    found = reduced(order[..., None], cells.shape)
    known = reduced(shared, cells.shape).astype(np.float32)
    for _ in range(ROUNDS):
        found = operations.edge_preserving_mean(
            found.astype(np.float32), known, guide, guide, SIGMA, BOTH * LIKE_CELLS
        )
    found = operations.edge_preserving_mean(
        found.astype(np.float32), known, guide, fine.astype(np.float32), SIGMA_FINE,
        BOTH * LIKE,
    )  # fmt: skip
    across = order
    order = blurred(found[..., 0], longest / 256)
    if thin is not None:
        order += thin * (blurred(across, THIN_WIDTH * longest) - order)
    # Time passes with the detail that changes hands, and less with plain places.
    detail = sum(_steepness(half @ lightness, DETAIL * longest) for half in halves)
    weight = detail / max(float(np.mean(detail)), 1e-9)
    weight += CHANGING * unlike / max(float(unlike.mean()), 1e-9) + PLAIN
    weight *= shared
    ranks = np.argsort(order, axis=None, kind="stable")
    passed = np.cumsum(weight.ravel()[ranks])
    times = np.empty(order.size)
    times[ranks] = (passed - 0.5 * weight.ravel()[ranks]) / passed[-1]
    return times.reshape(stage.shape)


def _steepness(image: Array, width: float) -> Array:
    """Return the mean gradient around each place; 0 along a side of one pixel."""
    return blurred(np.hypot(*slopes(image)), width)


def _standard(values: Array, weights: Array) -> Array:
    """Return values in units of their standard deviation, weighted."""
    mean = np.average(values, weights=weights)
    deviation = np.sqrt(np.average((values - mean) ** 2, weights=weights))
    return np.asarray(values / max(float(deviation), 1e-9))


def switched(times: Array, agreement: Array, t: float) -> Array:
    """Return the weight of the second picture at time t, as `turns` does: (H, W) array."""
    return turns(times, agreement, (1 - t, t))[1]


def turns(times: Array, agreement: Array, shares: Sequence[float]) -> list[Array]:
    """Return the weight of each picture at each place: (H, W) arrays with the sum 1.

    Where `times`, from 0 to 1, is large, an earlier one of the pictures is seen; where all agree,
    all are seen with their shares, whose sum is 1.
    """
    later = np.cumsum(np.asarray(shares, dtype=float)[::-1])[::-1]
    seen = [np.ones_like(times)]
    seen += [np.clip((each - (1 - DURATION) * times) / DURATION, 0.0, 1.0) for each in later[1:]]
    seen.append(np.zeros_like(times))
    return [
        (1 - agreement) * (seen[number] - seen[number + 1]) + agreement * share
        for number, share in enumerate(shares)
    ]
