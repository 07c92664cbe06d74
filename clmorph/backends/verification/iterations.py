"""Checks of iterations on the device, by the definitions of what they compute.

The formulas of the solver stand elsewhere, so nothing of them is used here: a shift is found by
bisection, the dual is summed over its terms, and an extrapolation is a least-squares solution.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from clmorph.backends.comparison import Finding
from clmorph.backends.records import Float64, IterationNumbers
from clmorph.backends.verification.clouds import CloudCase

#: Penalties of the marginals in units of epsilon.
STRENGTHS = 30.0, 12.0
#: Share of the remaining residual that an extrapolation adds.
MIXING = 1.5
#: Errors of potentials and of the dual may be so many times that of a softmin, as they pass on the
#: errors of the softmins before them. Without damping an extrapolation enlarges errors.
PLAIN, UNDAMPED = 6.0, 200.0
#: A trust region that limits no extrapolation, and one that limits each.
WIDE, NARROW = 1e9, 1.0


class _Step(NamedTuple):
    """What an iteration from one potential g leads to, in float64."""

    f: Float64
    image: Float64
    mass: float
    row_dual: float
    residual: float
    column_dual: float
    column_mass: Float64


def check_iteration(case: CloudCase, balanced: int) -> Iterator[Finding]:
    """Compare iterations with their definitions, extrapolated and taken back.

    Nothing is compared where the host iterates, whose arithmetic is NumPy's.

    Parameters
    ----------
    case : CloudCase
    balanced : int
        1 if the source is balanced, plus 2 if the target is.

    Yields
    ------
    Finding
    """
    epsilon = case.epsilon
    rho = [
        np.inf if balanced >> side & 1 else strength * epsilon
        for side, strength in enumerate(STRENGTHS)
    ]
    inverse_rho = tuple(0.0 if np.isinf(each) else 1.0 / each for each in rho)
    iteration = case.operations.start_iteration(
        *case.ours, (case.rows[1], case.columns[1]), (inverse_rho[0], inverse_rho[1])
    )
    name = f"start_iteration{case.name}, balanced {balanced}"
    if iteration is None:
        return
    iteration.set_potential(case.g, epsilon, False)
    tolerances = [case.tolerance() * factor for factor in (PLAIN, UNDAMPED)]
    later = tolerances[balanced == 3]
    x, stored, previous = case.g, 0, None
    ahead: list[Float64] = []
    differences: list[Float64] = []
    for number in range(4):
        radius = NARROW if number == 2 else WIDE
        got = iteration.iterate(number > 0, max(number - 1, 0), stored, radius)
        f, g, _ = iteration.potentials()
        want = _step(case, x, rho)
        allowed = tolerances[0] if number < 2 else later
        yield Finding(f"{name}, step {number}", _excess(case, want, got, f, g), allowed, "nats")
        residual = want.image - x
        if previous is None:
            weights = want.column_mass
        else:
            differences.append(residual - previous[1])
            ahead.append(want.image - previous[0] + (MIXING - 1) * differences[-1])
        previous = want.image, residual
        guess = _guess(want, residual, ahead, differences, weights, radius)
        if guess is not None and balanced == 3:
            guess -= want.column_mass @ (guess - want.image) / want.column_mass.sum()
        yield Finding(
            f"{name}, guess {number}", float(got.extrapolated != (guess is not None)), 0.5, "wrong"
        )
        iteration.go_on(guess is not None)
        x, stored = want.image if guess is None else guess, stored + 1
    # The last iterate is dropped, as if its dual were too small.
    iteration.iterate(False, 0, 0, WIDE)
    iteration.go_back()
    got = iteration.iterate(False, 0, 0, WIDE)
    f, g, _ = iteration.potentials()
    assert previous is not None
    want = _step(case, previous[0], rho)
    yield Finding(f"{name}, taken back", _excess(case, want, got, f, g), later, "nats")


def _excess(case: CloudCase, want: _Step, got: IterationNumbers, f: Float64, g: Float64) -> float:
    """Return the largest error in nats; duals and masses count relative to the mass."""
    epsilon = case.epsilon
    pairs = [
        (got.mass, want.mass, want.mass),
        (got.row_dual, want.row_dual, epsilon * want.mass),
        (got.column_dual, want.column_dual, epsilon * want.mass),
        (got.residual, want.residual, 1.0),
    ]
    errors = [abs(one - other) / size for one, other, size in pairs]
    errors += [
        float(np.abs(one - other).max()) / epsilon for one, other in ((f, want.f), (g, want.image))
    ]
    return max(errors) if got.finite else np.inf


def _step(case: CloudCase, g: Float64, rho: list[float]) -> _Step:
    """Return what an iteration from g leads to."""
    exact, (x, y), epsilon = case.exact, case.theirs, case.epsilon
    masses = case.rows[1], case.columns[1]
    dampings = [1.0 if np.isinf(each) else each / (each + epsilon) for each in rho]
    softmin = exact.softmin(x, y, g, epsilon)
    s = _shift(masses, rho, (dampings[0], g), softmin, epsilon)
    t_rows, shifted = softmin - s, g + s
    f = dampings[0] * t_rows
    mass = float(np.sum(masses[0] * np.exp((f - t_rows) / epsilon)))
    row_dual = _dual(masses, rho, (f, shifted), mass, epsilon)
    softmin = exact.softmin(y, x, f, epsilon)
    off = np.abs(shifted - dampings[1] * softmin)[masses[1] > 0].max()
    off = max(off, np.abs(f - dampings[0] * t_rows)[masses[0] > 0].max())
    s = _shift(masses[::-1], rho[::-1], (dampings[1], f), softmin, epsilon)
    t_columns, f = softmin - s, f + s
    image = dampings[1] * t_columns
    column_mass = masses[1] * np.exp((image - t_columns) / epsilon)
    dual = _dual(masses, rho, (f, image), float(column_mass.sum()), epsilon)
    return _Step(f, image, mass, row_dual, float(off) / epsilon, dual, column_mass)


def _shift(
    masses: tuple[Float64, ...],
    rho: list[float],
    other: tuple[float, Float64],
    softmin: Float64,
    epsilon: float,
) -> float:
    """Return the s at which the dual no longer grows, by bisection.

    There the plan has as much mass as the marginal of the potential that is shifted.
    """
    if np.isinf(rho[0]) and np.isinf(rho[1]):
        return 0.0
    damping, potential = other

    def missing(s: float) -> float:
        t = softmin - s
        mass = np.sum(masses[0] * np.exp((damping - 1) * t / epsilon))
        wanted = 1.0 if np.isinf(rho[1]) else np.exp(-(potential + s) / rho[1])
        return float(np.sum(masses[1] * wanted) - mass)

    low, high = -1e3 * epsilon, 1e3 * epsilon
    for _ in range(80):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if missing(middle) > 0 else (low, middle)
    return 0.5 * (low + high)


def _dual(
    masses: tuple[Float64, ...], rho: list[float], potentials: tuple[Float64, Float64],
    mass: float, epsilon: float,
) -> float:  # fmt: skip
    """Return the dual without its constant (paper, 2.1)."""
    value = -epsilon * mass
    for weights, each, potential in zip(masses, rho, potentials, strict=True):
        gains = potential if np.isinf(each) else each * (1 - np.exp(-potential / each))
        value += float(np.sum(weights * gains))
    return value


def _guess(
    step: _Step,
    residual: Float64,
    ahead: list[Float64],
    differences: list[Float64],
    weights: Float64,
    radius: float,
) -> Float64 | None:
    """Return the next iterate by least squares; None if none is determined."""
    if not differences:
        return None
    root = np.sqrt(weights)
    factors = np.linalg.lstsq((np.array(differences) * root).T, residual * root, rcond=None)[0]
    moved = (MIXING - 1) * residual - factors @ np.array(ahead)
    longest = radius * float(np.linalg.norm(root * residual))
    length = float(np.linalg.norm(root * moved))
    return np.asarray(step.image + min(1.0, longest / length) * moved)
