"""One transport problem: its checks, half-steps, residual and dual (paper, 2.1 and 3.1)."""

import functools
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple, Self

import numpy as np

from clmorph._shared.boxes import boxes_of_runs
from clmorph._shared.typing import Array
from clmorph._shared.validation import check_number, shown
from clmorph.backends.interface import MAX_EXPONENT, MAX_SPREAD, Operations
from clmorph.backends.records import ResidentIteration
from clmorph.errors import DeviceError, InputError
from clmorph.measures.grid import are_grids
from clmorph.measures.points import AnyMeasure, Pair, corners_of, dimension_of
from clmorph.transport._solver.grid_softmin import GridSoftmin
from clmorph.transport._solver.reductions import WHOLE, Reductions, largest_size, log_sum_exp
from clmorph.transport._solver.softmin import FEW_DIMENSIONS, Softmin, many_pairs
from clmorph.transport.certificate import STEPS_ERROR, Certificate, Side, certify, marginal
from clmorph.transport.regularization import Goal

#: The relative rounding that is assumed for a mass, which is a sum of exponentials.
MASS_ROUNDING = 1e-14
#: Rounding can be the cause of a residual of at most this many times the bound on the rounding of
#: one softmin.
ROUNDING_MARGIN = 8.0
#: Tolerance on an apparent decrease of the dual, relative to the rounding bound of the residual,
#: and the share of it that the dual's own rounding may be.
SLACK, DUAL_SHARE = 1e-2, 0.1
#: The annealing begins below this share of the joint diameter of both measures.
TOP = 0.5
#: Relative difference of masses up to which balanced transport is feasible.
MASS_TOLERANCE = 1e-6
#: Two measures with at least this many points are sorted and uploaded in threads.
MANY_POINTS = 1 << 13


class State(NamedTuple):
    """Potentials with their softmins, T(g) and T(f), and their residual in units of epsilon."""

    f: Array
    g: Array
    t_rows: Array
    t_columns: Array
    residual: float


class HalfStep(NamedTuple):
    """Potentials that maximize the dual over one of them and a shift of the other."""

    new: Any  #: the potential of the half-step
    old: Any  #: the other potential, shifted
    softmin: Any  #: T(old)
    log_mass: Any  #: logarithm of the mass of their plan

    @property
    def mass(self) -> Any:
        """The mass of their plan."""
        return np.exp(np.minimum(self.log_mass, MAX_EXPONENT))


