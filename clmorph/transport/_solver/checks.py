"""Checks before a problem is solved: its options, and whether it has a solution."""

from typing import Any

import numpy as np

from clmorph._shared.validation import check_number, shown
from clmorph.backends.interface import MAX_SPREAD, Operations
from clmorph.errors import DeviceError, InputError
from clmorph.measures.grid import are_grids
from clmorph.measures.points import Pair, corners_of, dimension_of
from clmorph.transport._solver.problem import largest_cost
from clmorph.transport._solver.softmin import FEW_DIMENSIONS, many_pairs
from clmorph.transport.regularization import Goal

#: Relative difference of masses up to which balanced transport is feasible.
MASS_TOLERANCE = 1e-6


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
