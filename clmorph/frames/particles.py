"""Particles that travel along the plan, births and deaths included."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.typing import Array, IntArray
from clmorph._shared.validation import check_number
from clmorph.errors import InputError
from clmorph.frames.growth import grown_ends
from clmorph.frames.options import RenderOptions
from clmorph.images.color import to_space
from clmorph.measures.measure import Measure
from clmorph.measures.points import as_image_measure
from clmorph.transport.barycentric import Barycentric, check_barycentric
from clmorph.transport.plan import Plan, check_plan

#: Mass of a pixel of the ground, relative to an even spread of all mass.
GROUND = 0.02


@dataclass(frozen=True, repr=False, eq=False)
class Particles:
    """Straight paths between points, independent of t.

    At time t particle k stands at (1 - t) table[start] + t table[end], in position and
    in color, and has the mass (1 - t) weights[k, 0] + t weights[k, 1].

    Attributes
    ----------
    table : (P, 6) array
        Positions in the common frame, colors in the space of the path, and the distance to
        neighbors. The rows are the source's points, then the target's, then the mean destinations
        if particles end there, then the other ends of mass that grows or shrinks.
    links : (K, 2) array of uint32
        Rows of `table` where each particle starts and ends.
    weights : (K, 2) array
        Mass of each particle at t = 0 and at t = 1.
    path_space : str
        The color space in which colors change linearly, see `clmorph.images.color.to_space`.
    n_grown : int
        Number of the last rows of `table` that are other ends of mass that grows or shrinks.
    labels : pair of integer arrays, (N,) and (M,), optional
        Labels of the pixels of source and target, which no particle changes, so that fields
        do not cross their borders (`clmorph.frames.fields`).

    Examples
    --------
    >>> import clmorph
    >>> import numpy as np
    >>> left, right = np.zeros((2, 6, 6, 3))
    >>> left[:, :3] = right[:, 3:] = 1.0
    >>> source, target = clmorph.lift(left), clmorph.lift(right)
    >>> potentials = clmorph.sinkhorn(source, target, blur=0.1, reach=0.3, backend="numpy")
    >>> plan = clmorph.transport_plan(source, target, potentials, backend="numpy")
    >>> moving = clmorph.particles(source, target, plan)
    >>> moving.table.shape, moving.weights.shape == (len(moving), 2)
    ((72, 6), True)
    """

    table: Array
    links: NDArray[np.uint32]
    weights: Array
    path_space: str = "srgb"
    n_grown: int = 0
    labels: tuple[IntArray, IntArray] | None = None

    def __repr__(self) -> str:
        return f"<{len(self)} Particles>"

    def __len__(self) -> int:
        return len(self.links)

    @cached_property
    def _end_masses(self) -> Array:
        return np.asarray(self.weights.sum(axis=0))

    def mass(self, t: float) -> float:
        """Total mass at time t, from 0 to 1.

        Examples
        --------
        >>> import clmorph
        >>> import numpy as np
        >>> left, right = np.zeros((2, 6, 6, 3))
        >>> left[:, :3] = right[:, 3:] = 1.0
        >>> source, target = clmorph.lift(left), clmorph.lift(right)
        >>> potentials = clmorph.sinkhorn(source, target, blur=0.1, reach=0.3, backend="numpy")
        >>> plan = clmorph.transport_plan(source, target, potentials, backend="numpy")
        >>> moving = clmorph.particles(source, target, plan)
        >>> round(moving.mass(0.0), 6), round(moving.mass(1.0), 6)
        (1.0, 1.0)
        """
        t = check_number("t", t, 0.0, 1.0)
        start, end = self._end_masses
        return float((1 - t) * start + t * end)


def particles(
    source: Measure,
    target: Measure,
    plan: Plan | Barycentric,
    *,
    unmatched: str = "fade",
    path_space: str = "srgb",
) -> Particles:
    """Turn a plan into particles.

    Each kept pair is one particle. Unbalanced transport can take more mass out of a source
    point than it holds, or less. With "fade" a pair's mass is scaled to
    pi_ij [(1 - t) min(1, a_i / r_i) + t min(1, b_j / c_j)], where r and c are the plan's marginals.
    The mass that the plan leaves, (a_i - r_i)_+, dies at its place, and (b_j - c_j)_+ is born.
    So every source pixel has its mass at t = 0 and every target pixel at t = 1.

    These marginals are those of the whole plan (`Plan.marginals`). Mass of a row that pruning has
    dropped, or that draws have missed, is shared out among the row's kept pairs at t = 0, and
    likewise among a column's at t = 1. So the number of drawn pairs affects the grain, but not the
    mass that dies or is born. A point without a kept pair rests.

    Parameters
    ----------
    source, target : Measure
    plan : Plan or Barycentric
        With a `Barycentric` plan each source point is one particle, which ends at its mean
        destination in its mean color; so the frame at t = 1 is not quite the target.
    unmatched : {"fade", "grow", "drop"}
        With "grow" the mass that dies or is born does not rest, see `clmorph.frames.growth`. With
        "drop" there is none, and a kept pair has the mass pi_ij at all times, as in the
        paper's code.
    path_space : {"srgb", "linear", "lab", "luv", "oklab"}
        The color space in which colors change linearly between both ends.

    Returns
    -------
    Particles

    Raises
    ------
    InputError
        If an argument cannot be used, or "drop" would leave no particle.

    Examples
    --------
    >>> import clmorph
    >>> import numpy as np
    >>> left, right = np.zeros((2, 6, 6, 3))
    >>> left[:, :3] = right[:, 3:] = 1.0
    >>> source, target = clmorph.lift(left), clmorph.lift(right)
    >>> potentials = clmorph.sinkhorn(source, target, blur=0.1, reach=0.3, backend="numpy")
    >>> plan = clmorph.transport_plan(source, target, potentials, backend="numpy")
    >>> moving = clmorph.particles(source, target, plan)
    >>> len(moving) > len(plan)  # pairs of the plan, and mass that dies or is born
    True
    >>> len(clmorph.particles(source, target, plan, unmatched="drop")) == len(plan)
    True
    """
    RenderOptions.checked("unmatched", unmatched)
    RenderOptions.checked("path_space", path_space)
    source, target = (
        as_image_measure(name, measure, "particles have positions and colors")
        for name, measure in (("source", source), ("target", target))
    )
    sizes = len(source), len(target)
    if isinstance(plan, Plan):
        check_plan("plan", plan, sizes)
    else:
        check_barycentric("plan", plan, sizes)
    if unmatched == "drop" and not plan.row_mass.any():
        raise InputError(
            "unmatched='drop': nothing travels, so there is nothing to draw; raise the reach, "
            "or use unmatched='fade'"
        )
    n = len(source)
    ends = [
        (measure.positions, to_space(measure.colors, path_space), np.full(len(measure), pitch))
        for measure, pitch in ((source, source.spacing), (target, target.spacing))
    ]
    if isinstance(plan, Plan):
        i, j, mass = plan.rows, plan.indices.astype(np.int64), plan.mass
    else:
        colors = to_space(plan.colors, path_space)
        ends.append((plan.positions, colors, np.full(len(plan), target.spacing)))
        i = np.flatnonzero(plan.row_mass)
        j, mass = len(target) + i, plan.row_mass[i]
    table = np.concatenate([np.column_stack(end) for end in ends])
    links = np.column_stack((i, n + j))
    weights = np.column_stack((mass, mass))
    n_grown = 0
    if unmatched != "drop":
        # With the whole plan's marginals, mass that pruning dropped or draws missed travels as the
        # other mass of its point does.
        sent, received = plan.marginals
        sent, starting = _shared_out(np.minimum(source.weights, sent), i, mass)
        received, arriving = np.minimum(target.weights, received), mass
        if isinstance(plan, Plan):
            received, arriving = _shared_out(received, j, mass)
        weights = np.column_stack((starting, arriving))
        dying, born = source.weights - sent, target.weights - received
        dies, comes = np.flatnonzero(dying), np.flatnonzero(born)
        resting = np.concatenate((dies, n + comes))
        others = resting
        if unmatched == "grow":
            n_grown = len(resting)
            others = len(table) + np.arange(n_grown)
            ends_of = grown_ends(source, target, plan)
            there = np.concatenate((ends_of[0][dies], ends_of[1][comes]))
            table = np.concatenate((table, np.column_stack((there, table[resting, 2:]))))
        ends_at = np.column_stack((resting, others))
        ends_at[len(dies) :] = ends_at[len(dies) :, ::-1].copy()
        links = np.concatenate((links, ends_at))
        fading = np.zeros((len(resting), 2))
        fading[: len(dies), 0] = dying[dies]
        fading[len(dies) :, 1] = born[comes]
        weights = np.concatenate((weights, fading))
    return Particles(table, links.astype(np.uint32), weights, path_space, n_grown)


def with_ground(particles: Particles, source: Measure, target: Measure) -> Particles:
    """Add pixels without mass as a faint ground at rest, over which other particles prevail.

    Without it a flat background, which has no mass, would be drawn as what is next to it.
    """
    sizes = len(source), len(target)
    bare = [np.flatnonzero(measure.weights == 0) for measure in (source, target)]
    rows = np.concatenate((bare[0], sizes[0] + bare[1]))
    weights = np.zeros((len(rows), 2))
    for end, size in enumerate(sizes):
        mass = float(particles.weights[:, end].sum())
        first = end * len(bare[0])
        weights[first : first + len(bare[end]), end] = GROUND * mass / size
    return replace(
        particles,
        links=np.concatenate((particles.links, np.column_stack((rows, rows)).astype(np.uint32))),
        weights=np.concatenate((particles.weights, weights)),
    )


def _shared_out(moved: Array, owners: IntArray, mass: Array) -> tuple[Array, Array]:
    """Share out the mass that each point moves among its pairs, in proportion to their masses.

    The result is `moved`, (N,), but 0 for a point without pairs, and each pair's part of it, (K,).
    """
    kept = np.bincount(owners, mass, len(moved))
    moved = np.where(kept > 0, moved, 0.0)
    share = np.divide(mass, kept[owners], out=np.zeros(len(mass)), where=mass > 0)
    return moved, share * moved[owners]