class Problem:
    """Unbalanced entropic transport between two measures, at any epsilon.

    With the reductions `Segments` it is many problems, whose vectors hold the points of all, and
    whose numbers are arrays. `to_rows` and `to_columns` compute T(g) and T(f); the weights are the
    masses (a, b); an infinite rho is balanced; `largest_cost` is an upper bound.
    """

    #: Whether every softmin has the powers and sums of `bounded_softmins`, at three times the time.
    exact_sums = False
    #: Radius of the region where the problem is valid, in units of epsilon.
    trust_radius = np.inf
    #: What is added to T(g), (N,), and to T(f), (M,).
    corrections: tuple[Array | float, Array | float] = (0.0, 0.0)

    def __init__(
        self,
        to_rows: Any,
        to_columns: Any,
        rho: tuple[float, float],
        largest_cost: Any,
        reductions: tuple[Reductions, Reductions] = (WHOLE, WHOLE),
        oscillations: tuple[Any, Any] | None = None,
    ) -> None:
        self.to_rows, self.to_columns = to_rows, to_columns
        #: The backend, and the source's and the target's cloud.
        self.operations: Operations = to_rows.operations
        self.rows, self.columns = to_rows.rows, to_rows.columns
        self.a, self.b = to_rows.weights
        self.of_rows, self.of_columns = self.reductions = reductions
        self.rho, self.largest_cost = rho, largest_cost
        #: Bounds of |C_ij - C_kj| over rows i, k, and of |C_ij - C_il| over columns j, l.
        self.oscillations: tuple[Any, Any] = oscillations or (largest_cost, largest_cost)
        #: 1 / rho, 0 if balanced: with it one infinite rho is harmless.
        source, target = (0.0 if np.isinf(value) else 1.0 / value for value in rho)
        self.inverse_rho = source, target
        self._weigh()
        self._resident: ResidentIteration | None = None
        self._asked = False

    @classmethod
    def between(
        cls,
        operations: Operations,
        source: AnyMeasure,
        target: AnyMeasure,
        rho: tuple[float, float],
        truncation: float | None = None,
        clouds: tuple[Any, Any] | None = None,
    ) -> Self:
        """Return the problem of two measures; they are uploaded unless the backend has `clouds`."""
        a, b = source.weights, target.weights
        largest = largest_cost(corners_of(source), corners_of(target))
        if are_grids(source, target):
            pair: Any = source, target
            of_grids = GridSoftmin(operations, *pair), GridSoftmin(operations, *pair[::-1])
            made = cls(of_grids[0], of_grids[1], rho, largest)
            made._asked = True  # the iteration is the host's
            return made
        rows, columns = clouds or upload_both(operations, source, target)
        one, other = (
            largest + (0.0 if side.offsets is None else float(np.ptp(side.offsets)))
            for side in (source, target)
        )
        return cls(
            Softmin(operations, rows, columns, (a, b), truncation),
            Softmin(operations, columns, rows, (b, a), truncation),
            rho, largest, oscillations=(one, other),
        )  # fmt: skip

    def with_truncation(self, truncation: float | None) -> "Problem":
        """Return this problem with its clouds; its softmins choose near pairs of their own."""
        one, other = (
            Softmin(self.operations, of.rows, of.columns, of.weights, truncation)
            for of in self.softmins
        )
        same = self.rho, self.largest_cost, self.reductions, self.oscillations
        return Problem(one, other, *same)

    def _weigh(self) -> None:
        """Compute what follows from the masses."""
        with np.errstate(divide="ignore"):
            self.logarithms = np.log(self.a), np.log(self.b)
        self.masses = self.of_rows.sum(self.a), self.of_columns.sum(self.b)

    @property
    def softmins(self) -> tuple[Any, Any]:
        """The operators that compute T(g) and T(f)."""
        return self.to_rows, self.to_columns

    @property
    def truncation(self) -> float | None:
        """Nats by which a log-sum-exp may be too small; None if all pairs are summed."""
        return self.to_rows.truncation

    @property
    def top_blur(self) -> Any:
        """The blur below which the annealing begins, by the largest cost."""
        return TOP * np.sqrt(2 * self.largest_cost)

    def farthest(self, f: Any) -> Any:
        """Return how far potentials have moved in this region, cost units; 0 without a region."""
        return 0.0

    def damping(self, epsilon: float) -> tuple[float, float]:
        """Return Delta = rho / (rho + epsilon) of both sides (math: damping)."""
        source, target = (1.0 / (1.0 + epsilon * inverse) for inverse in self.inverse_rho)
        return source, target

    def softmin(
        self, side: int, old: Array, epsilon: float, precise: bool, bounded: bool = False
    ) -> Array:
        """Return T(g), (N,), for side 0, or T(f), (M,), for side 1; flags as in `Softmin`."""
        return self.softmins[side](old, epsilon, precise, bounded or self.exact_sums)

    @property
    def left_out(self) -> float:
        """Nats by which pairs left out can make the sums of the last softmins too small."""
        return max(each.left_out for each in self.softmins)

    @property
    def error(self) -> float:
        """Bound, in nats, of all errors in the sums of the last softmins, if they are bounded."""
        return max(each.left_out + each.roundoff for each in self.softmins)

    @property
    def visited(self) -> float:
        """Share of all pairs that the last softmins summed, as a mean over both softmins."""
        return 0.5 * (self.to_rows.visited + self.to_columns.visited)

    def rounding(self, epsilon: float, precise: bool) -> Any:
        """Return the largest effect of rounding on a softmin, in nats."""
        kind = self.largest_cost, epsilon, precise, self.exact_sums
        return self.of_rows.larger(*(each.rounding(*kind) for each in self.softmins))

    def dual_rounding(self, epsilon: float, precise: bool) -> Any:
        """Return the rounding that each penalty of the dual may have; it is small in `slack`."""
        return DUAL_SHARE * SLACK * ROUNDING_MARGIN * self.rounding(epsilon, precise)

    def slack(self, floor: Any, rounding: Any, mass: Any, epsilon: float) -> Any:
        """Return by how much rounding and truncation can make a dual seem to be below `floor`."""
        slack = 1e-12 * abs(floor) + SLACK * rounding * epsilon * mass
        return slack + self.left_out * epsilon * mass

    def needs_more(self, precision: str, epsilon: float, tol: float) -> Any:
        """Return whether a tolerance needs more than float32, and `precision` allows it."""
        if precision != "auto":
            return precision == "float64"
        if self.operations.exponent_roundoff == self.operations.precise_roundoff:
            return True
        return self.rounding(epsilon, precise=False) > 0.25 * tol

    def half_step(
        self, side: int, old: Array, softmin: Array, epsilon: float, before: Any = None
    ) -> HalfStep:
        """Maximize the dual over f (side 0), or g (1), and a shift s of the other, given T(old).

        The new potential is Delta T(old + s) for every s (paper, 3.1). At the best s, <a, exp(-f /
        rho)> and <b, exp(-g / rho)> are both the mass of the plan (math: translation invariance);
        `before` is the logarithm of this sum before the shift, if known. Source of the idea:
        Séjourné, Vialard, Peyré, "Faster unbalanced optimal transport" (2022), Algorithm 1.
        """
        # 1 / (rho + epsilon) and 1 / rho: 0 if balanced
        damping = self.damping(epsilon)[side]
        new_rate, old_rate = self.inverse_rho[side] * damping, self.inverse_rho[1 - side]
        own, other = self.reductions[side], self.reductions[1 - side]
        if new_rate + old_rate == 0.0:
            return HalfStep(softmin, old, softmin, np.log(self.masses[side]))
        logarithms = self.logarithms
        if before is None:
            before = log_sum_exp(other, logarithms[1 - side] - old * old_rate)
        after = log_sum_exp(own, logarithms[side] - softmin * new_rate)
        s = (before - after) / (new_rate + old_rate)
        softmin = softmin - own.spread(s)
        log_mass = after + s * new_rate
        return HalfStep(damping * softmin, old + other.spread(s), softmin, log_mass)

    def start_iteration(self) -> ResidentIteration | None:
        """Return the device's iteration over all pairs, if the backend has it."""
        if self.exact_sums:
            return None
        if self.truncation is None and not self._asked:
            self._resident = self.operations.start_iteration(
                self.rows, self.columns, (self.a, self.b), self.inverse_rho, self.corrections
            )
            self._asked = True
        return self._resident

    def bounded_softmins(self, f: Array, g: Array, epsilon: float) -> tuple[Array, Array]:
        """Return T(g) and T(f); `left_out` and `roundoff` of both softmins bound their errors."""
        t_rows = self.to_rows(g, epsilon, bounded=True)
        if self.to_columns is self.to_rows and f is g:
            return t_rows, t_rows
        return t_rows, self.to_columns(f, epsilon, bounded=True)

    def measured(self, f: Array, g: Array, epsilon: float) -> State:
        """Return potentials with their softmins and a residual that includes its rounding."""
        softmins = self.bounded_softmins(f, g, epsilon)
        return State(f, g, *softmins, self.residual(f, g, *softmins, epsilon))

    def settle(self, residual: Any) -> None:
        """Let the softmins know the residual that was reached; see `Softmin.settle`."""
        for each in self.softmins:
            each.settle(residual)

    def residual(self, f: Array, g: Array, t_rows: Array, t_columns: Array, epsilon: float) -> Any:
        """Return max(|f - Delta T(g)|, |g - Delta T(f)|) / epsilon over points of positive mass.

        (math: residual) The softmins must be the last ones: what they left out is part of
        the result, and after `bounded_softmins` so is their rounding.
        """
        residuals = []
        sides = self._sides(f, g, t_rows, t_columns)
        for side, damping, of in zip(sides, self.damping(epsilon), self.reductions, strict=True):
            potential, softmin, massive = side.potential, side.softmin, side.weights > 0
            # Pairs left out can only make the sums behind the softmins smaller.
            residual = largest_size(of, potential - damping * softmin, massive) / epsilon
            residual = residual + side.left_out
            if np.any(side.roundoff):
                size = largest_size(of, potential, massive) + largest_size(of, softmin, massive)
                residual = residual + side.roundoff + STEPS_ERROR * size / epsilon
            residuals.append(residual)
        return self.of_rows.larger(*residuals)

    def marginal(self, side: int, potential: Array, softmin: Array, epsilon: float) -> Array:
        """Return a marginal of the plan of (f, g), given T of the other (math: plan, Eq. 2)."""
        weights = self.a if side == 0 else self.b
        return marginal(weights, self.logarithms[side], potential, softmin, epsilon)

    def dual(self, f: Array, g: Array, plan_mass: Any, epsilon: float, enough: Any = 0.0) -> Any:
        """Return D(f, g) without its constant epsilon m_a m_b, given its plan's mass (paper, 2.1).

        `enough` is the rounding that each penalty may have, in units of epsilon times the plan's
        mass. If it is not 0, f and g must be those of a `HalfStep`, where <a, exp(-f / rho)> is the
        mass of the plan and needs no sum if that is exact enough.
        """
        value = -epsilon * plan_mass
        of: Any
        sides = self.reductions, (f, g), (self.a, self.b), self.inverse_rho
        for side, (of, potential, weights, inverse) in enumerate(zip(*sides, strict=True)):
            if not inverse:
                value = value + of.inner(weights, potential)
            else:
                closed: Any = np.False_
                if np.any(enough):
                    closed = self.has_closed_form(side, plan_mass, epsilon, enough)
                part = (self.masses[side] - plan_mass) / inverse
                if not np.all(closed):
                    # rho (1 - exp(-f / rho)), without the cancellation at large rho
                    scaled = np.minimum(-potential * inverse, MAX_EXPONENT)
                    summed = -of.inner(weights, np.expm1(scaled)) / inverse
                    part = of.choose(closed, part, summed)
                value = value + part
        return value

    def has_closed_form(
        self,
        side: int,
        plan_mass: Any,
        epsilon: float,
        enough: Any,
        rounding: float = MASS_ROUNDING,
    ) -> Any:
        """Return whether a penalty of the dual has enough digits as a difference of masses."""
        total = self.masses[side] + plan_mass
        return rounding * total <= enough * epsilon * plan_mass * self.inverse_rho[side]

    def certificate(
        self, f: Array, g: Array, t_rows: Array, t_columns: Array, epsilon: float
    ) -> Certificate:
        """Return the certificate of (f, g), given `bounded_softmins` computed last."""
        rows, columns = self._sides(f, g, t_rows, t_columns)
        return certify(rows, columns, epsilon)

    def _sides(self, f: Array, g: Array, t_rows: Array, t_columns: Array) -> list[Side]:
        return [
            Side(weights, logarithms, potential, softmin, inverse, to.left_out, to.roundoff, across)
            for weights, logarithms, potential, softmin, inverse, to, across in zip(
                (self.a, self.b), self.logarithms, (f, g), (t_rows, t_columns), self.inverse_rho,
                self.softmins, self.oscillations, strict=True,
            )
        ]  # fmt: skip


