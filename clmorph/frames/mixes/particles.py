"""Particles of a mixture of several images.

Each pixel x of image i is sent to image j by the plan between both images. In a mixture with the
weights w its mass stands at sum_j w_j T_ij(x), in the color sum_j w_j c_j(T_ij(x)), and counts w_i
times, where T_ii(x) = x. The mixture of measures is the sum of these over all images,

    mu_w = sum_i w_i (sum_j w_j T_ij)_# mu_i.

With one positive weight it is that image; with two it is the displacement interpolation of both,
as their morph draws it. It does not depend on the order of the images, and no image is a
reference. Lee, Wolberg and Shin mix warps between images in this way ("Polymorph: morphing among
multiple images", IEEE Computer Graphics and Applications 18(1), 1998).
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clmorph.frames.growth import grown_ends
from clmorph.images.color import to_space
from clmorph.measures.measure import Measure
from clmorph.transport.plan import Plan

Array = NDArray[np.float64]


class Draws(NamedTuple):
    """Destinations of an image's pixels in another image, drawn from their plan.

    Attributes
    ----------
    ends : (N * S, 2) array
        Positions of the destinations of each pixel, in the common frame.
    colors : (N * S,) array of int
        Pixels of the other image whose colors arrive; -1 for mass that stays what it is.
    """

    ends: Array
    colors: NDArray[np.int64]


def draw(
    measures: tuple[Measure, Measure], plan: Plan, unmatched: str, draws: int, seed: int
) -> Draws:
    """Draw destinations of each pixel of an image.

    A pixel is divided into equal parts, of which each draws its destination from an equal part of
    the pixel's mass. Mass that the plan does not take away rests, or follows the mass beside it
    with "grow", as in `clmorph.frames.particles.particles`.

    Parameters
    ----------
    measures : (source, target)
    plan : Plan
    unmatched : {"fade", "grow", "drop"}
    draws : int
        Number of draws of each pixel.
    seed : int
    """
    source, target = measures
    n = len(source)
    rng = np.random.default_rng(seed)
    # Independent orders of the parts make destinations in several images independent.
    order = rng.permuted(np.tile(np.arange(draws), (n, 1)), axis=1)
    thresholds = (order + rng.random((n, draws))) / draws
    kept, sent = plan.row_mass, plan.marginals[0]
    share = np.divide(np.minimum(source.weights, sent), source.weights, out=np.zeros(n),
                      where=source.weights > 0)  # fmt: skip
    share[kept <= 0] = 0.0
    if unmatched == "drop":
        share[kept > 0] = 1.0
    travels = thresholds < share[:, None]
    within = np.divide(thresholds, share[:, None], out=np.zeros_like(thresholds), where=travels)
    sums = np.concatenate(((0.0,), np.cumsum(plan.mass)))
    first, last = plan.indptr[:-1, None], plan.indptr[1:, None]
    wanted = sums[first] + within * kept[:, None]
    pair = np.searchsorted(sums, wanted, side="right") - 1
    pair = np.clip(pair, first, np.maximum(last - 1, first))[travels]
    colors = np.full((n, draws), -1)
    colors[travels] = plan.indices[pair]
    rests = source.positions
    if unmatched == "grow":
        rests = grown_ends(source, target, plan)[0]
    ends = np.repeat(rests, draws, axis=0)
    there = travels.ravel()
    ends[there] = target.positions[colors[travels]]
    return Draws(ends, colors.ravel())


def reversed_plan(plan: Plan) -> Plan:
    """Return the plan from the target to the source."""
    from scipy.sparse import csr_array

    turned = csr_array((plan.mass, plan.indices, plan.indptr), shape=plan.shape).T.tocsr()
    turned.sort_indices()
    return Plan(
        turned.indptr.astype(np.int64), turned.indices.astype(np.int32), turned.data,
        plan.shape[::-1], plan.whole_column_mass, plan.whole_row_mass,
    )  # fmt: skip


class MixedParticles:
    """The particles of all mixtures of some images.

    Parameters
    ----------
    measures : sequence of Measure
    plans : mapping of (i, j) to Plan
        The plan of each pair of images, i < j.
    unmatched : {"fade", "grow", "drop"}
    path_space : str
        The color space in which colors change linearly.
    draws : int
        Number of particles of each pixel.
    seed : int
    """

    def __init__(
        self,
        measures: Sequence[Measure],
        plans: dict[tuple[int, int], Plan],
        unmatched: str,
        path_space: str,
        draws: int,
        seed: int,
    ) -> None:
        self._measures, self._draws, self._drop = measures, draws, unmatched == "drop"
        self._colors = [to_space(measure.colors, path_space) for measure in measures]
        self._found: dict[tuple[int, int], Draws] = {}
        self._sent: dict[tuple[int, int], Array] = {}
        for (i, j), plan in plans.items():
            for here, there, own in ((i, j, plan), (j, i, reversed_plan(plan))):
                number = here * len(measures) + there
                self._found[here, there] = draw(
                    (measures[here], measures[there]), own, unmatched, draws, seed + number
                )
                self._sent[here, there] = own.row_mass

    def at(self, weights: Sequence[float]) -> tuple[Array, Array]:
        """Return the particles of one mixture.

        Parameters
        ----------
        weights : sequence of float
            The weight of each image, with the sum 1.

        Returns
        -------
        table : (P, 6) array
            Positions, colors in the space of the path and distances to neighbors.
        mass : (P,) array
        """
        shown = [i for i, weight in enumerate(weights) if weight > 0]
        spacing = sum(weights[i] * self._measures[i].spacing for i in shown)
        tables, masses = [], []
        for i in shown:
            places = weights[i] * np.repeat(self._measures[i].positions, self._draws, axis=0)
            own = np.repeat(self._colors[i], self._draws, axis=0)
            colors = weights[i] * own
            for j in shown:
                if j != i:
                    found = self._found[i, j]
                    stays = (found.colors < 0)[:, None]
                    places += weights[j] * found.ends
                    colors += weights[j] * np.where(stays, own, self._colors[j][found.colors])
            mass = np.repeat(self._mass(i, weights, shown), self._draws) / self._draws
            drawn = mass > 0
            pitch = np.full((int(drawn.sum()), 1), spacing)
            tables.append(np.hstack((places[drawn], colors[drawn], pitch)))
            masses.append(weights[i] * mass[drawn])
        return np.concatenate(tables), np.concatenate(masses)

    def _mass(self, i: int, weights: Sequence[float], shown: list[int]) -> Array:
        """Return the masses of an image's pixels; with "drop" the mean of what travels."""
        others = [j for j in shown if j != i]
        if not self._drop or not others:
            return self._measures[i].weights
        total = sum(weights[j] for j in others)
        return np.asarray(sum(weights[j] / total * self._sent[i, j] for j in others))


def upload(operations: Any, table: Array, mass: Array) -> Any:
    """Upload particles that stand still, for `clmorph.frames.render.render` at t = 0."""
    number = np.arange(len(table), dtype=np.uint32)
    return operations.upload_particles(
        table, np.column_stack((number, number)), np.column_stack((mass, mass))
    )
