"""A smooth map of colors: the debiased entropic map, on a lattice where colors occur."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, grey_dilation, map_coordinates, spline_filter

from clmorph._shared.progress import Report
from clmorph._shared.typing import Array
from clmorph.backends.interface import Operations
from clmorph.measures.cluster import make_clusters
from clmorph.measures.points import WeightedPoints
from clmorph.transport.entropic_map import entropic_map
from clmorph.transport.potentials import Potentials
from clmorph.transport.sinkhorn import sinkhorn

#: Largest number of clusters of colors between which the transport is solved; their first side,
#: and the step of the lattice, in blurs; and the factor by which these grow.
CLUSTERS, SIDE, STEP, GROWTH = 2048, 0.5, 0.3, 1.2
#: Largest number of nodes of the lattice, of which those near colors are computed.
NODES = 1 << 20
#: Nodes around a color on each side that are computed; a cubic spline has 2, its filter decays.
AROUND = 3
#: Residual at which the solver stops, in units of epsilon.
TOLERANCE = 1e-3


@dataclass(frozen=True, eq=False)
class ColorMap:
    """The step of each color, interpolated by cubic splines between the nodes of a lattice."""

    #: The first node, in coordinates of a color space: (3,) array.
    origin: Array
    #: Distance of neighboring nodes.
    step: float
    #: Coefficients of the splines of the three components: (3, n, m, k) array.
    coefficients: Array

    def steps(self, colors: Array) -> Array:
        """Return the steps of colors (N, 3); beyond the lattice those of its border."""
        places = (colors - self.origin) / self.step
        ends = np.array(self.coefficients.shape[1:]) - 2.0
        places = np.clip(places, 1.0, ends).T
        return np.stack(
            [
                map_coordinates(each, places, order=3, mode="mirror", prefilter=False)
                for each in self.coefficients
            ],
            axis=1,
        )


def color_map(
    source: WeightedPoints,
    target: WeightedPoints,
    blur: float,
    reach: float | None,
    operations: Operations,
    report: Report,
) -> ColorMap:
    """Transport a distribution of colors into another one, and return the map of colors."""
    a, b = (_clusters(measure, SIDE * blur) for measure in (source, target))

    def solved(partner: WeightedPoints, done: float) -> Potentials:
        return sinkhorn(
            a, partner, blur, reach, TOLERANCE, backend=operations,
            progress=lambda share: report(done + 0.4 * share),
        )  # fmt: skip

    cross, own = solved(b, 0.0), solved(a, 0.4)
    origin, step, near = _lattice(source.points, STEP * blur)
    nodes = origin + step * np.argwhere(near)
    there, back = (
        entropic_map(nodes, measure, each.g, each.epsilon, operations, each.precise)
        for measure, each in ((b, cross), (a, own))
    )
    # Debiased steps, T - T_own, times min(1, exp(-(f - f_own) / rho)).
    steps = there.means - back.means
    if not np.isinf(cross.rho):
        # f = T(g) / (1 + epsilon / rho) at any point
        nats = (there.softmins - back.softmins) / (cross.rho + cross.epsilon)
        steps = np.exp(-np.maximum(nats, 0.0))[:, None] * steps
    # Farther nodes take the step of the nearest one that is computed.
    place = distance_transform_edt(~near, return_distances=False, return_indices=True)
    lattice = np.zeros((3, *near.shape))
    lattice[:, near] = steps.T
    coefficients = [spline_filter(each[tuple(place)], order=3, mode="mirror") for each in lattice]
    report(1.0)
    return ColorMap(origin, step, np.stack(coefficients))


def _clusters(measure: WeightedPoints, side: float) -> WeightedPoints:
    """Return clusters of colors of mass 1 in all, at most `CLUSTERS`."""
    while True:
        found = make_clusters(measure, side).measure
        if len(found) <= CLUSTERS:
            return WeightedPoints(found.points, found.weights / found.mass)
        side *= GROWTH


def _lattice(points: Array, step: float) -> tuple[Array, float, NDArray[np.bool_]]:
    """Return origin and step of a lattice around points, and which of its nodes are near points."""
    low, high = points.min(axis=0), points.max(axis=0)
    while True:
        shape = np.ceil((high - low) / step).astype(int) + 1 + 2 * AROUND
        if np.prod(shape.astype(float)) <= NODES:
            break
        step *= GROWTH
    origin = low - AROUND * step
    near = np.zeros(shape, bool)
    near[tuple(np.floor((points - origin) / step).astype(int).T)] = True
    side = 2 * AROUND + 1
    return origin, step, grey_dilation(near.view(np.uint8), (side, side, side)).astype(bool)