def uploaded(operations: Operations, measure: AnyMeasure) -> Any:
    """Return a measure as a cloud in the backend's memory."""
    return operations.upload(measure.points, measure.weights, measure.offsets)


def upload_both(operations: Operations, source: AnyMeasure, target: AnyMeasure) -> tuple[Any, Any]:
    """Return two measures as clouds in the backend's memory: one cloud if they are the same."""
    upload = functools.partial(uploaded, operations)
    sides = [source] if target is source else [source, target]
    if len(source) + len(target) < MANY_POINTS:
        clouds = list(map(upload, sides))
    else:
        with ThreadPoolExecutor(len(sides)) as pool:
            clouds = list(pool.map(upload, sides))
    return clouds[0], clouds[-1]


def largest_cost(x: Array, y: Array) -> float:
    """Return a bound of the cost |X - Y|^2 / 2, from the joint bounding box (paper, Eq. 1)."""
    corners = np.concatenate([boxes_of_runs(each)[:, 0] for each in (x, y)])
    low, high = boxes_of_runs(corners)[:, 0]
    return float(cost_across(low, high))


def cost_across(low: Array, high: Array) -> Any:
    """Return the cost |X - Y|^2 / 2 of opposite corners of boxes, (..., D) arrays."""
    return 0.5 * np.sum((high - low) ** 2, axis=-1)


