"""Paths of mass that does not travel by itself: it grows out of, or into, what travels beside it.

Unbalanced transport creates and destroys mass in place, so that an object without a partner appears
as a ghost. With ``unmatched="grow"`` the mass of such a pixel starts where the nearest pixel that
does travel comes from, and likewise ends where it goes.
"""

import numpy as np

from clmorph._shared.typing import Array, IntArray
from clmorph.frames.figures import nearest
from clmorph.measures.measure import Measure
from clmorph.transport.barycentric import Barycentric
from clmorph.transport.plan import Plan

#: Share of a pixel's mass that travels, relative to the largest of all pixels up to 1, from which
#: the pixel counts as one that travels.
TRAVELS = 0.5


def mean_destinations(
    source: Measure, target: Measure, plan: Plan | Barycentric
) -> tuple[Array, Array]:
    """Return mean destinations of source pixels, (N, 2), and origins of target pixels, (M, 2)."""
    if isinstance(plan, Plan):
        return plan.mean_destinations(source.positions, target.positions)
    # The mean origin of a target pixel is not known, so what is born there rests.
    return plan.positions, target.positions


def grown_ends(source: Measure, target: Measure, plan: Plan | Barycentric) -> tuple[Array, Array]:
    """Return where unmatched mass of source pixels ends, and where that of target pixels starts.

    They are positions in the common frame, (N, 2) and (M, 2), and those of the pixels themselves if
    nothing travels. A `Barycentric` plan does not know where mass comes from, so births stay in
    place.
    """
    forth, back = mean_destinations(source, target, plan)
    sent, received = plan.marginals
    return _nearest_end(source, sent, forth), _nearest_end(target, received, back)


def take_after(values: Array, links: IntArray, known: int) -> None:
    """Give rows that `grown_ends` has added the values of their particles' other ends, in place.

    `values` have one row for each row of the particles' table, of which `known` were not added.
    """
    for own, added in ((0, 1), (1, 0)):
        grown = links[:, added] >= known
        values[links[grown, added]] = values[links[grown, own]]


def _nearest_end(measure: Measure, moved: Array, ends: Array) -> Array:
    """Return, for each pixel, the end of the nearest pixel that travels: (N, 2) array."""
    share = np.divide(moved, measure.weights, out=np.zeros_like(moved), where=measure.weights > 0)
    most = min(1.0, float(share.max()))
    if most == 0:
        return measure.positions
    travels = (share >= TRAVELS * most).reshape(measure.shape)
    corners = np.ptp(measure.positions, axis=0)[::-1]
    pitch = [
        span / (side - 1) if side > 1 else 1.0
        for span, side in zip(corners, measure.shape, strict=True)
    ]
    rows, columns = nearest(travels, pitch)
    return np.asarray(ends[(rows * measure.shape[1] + columns).ravel()])
