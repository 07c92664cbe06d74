"""The arithmetic between two softmins of an iteration, on the host.

``cl_kernels/half_steps.cl`` and ``sparse_half_steps.cl`` do the same on a device.
"""

from typing import Any, NamedTuple

import numpy as np

from clmorph.backends.interface import MAX_EXPONENT
from clmorph.transport._solver.problem import Problem


class RowStep(NamedTuple):
    """Potentials after the half-step of f, with T(g) at the shifted g, and the dual there."""

    f: Any
    g: Any
    t_rows: Any
    mass: Any  #: of the plan
    dual: Any
    log_mass: Any = None  #: logarithm of the mass; None if it must be summed


class ColumnStep(NamedTuple):
    """Potentials after the half-step of g, with T(f), and the residual before it."""

    f: Any
    image: Any
    t_columns: Any
    residual: Any
    mass: Any  #: of each column of the plan, (M,)
    dual: Any


def row_step(problem: Problem, g: Any, softmin: Any, epsilon: Any, enough: Any = 0.0) -> RowStep:
    """Maximize the dual over f and a shift of g, given T(g), (N,) (paper, 3.1)."""
    f, g_shifted, t_rows, log_mass = problem.half_step(0, g, softmin, epsilon)
    of_rows = problem.of_rows
    mass = _exp(log_mass) if np.any(enough) else of_rows.sum(problem.row_mass(f, t_rows, epsilon))
    dual = problem.dual(f, g_shifted, mass, epsilon, enough)
    return RowStep(f, g_shifted, t_rows, mass, dual, log_mass)


def column_step(
    problem: Problem, before: RowStep, softmin: Any, epsilon: Any, enough: Any = 0.0
) -> ColumnStep:
    """Maximize the dual over g and a shift of f, given T(f), (M,) (paper, 3.1)."""
    residual = problem.residual(before.f, before.g, before.t_rows, softmin, epsilon)
    image, f, t_columns, log_mass = problem.half_step(
        1, before.f, softmin, epsilon, before.log_mass
    )
    mass = problem.column_mass(image, t_columns, epsilon)
    plan_mass = _exp(log_mass) if np.any(enough) else problem.of_columns.sum(mass)
    dual = problem.dual(f, image, plan_mass, epsilon, enough)
    return ColumnStep(f, image, t_columns, residual, mass, dual)


def _exp(log_mass: Any) -> Any:
    """Return the mass, with its logarithm limited so that it does not overflow."""
    return np.exp(np.minimum(log_mass, MAX_EXPONENT))


def without_drift(problem: Problem, guess: Any, image: Any, column_mass: Any) -> Any:
    """Return extrapolated potentials, (M,), without the constant that they have added to the image.

    Nothing bounds an extrapolation along a constant, of which balanced potentials are free, and
    at a large one float64 loses the other digits.
    """
    if any(problem.inverse_rho):
        return guess
    of = problem.of_columns
    return guess - of.spread(of.inner(column_mass, guess - image) / of.sum(column_mass))