def is_large(pair: Pair, operations: Operations | None = None) -> bool:
    """Return whether a problem is solved through coarser ones, with truncated sums."""
    if are_grids(*pair) or dimension_of(pair[0]) > FEW_DIMENSIONS:
        return False
    return len(pair[0]) * len(pair[1]) >= many_pairs(operations)


def choose_truncation(truncation: Any, tol: float, many: bool) -> float | None:
    """Return the truncation in nats, see `sinkhorn`; None leaves out nothing."""
    if isinstance(truncation, str) and truncation == "auto":
        return 0.1 * tol if many else None
    if truncation is None:
        return None
    limit = check_number("truncation", truncation, 1e-9, 0.1)
    if limit >= tol:
        raise InputError(
            f"truncation={shown(truncation)}: it is part of the residual, so expected less than "
            f"tol={tol:g}; lower it (a tenth of tol is usual) or raise tol"
        )
    return limit


def check_problem(pair: Pair, given: Goal, operations: Operations) -> None:
    """Check that a problem has a solution, which a backend can compute to the tolerance."""
    (source, target), tol = pair, given.tol
    balanced = all(np.isinf(rho) for rho in given.rho)
    differ = abs(source.mass - target.mass) / source.mass if balanced else 0.0
    # No residual is smaller than the difference.
    if differ > min(MASS_TOLERANCE, 0.5 * tol):
        possible = "impossible" if differ > MASS_TOLERANCE else f"not possible to tol={tol:g}"
        raise InputError(
            f"the masses {source.mass:g} and {target.mass:g} differ by {differ:.1e} of the first, "
            f"so balanced transport is {possible}: give a reach, or scale the weights to one mass"
        )
    largest = largest_cost(corners_of(source), corners_of(target))
    if largest > operations.max_spread * given.epsilon:
        enough = 1.1 * np.sqrt(largest / operations.max_spread)  # the message rounds this
        other = ", or use backend='numpy'" if largest <= MAX_SPREAD * given.epsilon else ""
        raise InputError(
            f"blur={given.blur:g} is too small for points up to {np.sqrt(2 * largest):.3g} apart"
            f"{' on this device' if other else ''}: expected at least {enough:.2g}; raise it, or "
            f"scale the points{other}"
        )
    for rho in given.rho:
        if np.isfinite(rho) and rho > MAX_SPREAD * given.epsilon:
            raise InputError(
                f"reach={rho**0.5:g} is too large for blur={given.blur:g}: expected at most "
                f"{np.sqrt(MAX_SPREAD) * given.blur:g}, or None (balanced) for equal masses"
            )
    if given.precision == "float64" and not operations.has_float64:
        raise DeviceError(
            f"precision='float64': {operations.description} has no double precision; use "
            "'auto' (pairs of float32 where needed), another device, or the backend 'numpy'"
        )
