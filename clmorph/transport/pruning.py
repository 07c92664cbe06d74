"""The rule that selects the kept pairs of a transport plan (paper, 3.1).

The paper keeps the pairs with log pi_ij > tau = -13. This threshold is absolute: between two images
of N pixels log pi_ij falls as log(1 / N^2), so a tau that drops little of small images drops all of
large ones. The default is therefore relative to the largest pair of a row or a column.
"""

from __future__ import annotations

import numpy as np

from clmorph._shared.typing import Array, BoolArray
from clmorph.backends.records import PlanRows
from clmorph.errors import InputError
from clmorph.measures.points import AnyMeasure
from clmorph.transport.potentials import Potentials

#: Pairs within this many rounding errors of the threshold are decided in float64.
ROUNDINGS = 4.0
#: Relative rounding of float32, in which devices store log pi_ij of a pair.
FLOAT32 = float(np.finfo(np.float32).eps)
#: The remedy for a threshold that keeps no pairs or too few, for error messages.
REMEDY = (
    "lower it, or keep pairs relative to the largest ones (None; in the command line "
    "'relative'); the paper's -13 is for images of about 48 pixels"
)


def check_reachable(log_threshold: float, source: AnyMeasure, target: AnyMeasure) -> None:
    """Check before the solve that a pair of the plan can exceed the threshold.

    At the optimum r_i = a_i e^(-f_i / rho_1) and c_j = b_j e^(-g_j / rho_2) are the plan's
    marginals, and pi_ij is at most each of them. If f_i + g_j <= 0, then pi_ij <= a_i b_j by Eq. 2,
    as costs are not negative. Otherwise pi_ij is at most the mean r_i^s c_j^(1 - s) with s = rho_1
    / (rho_1 + rho_2), which is a_i^s b_j^(1 - s) e^(-(f_i + g_j) / (rho_1 + rho_2)), and that is
    less than the larger of a_i and b_j.

    source, target: the measures between which the plan is built.
    """
    log_a, log_b = (float(_log(measure.weights).max()) for measure in (source, target))
    largest = max(log_a, log_b, log_a + log_b)
    if largest <= log_threshold:
        raise InputError(
            f"log_threshold={log_threshold:g}: no pair between {len(source)} and {len(target)} "
            f"points can exceed it, log pi is below {largest:.4g}; {REMEDY}"
        )


def no_pair_kept(log_threshold: float, largest: float) -> InputError:
    """Return the error which reports that a plan has no pair above the threshold."""
    return InputError(
        f"log_threshold={log_threshold:g}: no pair of the plan exceeds it, the largest log pi is "
        f"{largest:.4g}; {REMEDY}"
    )


def undecided(log_threshold: float, rounding: float) -> float:
    """Return a bound of the error of a device's log pi_ij near the threshold, in nats."""
    return ROUNDINGS * (rounding + FLOAT32 * max(1.0, abs(log_threshold)))


def strictly_above(
    pairs: PlanRows,
    source: AnyMeasure,
    target: AnyMeasure,
    potentials: Potentials,
    log_threshold: float,
    margin: float,
) -> PlanRows:
    """Drop pairs not above the threshold in float64, so that a device's rounding has no effect.

    `pairs` are all above `log_threshold - margin` (nats, see `undecided`) as a device computed
    them; those this near to the threshold are computed again.
    """
    log_mass = _log(pairs.mass)
    keep = log_mass > log_threshold
    near = np.flatnonzero(np.abs(log_mass - log_threshold) <= margin)
    i = np.searchsorted(pairs.indptr, near, side="right") - 1
    j = pairs.indices[near]
    cost = 0.5 * np.sum((source.points[i] - target.points[j]) ** 2, axis=1)
    for measure, index in ((source, i), (target, j)):
        if measure.offsets is not None:
            cost += measure.offsets[index]
    log_plan = (potentials.f[i] + potentials.g[j] - cost) / potentials.epsilon
    log_plan += _log(source.weights[i]) + _log(target.weights[j])
    keep[near] = log_plan > log_threshold
    return only(pairs, keep)


def only(pairs: PlanRows, keep: BoolArray) -> PlanRows:
    """Return some of the pairs."""
    before = np.concatenate(([0], np.cumsum(keep, dtype=np.int64)))
    return PlanRows(before[pairs.indptr], pairs.indices[keep], pairs.mass[keep])


def _log(masses: Array) -> Array:
    with np.errstate(divide="ignore"):
        return np.log(masses)
