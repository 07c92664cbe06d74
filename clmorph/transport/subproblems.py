"""Parts of a transport problem between two images that are solved side by side: one a label.

Mass keeps its label because the pairs of different labels are in no problem at all. Together the
parts are the problem whose cost between different labels is infinite, so the sums of their values
are the values of that problem.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from clmorph._shared.typing import Array, IntArray, Progress
from clmorph.backends.interface import Operations
from clmorph.errors import InputError
from clmorph.images.label_maps import MAX_LABELS, label_text
from clmorph.measures.measure import Measure
from clmorph.measures.pixel_blocks import PixelBlocks, group_pixels
from clmorph.measures.points import as_pair
from clmorph.transport._solver.problem import MASS_TOLERANCE, check_problem
from clmorph.transport.barycentric import Barycentric
from clmorph.transport.certificate import Certificate
from clmorph.transport.plan import Plan, plan_of_pairs
from clmorph.transport.potentials import Potentials
from clmorph.transport.regularization import Goal
from clmorph.transport.sinkhorn import solve


@dataclass(frozen=True, eq=False)
class Subproblem:
    """A transport problem between blocks of pixels of two images: that of one label, or of all.

    Pixels of other labels have no mass. `points` are the blocks of both sides that have mass,
    between which the problem is solved; None stands for all blocks.
    """

    source: PixelBlocks
    target: PixelBlocks
    label: int | None = None
    points: tuple[IntArray, IntArray] | None = None

    @property
    def blocks(self) -> tuple[PixelBlocks, PixelBlocks]:
        """Both sides."""
        return self.source, self.target

    @cached_property
    def measures(self) -> tuple[Measure, Measure]:
        """The measures between which the problem is solved."""
        whole = self.source.coarse, self.target.coarse
        if self.points is None:
            return whole
        return _chosen(whole[0], self.points[0]), _chosen(whole[1], self.points[1])

    @property
    def pairs(self) -> int:
        """Number of pairs of points."""
        return len(self.measures[0]) * len(self.measures[1])

    def between_blocks(self, plan: Plan) -> Plan:
        """Return a plan between `measures` as one between all blocks."""
        if self.points is None:
            return plan
        shape = len(self.source.coarse), len(self.target.coarse)
        counts = np.zeros(shape[0], np.int64)
        counts[self.points[0]] = np.diff(plan.indptr)  # the chosen blocks are in ascending order
        return Plan(
            np.concatenate(([0], np.cumsum(counts))),
            self.points[1][plan.indices].astype(np.int32), plan.mass, shape,
            *map(_scattered, plan.marginals, self.points, shape),
        )  # fmt: skip

    def means_of_blocks(self, plan: Barycentric) -> Barycentric:
        """Return mean destinations of `measures` as those of all blocks.

        A block of other labels moves as the nearest block of this one does, so that an
        interpolation between blocks sees this label alone.
        """
        if self.points is None:
            return plan
        from scipy.ndimage import distance_transform_edt

        coarse, chosen = self.source.coarse, self.points[0]
        index = np.full(len(coarse), -1)
        index[chosen] = np.arange(len(chosen))
        row, column = distance_transform_edt(
            (index < 0).reshape(coarse.shape), return_distances=False, return_indices=True
        )
        nearest = index[(row * coarse.shape[1] + column).ravel()]
        moved = plan.positions - coarse.positions[chosen]
        return Barycentric(
            coarse.positions + moved[nearest], plan.colors[nearest], plan.covariance[nearest],
            _scattered(plan.row_mass, chosen, len(coarse)),
            _scattered(plan.column_mass, self.points[1], len(self.target.coarse)),
        )  # fmt: skip


def _chosen(measure: Measure, chosen: IntArray) -> Measure:
    """Return some points of a measure as a measure, whose shape is that of a single row."""
    names = ["positions", "colors", "weights", "alpha", "warped", "features"]
    names += ["color_metric"] * measure.has_metric_map
    parts = {name: getattr(measure, name) for name in names}
    kept: Any = {name: part[chosen] for name, part in parts.items() if part is not None}
    return replace(measure, shape=(1, len(chosen)), **kept)


def _scattered(values: Array, chosen: IntArray, count: int) -> Array:
    found = np.zeros(count)
    found[chosen] = values
    return found


def by_label(
    source: Measure,
    target: Measure,
    labels: tuple[IntArray, IntArray],
    solve_size: int | None,
    goal: Goal,
) -> list[Subproblem]:
    """Divide the problem between two images into those of the labels, (H, W), that both have.

    A block of pixels of several labels becomes a point of each of them, with the mass and the mean
    of its pixels, so that labels stay apart exactly whatever the size of the blocks.
    """
    masses = list(map(_masses, (source, target), labels))
    count = len(masses[0].keys() | masses[1].keys())
    if count > MAX_LABELS:
        raise InputError(f"labels: {count} different ones: expected at most {MAX_LABELS}")
    common = sorted(masses[0].keys() & masses[1].keys())
    if not common:
        shown = " and ".join(_some(list(each)) for each in masses)
        raise InputError(
            f"labels: no label has mass in both images ({shown}), so nothing would move: give "
            "what belongs together the same label"
        )
    _check_balance(masses, goal)
    parts = []
    for label in common:
        blocks = [
            group_pixels(
                replace(measure, weights=np.where(each.ravel() == label, measure.weights, 0.0)),
                solve_size,
            )
            for measure, each in zip((source, target), labels, strict=True)
        ]
        points = tuple(np.flatnonzero(each.coarse.weights > 0) for each in blocks)
        parts.append(Subproblem(blocks[0], blocks[1], label, (points[0], points[1])))
    return parts


def _masses(measure: Measure, labels: IntArray) -> dict[int, float]:
    """Return the masses of the labels that have some in an image."""
    names, index = np.unique(labels.ravel(), return_inverse=True)
    masses = np.bincount(index, measure.weights, len(names)).tolist()
    return {name: mass for name, mass in zip(names.tolist(), masses, strict=True) if mass > 0}


def _some(names: list[int]) -> str:
    shown = ", ".join(map(label_text, names[:4]))
    return shown + (", …" if len(names) > 4 else "")


def _check_balance(masses: list[dict[int, float]], goal: Goal) -> None:
    """Refuse labels whose mass cannot all move, on sides that are balanced."""
    balanced = [bool(np.isinf(rho)) for rho in goal.rho]
    for label in sorted(masses[0].keys() | masses[1].keys()):
        one, other = (each.get(label, 0.0) for each in masses)
        lost = any(
            fixed and own > 0 == partner
            for fixed, own, partner in zip(balanced, (one, other), (other, one), strict=True)
        )
        if lost or (all(balanced) and abs(one - other) > MASS_TOLERANCE * max(one, other)):
            raise InputError(
                f"labels: label {label_text(label)} has mass {one:.6g} in image_a and {other:.6g} "
                "in image_b, but balanced transport needs the same: give a reach, or weights with "
                "equal masses of each label"
            )


def solve_parts(
    parts: Sequence[Subproblem],
    masses: tuple[float, float],
    goal: Goal,
    operations: Operations,
    report: Progress,
) -> tuple[list[Potentials], Potentials]:
    """Solve the problems of labels, and return their potentials, each and all together.

    Together they have the certificate of the problem whose cost between labels is infinite;
    `masses` are those of both images, of labels without a partner as well.
    """
    found: list[Potentials] = []
    total, done = sum(part.pairs for part in parts), 0
    for part in parts:
        pair = as_pair(*part.measures)
        check_problem(pair, goal, operations)

        def share(own: float, before: int = done, pairs: int = part.pairs) -> None:
            report((before + own * pairs) / total)

        found.append(solve(operations, pair, goal, share))
        done += part.pairs
    return found, _together(parts, found, masses, goal)


def _together(
    parts: Sequence[Subproblem],
    solved: Sequence[Potentials],
    masses: tuple[float, float],
    goal: Goal,
) -> Potentials:
    """Return the potentials of all parts as one."""
    worst = max(range(len(solved)), key=lambda k: (not solved[k].converged, solved[k].residual))
    n_iter = max(each.n_iter for each in solved)
    first = solved[worst]
    if first.converged:
        message = (
            f"{len(parts)} label{'s' * (len(parts) > 1)} converged in at most {n_iter} iterations "
            "each (residual "
            f"{first.residual:.1e} epsilon)"
        )
    else:
        message = f"label {label_text(parts[worst].label or 0)}: {first.message}"
    truncations = [each.truncation for each in solved if each.truncation is not None]
    pairs = [part.pairs for part in parts]
    return Potentials(
        np.concatenate([each.f for each in solved]), np.concatenate([each.g for each in solved]),
        goal.blur, goal.reach, first.status, message, n_iter, first.residual,
        max((each.residuals for each in solved), key=len),
        _joint_certificate([each.certificate for each in solved], masses, goal),
        any(each.precise for each in solved), max(truncations, default=None),
        max(each.truncation_error for each in solved),
        float(np.average([each.visited for each in solved], weights=pairs)),
    )  # fmt: skip


def _joint_certificate(
    parts: Sequence[Certificate], masses: tuple[float, float], goal: Goal
) -> Certificate:
    """Add up certificates; pairs of other labels and mass without a partner are constants."""
    constant = goal.epsilon * (
        masses[0] * masses[1] - sum(each.masses[0] * each.masses[1] for each in parts)
    )
    for side in (0, 1):
        alone = masses[side] - sum(each.masses[side] for each in parts)
        if np.isfinite(goal.rho[side]):
            constant += goal.rho[side] * max(alone, 0.0)
    primal, dual, gap, error, transported = (
        sum(getattr(each, name) for each in parts)
        for name in ("primal", "dual", "gap", "marginal_error", "transported_mass")
    )
    return Certificate(
        primal + constant, dual + constant, gap, error,
        np.concatenate([each.row_mass for each in parts]),
        np.concatenate([each.column_mass for each in parts]),
        transported, masses,
    )  # fmt: skip


def joined(parts: Sequence[Subproblem], plans: Sequence[Plan | Barycentric]) -> Plan | Barycentric:
    """Return plans of parts, between the same pixels or blocks of both images, as one plan."""
    if parts[0].points is None:
        return plans[0]
    means = [plan for plan in plans if isinstance(plan, Barycentric)]
    if means:
        return _joined_means(parts, means)
    sparse = [plan for plan in plans if isinstance(plan, Plan)]
    rows, columns, mass = (
        np.concatenate(each)
        for each in zip(*((plan.rows, plan.indices, plan.mass) for plan in sparse), strict=True)
    )
    return plan_of_pairs((rows, columns), mass, sparse[0].shape, _sums(sparse), keep_zeros=True)


def _sums(plans: Sequence[Plan] | Sequence[Barycentric]) -> list[Array]:
    return [np.sum([plan.marginals[side] for plan in plans], axis=0) for side in (0, 1)]


def _joined_means(parts: Sequence[Subproblem], plans: Sequence[Barycentric]) -> Barycentric:
    """Give each point the mean destination of its own label, and let others rest."""
    first = parts[0].source
    measure = first.fine if len(plans[0]) == len(first.fine) else first.coarse
    positions, colors = measure.positions.copy(), measure.colors.copy()
    covariance = np.zeros_like(plans[0].covariance)
    for plan in plans:
        own = plan.row_mass > 0
        positions[own], colors[own] = plan.positions[own], plan.colors[own]
        covariance[own] = plan.covariance[own]
    return Barycentric(positions, colors, covariance, *_sums(plans))
