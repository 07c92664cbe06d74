"""Opacity of frames, from areas and opacities that travel with the particles' masses."""

import numpy as np
from numpy.typing import NDArray

from clmorph.frames.growth import take_after
from clmorph.frames.particles import Particles
from clmorph.frames.render import Sums
from clmorph.measures.measure import Measure
from clmorph.transport.barycentric import Barycentric
from clmorph.transport.plan import Plan

Array = NDArray[np.float64]

#: The share to which coverage may fall at t = 1/2 before opacity falls: particles never spread
#: uniformly, and this alone must not be visible.
THINNEST = 0.5
#: Cracks up to twice this share of the canvas's longer side are closed: where particles part, the
#: background would show as scratches.
CRACK = 0.015


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
