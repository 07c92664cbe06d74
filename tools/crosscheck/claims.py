"""Compare the errors that `clmorph.sinkhorn` reports with the true errors.

A claim is broken only beyond the judge's own error, which is proven and counted in favor of what
was told; there is no other allowance.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from crosscheck.exact import Dense, Truth
from crosscheck.judge import Optimum
from crosscheck.numbers import NUMBER, Interval, Vector

#: By how much rounding may widen the interval, as a share of the value.
WIDENING = 2e-6
#: Logarithm of the smallest and the largest mass that float64 holds to its full precision.
LEAST, MOST = np.log(np.finfo(np.float64).tiny), np.log(np.finfo(np.float64).max)
#: Largest logarithm of a mass that the certificate's exponentials go to.
MOST_MASS = 299.0

#: What is checked, and what its worst figure is.
CHECKS = {
    "answers": "ends with an answer, or with the error that is meant",
    "finite": "potentials and certificate are finite, masses of points without mass are 0",
    "dual <= optimum": "(dual - optimum) / value, broken above 0",
    "optimum <= primal": "(optimum - primal) / value, broken above 0",
    "dual <= D(f, g)": "(dual - D) / value, broken above 0",
    "P(f, g) <= primal": "(P - primal) / value, broken above 0; no balanced side",
    "gap": "(primal - dual) - gap, or the true distance - gap, over value, broken above 0",
    "widening": "(primal - dual) - (P - D) over 2e-6 max(value, epsilon mass), broken above 1",
    "residual": "true residual / residual, broken above 1",
    "converged": "true residual / tol where the status is converged, broken above 1",
    "row_mass": "error in nats / truncation_error, broken above 1",
    "column_mass": "error in nats / truncation_error, broken above 1",
    "transported_mass": "error in nats / truncation_error, broken above 1",
    "marginal_error": "true one / marginal_error, broken above 1; balanced sides",
}


@dataclass(frozen=True)
class Outcome:
    """One claim, held against the truth."""

    check: str
    worst: float
    broken: bool
    words: str = ""


@dataclass(frozen=True)
class Told:
    """A result, what is true of its potentials, and the optimum if the judge solved for it."""

    result: Any
    problem: Dense
    truth: Truth
    optimum: Optimum | None
    tol: float

    @property
    def value(self) -> Any:
        """What differences of values are compared with."""
        size = abs(self.truth.dual.value)
        if self.truth.gap is not None:
            size = max(size, abs(self.truth.dual.value + self.truth.gap.value))
        return max(size, self.problem.epsilon * self.truth.mass.value)

    @property
    def bounds(self) -> tuple[Any, Any]:
        """What the optimum is at least and at most, as the judge knows."""
        truth = self.truth
        low = truth.dual.low
        high = NUMBER(np.inf) if truth.gap is None else truth.dual.high + truth.gap.high
        if self.optimum is not None:
            low, high = max(low, self.optimum.low), min(high, self.optimum.high)
        return low - self._infeasible(), high + self._infeasible()

    def _infeasible(self) -> Any:
        """By how much balanced masses that differ by roundings can change a value.

        The judge's optimum is that of b scaled to the mass of a, by 1 + d. D at any potentials
        differs from that by d (<b, g> - epsilon (mass - m_a m_b)).
        """
        source, target = self.problem.source, self.problem.target
        if not (source.balanced and target.balanced):
            return NUMBER(0)
        masses = source.mass.sum(), target.mass.sum()
        share = abs(masses[0] / masses[1] - 1) + 64 * np.finfo(NUMBER).eps
        g = np.asarray(self.result.g)[target.places]
        moved = (target.mass * np.abs(g)).sum() + self.problem.epsilon * self.truth.mass.high
        return 2 * share * (moved + self.problem.constant)


def check(told: Told) -> Iterator[Outcome]:
    """Compare the errors that a result reports with the true errors.

    Of potentials whose plan has more mass than `MOST_MASS` nothing is promised but the residual.
    """
    result, truth = told.result, told.truth
    if max(float(np.max(truth.rows)), float(np.max(truth.columns))) > MOST_MASS:
        yield _ratio("residual", truth.residual, result.residual)
        return
    finite = _finite(told)
    yield finite
    if finite.broken:
        return
    yield from _values(told)
    yield _ratio("residual", truth.residual, result.residual)
    if result.status == "converged":
        yield _ratio("converged", truth.residual, told.tol)
    nats = result.truncation_error
    yield _masses("row_mass", result.row_mass, told.problem.source.places, truth.rows,
                  truth.rows_slack, nats)  # fmt: skip
    yield _masses("column_mass", result.column_mass, told.problem.target.places, truth.columns,
                  truth.columns_slack, nats)  # fmt: skip
    relative = truth.mass.error / truth.mass.value if truth.mass.value > 0 else NUMBER(0)
    yield _masses("transported_mass", np.array([result.transported_mass]), np.array([0]),
                  np.log(np.array([truth.mass.value])), np.array([2 * relative]), nats)  # fmt: skip
    if told.problem.source.balanced or told.problem.target.balanced:
        yield _ratio("marginal_error", truth.marginal_error, result.marginal_error)


def _finite(told: Told) -> Outcome:
    result = told.result
    names = (
        "f", "g", "dual", "residual", "row_mass", "column_mass", "marginal_error",
        "truncation_error", "transported_mass", "primal", "gap",
    )  # fmt: skip
    numbers = {name: value for name in names if (value := getattr(result, name)) is not None}
    wrong = [name for name, value in numbers.items() if not np.all(np.isfinite(value))]
    for name, side in (("row_mass", told.problem.source), ("column_mass", told.problem.target)):
        empty = np.delete(np.asarray(numbers[name]), side.places)
        if np.any(empty != 0):
            wrong.append(f"{name} of points without mass")
    return Outcome("finite", float(len(wrong)), bool(wrong), ", ".join(wrong))


def _values(told: Told) -> Iterator[Outcome]:
    result, truth, value = told.result, told.truth, told.value
    low, high = told.bounds
    dual = NUMBER(result.dual)
    primal = None if result.primal is None else NUMBER(result.primal)
    balanced = told.problem.source.balanced, told.problem.target.balanced
    if np.isfinite(high):
        yield _excess("dual <= optimum", dual, high, value, "optimum is at most")
    yield _excess("dual <= D(f, g)", dual, truth.dual.high, value, "D(f, g) is at most")
    # Without a bound of the distance a balanced problem's primal claims nothing.
    if primal is None or (all(balanced) and result.gap is None):
        if not any(balanced):
            yield Outcome("optimum <= primal", np.inf, True, "there is no primal")
        if result.gap is not None:
            yield Outcome("gap", np.inf, True, "there is a gap without a primal")
        return
    yield _excess("optimum <= primal", low, primal, value, "optimum is at least", "primal")
    if result.gap is None:
        yield Outcome("gap", np.inf, True, "there is no gap")
        return
    if truth.gap is not None:
        yield _excess("P(f, g) <= primal", truth.dual.low + truth.gap.low, primal, value,
                      "P(f, g) is at least", "primal")  # fmt: skip
    # Their difference, rounded, may be some units of the larger one's last place off.
    gap, last = (
        NUMBER(result.gap),
        4 * np.spacing(max(abs(result.primal), abs(result.dual), 1e-300)),
    )
    distance = max(low - dual, primal - high) if np.isfinite(high) else low - dual
    if abs(primal - dual - gap) > last:
        words = f"{float(gap):.17g}, but primal - dual is {float(primal - dual):.17g}"
        yield Outcome("gap", float(abs(primal - dual - gap) / value), True, words)
    else:
        yield _excess("gap", distance, gap, value, "the optimum is further, at least", "gap")
    if truth.gap is not None and result.truncation is None:
        wider = primal - dual - truth.gap.high
        share = float(wider / (WIDENING * value))
        yield Outcome("widening", share, share > 1, f"the interval is wider than the gap of these "
                      f"potentials by {float(wider / value):.3g} of the value")  # fmt: skip


def widening_of_the_value(told: Told) -> float | None:
    """Return by what share of the value itself the interval is wider than it need be."""
    result, gap = told.result, told.truth.gap
    if gap is None or result.primal is None or result.truncation is not None:
        return None
    wider = NUMBER(result.primal) - NUMBER(result.dual) - gap.high
    size = abs(told.truth.dual.value)
    return float(wider / size) if size > 0 else None


def _excess(
    name: str, lower: Any, upper: Any, value: Any, words: str, what: str = "dual"
) -> Outcome:
    """Hold lower <= upper."""
    excess = float((lower - upper) / value)
    told, true = (upper, lower) if what in ("primal", "gap") else (lower, upper)
    return Outcome(
        name, excess, bool(not lower <= upper),
        f"{what} {float(told):.17g}, {words} {float(true):.17g}, off by {excess:.2g} of the value",
    )  # fmt: skip


def _ratio(name: str, true: Interval, told: float) -> Outcome:
    """Hold true <= told."""
    least = max(true.low, NUMBER(0))
    worst = 0.0 if least == 0 else np.inf if told <= 0 else float(least / NUMBER(told))
    return Outcome(
        name, worst, bool(not least <= told), f"told {told:.4g}, truly at least {float(least):.4g}"
    )


def _masses(
    name: str, told: Any, places: Vector, true: Vector, slack: Vector, nats: float
) -> Outcome:
    """Hold |log told - log true| <= nats; where float64 ends, only that it is about there."""
    given = np.asarray(told, np.float64)[places].astype(NUMBER)
    with np.errstate(divide="ignore"):
        logarithm = np.log(given)
    off = np.abs(logarithm - true) - slack
    # What rounds to a denormal number or to 0 has no logarithm to speak of, nor what overflows.
    off = np.where((true < LEAST + 1) & (logarithm < LEAST + 1), 0, off)
    off = np.where((true > MOST) & (logarithm > MOST - 1), 0, off)
    at = int(np.argmax(off))
    most = max(off[at], NUMBER(0))
    worst = 0.0 if most == 0 else np.inf if nats <= 0 else float(most / NUMBER(nats))
    return Outcome(
        name, worst, bool(most > nats),
        f"point {places[at]}: told {float(given[at]):.8g}, truly {float(np.exp(true[at])):.8g}, "
        f"off by at least {float(most):.3g} nats, truncation_error {nats:.3g}",
    )  # fmt: skip
