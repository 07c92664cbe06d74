"""The debiased, unbalanced Sinkhorn divergence between two measures (paper, 2.2; math: S).

S(a, b) = OT(a, b) - OT(a, a) / 2 - OT(b, b) / 2 + epsilon / 2 (m_a - m_b)^2.

Source: Séjourné, Feydy, Vialard, Trouvé, Peyré, "Sinkhorn divergences for unbalanced optimal
transport" (2019).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clmorph._shared.notebook import interval
from clmorph._shared.typing import Progress
from clmorph._shared.validation import check_flag, check_progress, shown
from clmorph.backends.interface import Operations
from clmorph.backends.multi_device import for_one_solve
from clmorph.backends.select import Backend, get_backend
from clmorph.errors import InputError
from clmorph.measures.points import AnyMeasure, MeasureLike, Pair, are_equal, as_pair
from clmorph.transport._solver.annealing import ignore
from clmorph.transport._solver.plan_softmin import RowsOfPlan
from clmorph.transport._solver.problem import check_problem
from clmorph.transport.certificate import SUM_ERROR
from clmorph.transport.gradient import Gradient, divergence_gradient
from clmorph.transport.options import Precision, SolverOptions
from clmorph.transport.potentials import Potentials, check_potentials
from clmorph.transport.regularization import Goal, refuses_other_order, regularization
from clmorph.transport.sinkhorn import solve, warn_unless_converged

#: The problem between two measures is solved further if the gap of its values is more than this
#: share of the divergence's upper bound.
WIDE = 0.5
#: The residual to reach then: this share of the tolerance, but no less than the second number.
FURTHER, FINEST = 1e-2, 1e-6


@dataclass(frozen=True, repr=False, eq=False)
class Divergence:
    """A Sinkhorn divergence, its potentials, and an interval that is proven to contain its value.

    Attributes
    ----------
    value : float
        Cost units times mass; `float(divergence)` is the same. Never negative.
    interval : (low, high)
        Bounds of the true value, rounding included. They follow from dual values (lower bounds)
        and primal values (upper bounds) of the three problems. For balanced transport primal values
        follow from the marginal errors, and the interval is wide unless `tol` is small.
    cross : Potentials
        Potentials of the problem between source and target.
    source_self, target_self : Potentials
        Potentials of the problem of each measure with itself, where f = g.
    gradient : Gradient or None
        Derivatives by points and weights, if they were asked for.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> source = np.full(3, 1 / 3), np.array([0.0, 0.5, 1.0])
    >>> target = np.full(2, 1 / 2), np.array([0.25, 0.75])
    >>> found = clmorph.sinkhorn_divergence(source, target, 0.1, 0.3, backend="numpy")
    >>> round(float(found), 5), found.converged
    (0.0239, True)
    >>> low, high = found.interval
    >>> bool(low <= found.value <= high)
    True
    """

    value: float
    interval: tuple[float, float]
    cross: Potentials
    source_self: Potentials
    target_self: Potentials
    gradient: Gradient | None = None

    def __float__(self) -> float:
        return self.value

    def __repr__(self) -> str:
        low, high = self.interval
        return f"<Divergence {self.value:.6g}, certainly within [{low:.6g}, {high:.6g}]>"

    def _repr_html_(self) -> str:
        """Show the value and its interval on a line in a notebook."""
        return interval(self.value, *self.interval, repr(self)[1:-1])

    @property
    def converged(self) -> bool:
        """Whether all three solves reached their tolerance."""
        return all(part.converged for part in (self.cross, self.source_self, self.target_self))

    def closer_than(self, other: Divergence) -> bool | None:
        """Return whether this divergence is smaller than another: True or False if proven.

        Parameters
        ----------
        other : Divergence
            A divergence with the same blur and reach.

        Returns
        -------
        bool or None
            None if the two intervals overlap, so that nothing is proven.

        Raises
        ------
        InputError
            If `other` is no Divergence.

        Examples
        --------
        >>> import numpy as np
        >>> import clmorph
        >>> near, far = (
        ...     clmorph.sinkhorn_divergence(
        ...         ([1.0], [0.0]), ([1.0], [x]), 0.1, None, backend="numpy"
        ...     )
        ...     for x in (0.1, 0.2)
        ... )
        >>> near.closer_than(far), far.closer_than(near), near.closer_than(near)
        (True, False, None)
        """
        if not isinstance(other, Divergence):
            raise InputError(
                f"other={shown(other)}: expected a Divergence, as clmorph.sinkhorn_divergence "
                "returns it"
            )
        if self.interval[1] < other.interval[0]:
            return True
        if self.interval[0] > other.interval[1]:
            return False
        return None


@refuses_other_order
def sinkhorn_divergence(
    source: MeasureLike,
    target: MeasureLike,
    blur: float | None = None,
    reach: float | None = None,
    tol: float = SolverOptions.tol,
    max_iter: int = SolverOptions.max_iter,
    backend: Backend = "auto",
    *,
    epsilon: float | None = None,
    rho: float | None = None,
    precision: Precision = "auto",
    cross: Potentials | None = None,
    progress: Progress | None = None,
    gradient: bool = False,
) -> Divergence:
    """Return the Sinkhorn divergence of two measures: 0 only if they are equal, never negative.

    S(a, b) = OT(a, b) - OT(a, a) / 2 - OT(b, b) / 2 + epsilon / 2 (m_a - m_b)^2 (paper, 2.2), where
    OT is the optimal value of the problem that `clmorph.sinkhorn` solves.

    Parameters
    ----------
    source, target : Measure, Grid, WeightedPoints, or (weights (N,), points (N, D))
        Their masses may differ unless `reach` is None.
    blur, epsilon
        As in `clmorph.sinkhorn`.
    reach : float or None
        As in `clmorph.sinkhorn`, but one number for both measures; the divergence is not defined
        for two different numbers.
    rho : float, optional
        reach^2, in place of `reach`; infinity is balanced.
    tol, max_iter, backend, precision, progress
        As in `clmorph.sinkhorn`, for each of the three problems.
    cross : Potentials, optional
        Potentials between source and target with the same blur and reach, if they are known.
    gradient : bool
        Whether to compute the derivatives by points and weights too, see `clmorph.gradient`. With a
        `tol` of 1e-6 they are within 1e-4 of their largest component, unless the measures are so
        near to each other that the derivatives cancel.

    Returns
    -------
    Divergence

    Raises
    ------
    InputError
        If an argument cannot be used, or no bound can be proven for a part of the result.

    Warns
    -----
    ConvergenceWarning
        If a residual does not reach `tol`.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> source = np.full(3, 1 / 3), np.array([0.0, 0.5, 1.0])
    >>> target = np.full(2, 1 / 2), np.array([0.25, 0.75])
    >>> clmorph.sinkhorn_divergence(source, target, 0.1, 0.3, backend="numpy")
    <Divergence 0.0239032, certainly within [0.0239032, 0.0239032]>
    >>> float(clmorph.sinkhorn_divergence(source, source, 0.1, 0.3, backend="numpy"))
    0.0
    >>> options = {"tol": 1e-6, "gradient": True, "backend": "numpy"}
    >>> found = clmorph.sinkhorn_divergence(source, target, 0.1, 0.3, **options)
    >>> (found.gradient.source_points.round(4) + 0.0).tolist()  # no -0.0
    [[-0.0674], [0.0], [0.0674]]
    """
    goal = one_regularization(blur, reach, epsilon, rho, tol, max_iter, precision)
    report = check_progress(progress)
    gradient = check_flag("gradient", gradient)
    pair = as_pair(source, target)
    check_symmetric(*pair)
    if cross is not None:
        check_potentials("cross", cross, (len(pair[0]), len(pair[1])))
        if (cross.blur, cross.reach) != (goal.blur, goal.reach):
            raise InputError(
                f"cross: potentials at blur={cross.blur:g}, reach={cross.reach}; expected "
                f"blur={goal.blur:g}, reach={goal.reach}: solve for these, or leave it out"
            )
    operations = for_one_solve(get_backend(backend))
    check_problem(pair, goal, operations)
    if cross is not None:
        check_cross(operations, pair, cross)

    known = cross is not None
    parts: list[Potentials] = []
    for number, measure in enumerate(pair):
        parts.append(solve(operations, (measure, measure), goal, ignore))
        warn_unless_converged(parts[-1].status, f"self-transport: {parts[-1].message}", 4)
        report(0.15 * (number + 1))
    if are_equal(*pair):
        cross = parts[0]
    elif cross is None:
        found = solve(operations, pair, goal, lambda share: report(0.3 + 0.7 * share), keep=True)
        cross = replace(found, measures=pair)
        warn_unless_converged(cross.status, cross.message, 4)
    result = combined(cross, *parts)
    smaller = further_tol(result, goal.tol)
    if smaller is not None and not known:
        further = solve(operations, pair, goal._replace(tol=smaller), ignore, exact=True)
        cross = replace(better(cross, further, goal.tol), measures=pair)
        result = combined(cross, *parts)
    if gradient:
        slope = divergence_gradient(pair, cross, (parts[0], parts[1]), operations)
        result = replace(result, gradient=slope)
    report(1.0)
    return result


def one_regularization(*given: Any) -> Goal:
    """Return what `regularization` does, with one reach for both measures."""
    goal = regularization(*given)
    if isinstance(goal.reach, tuple):
        raise InputError(
            f"reach={goal.reach!r}: expected one number for both measures (or None); with two "
            "there is no divergence"
        )
    return goal


def check_cross(operations: Operations, pair: Pair, cross: Potentials) -> None:
    """Check that potentials are those of these measures, so that their interval is, too."""
    if cross.measures is None:
        RowsOfPlan(operations, pair, cross).checked()
    elif not all(map(are_equal, pair, cross.measures)):
        raise InputError(
            "cross: potentials are of other measures: expected clmorph.sinkhorn of these, in the "
            "same order, or leave it out"
        )


def check_symmetric(*measures: AnyMeasure) -> None:
    """Check that the cost of measures is a squared distance."""
    if any(measure.offsets is not None for measure in measures):
        raise InputError(
            "a cost with a metric for each source pixel is not a distance, so there is no "
            "divergence: use one metric for all pixels"
        )


def combined(cross: Potentials, source: Potentials, target: Potentials) -> Divergence:
    """Return the divergence that three solves prove."""
    parts = source, target
    if not all(np.isfinite(part.gap) for part in (cross, *parts)):
        raise InputError(
            "the divergence has no bound: points are too far apart for this blur on this device, "
            "or the solver was stopped too far from a solution; raise blur or max_iter, scale the "
            "points, or use backend='numpy'"
        )
    masses = cross.certificate.masses
    extra = 0.5 * cross.epsilon * (masses[0] - masses[1]) ** 2
    duals = [part.dual for part in (cross, *parts)]
    # S(a, b) (paper, 2.2; math: S)
    value = duals[0] - 0.5 * (duals[1] + duals[2]) + extra
    rounding = SUM_ERROR * (extra + sum(abs(dual) for dual in duals))
    low = value - 0.5 * (parts[0].gap + parts[1].gap) - rounding
    high = value + cross.gap + rounding
    # S >= 0 is a theorem, so a negative lower bound is rounding and 0 takes its place.
    low = max(0.0, low)
    return Divergence(max(low, value), (low, max(low, high)), cross, parts[0], parts[1])


def further_tol(found: Divergence, tol: float) -> float | None:
    """Return the residual to which the problem between both measures is to be solved further.

    None if the interval is narrow, or as narrow as it can become. A residual says little about the
    values of balanced transport where groups of points stand far apart: masses that differ by less
    than `tol` between them have to be moved from one group to the other.
    """
    cross = found.cross
    balanced = bool(np.all(np.isinf(cross.rho)))
    if not balanced or cross is found.source_self or cross.gap <= WIDE * found.interval[1]:
        return None
    masses = cross.certificate.masses
    least = max(FINEST, 4 * abs(masses[0] - masses[1]) / masses[0])  # see `check_problem`
    smaller = min(tol, max(FURTHER * tol, least))
    return None if smaller == tol and cross.converged else smaller


def better(before: Potentials, after: Potentials, tol: float) -> Potentials:
    """Return the potentials with the nearer values, `after` being solved below `tol`."""
    if after.gap >= before.gap:
        return before
    if after.converged or after.residual > tol:
        return after
    message = f"converged in {after.n_iter} iterations (residual {after.residual:.1e} epsilon)"
    return replace(after, status="converged", message=message)
