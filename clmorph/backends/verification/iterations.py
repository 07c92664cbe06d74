"""Checks of iterations on the device, by the definitions of what they compute.

The formulas of the solver stand elsewhere, so nothing of them is used here: a shift is found by
bisection, the dual is summed over its terms, and an extrapolation is a least-squares solution.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clmorph.backends.comparison import Finding
from clmorph.backends.records import Float64, IterationNumbers, ResidentIteration, StoredVectors
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


class _Started(NamedTuple):
    """An iteration on the device, and the problem that it iterates, in the caller's order."""

    iteration: ResidentIteration
    masses: tuple[Float64, Float64]
    corrections: tuple[Float64, Float64]  #: of both softmins
    orders: tuple[NDArray[np.intp], NDArray[np.intp]]  #: of the iteration's vectors
    center: Float64 | None  #: of the trust region

    def potentials(self) -> tuple[Float64, Float64]:
        """Return f and the image of g after the last iteration."""
        found = []
        for order, values in zip(self.orders, self.iteration.potentials()[:2], strict=True):
            found.append(np.empty_like(values))
            found[-1][order] = values
        return found[0], found[1]


class _Step(NamedTuple):
    """What an iteration from one potential g leads to, in float64."""

    f: Float64
    image: Float64
    mass: float
    row_dual: float
    residual: float
    column_dual: float
    column_mass: Float64


def check_iteration(case: CloudCase, balanced: int, over_stored: bool = False) -> Iterator[Finding]:
    """Compare iterations with their definitions, extrapolated and taken back.

    `balanced` is 1 if the source is balanced, plus 2 if the target is. Nothing is compared where
    the host iterates, whose arithmetic is NumPy's. With `over_stored` it iterates over stored
    pairs, with corrections of the softmins.
    """
    epsilon = case.epsilon
    rho = [
        np.inf if balanced >> side & 1 else strength * epsilon
        for side, strength in enumerate(STRENGTHS)
    ]
    inverse_rho = tuple(0.0 if np.isinf(each) else 1.0 / each for each in rho)
    start = _start_stored if over_stored else _start
    started = start(case, (inverse_rho[0], inverse_rho[1]))
    if started is None:
        return
    name = f"start_{'stored_' * over_stored}iteration{case.name}, balanced {balanced}"
    iteration = started.iteration
    iteration.set_potential(case.g[started.orders[1]], epsilon, False)
    tolerances = [(1 + over_stored) * case.tolerance() * factor for factor in (PLAIN, UNDAMPED)]
    later = tolerances[balanced == 3]
    x, stored, previous = case.g, 0, None
    ahead: list[Float64] = []
    differences: list[Float64] = []
    for number in range(4):
        radius = NARROW if number == 2 else WIDE
        got = iteration.iterate(number > 0, max(number - 1, 0), stored, radius)
        f, g = started.potentials()
        want = _step(case, started, x, rho)
        allowed = tolerances[0] if number < 2 else later
        off = _excess(case, started, want, got, f, g)
        yield Finding(f"{name}, step {number}", off, allowed, "nats")
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
    f, g = started.potentials()
    assert previous is not None
    want = _step(case, started, previous[0], rho)
    yield Finding(f"{name}, taken back", _excess(case, started, want, got, f, g), later, "nats")


def _start(case: CloudCase, inverse_rho: tuple[float, float]) -> _Started | None:
    """Start an iteration over all pairs."""
    masses = case.rows[1], case.columns[1]
    iteration = case.operations.start_iteration(*case.ours, masses, inverse_rho)
    if iteration is None:
        return None
    sizes = len(masses[0]), len(masses[1])
    none, orders = (np.zeros(sizes[0]), np.zeros(sizes[1])), tuple(map(np.arange, sizes))
    return _Started(iteration, masses, none, (orders[0], orders[1]), None)


def _start_stored(case: CloudCase, inverse_rho: tuple[float, float]) -> _Started | None:
    """Start an iteration over stored pairs, which are all pairs but those of no mass at all."""
    epsilon, own = case.epsilon, (case.rows[1], case.columns[1])
    sizes = len(own[0]), len(own[1])
    stored = case.operations.store_pairs(
        *case.ours, case.f, case.g, epsilon, np.full(sizes[0], -1e3), np.full(sizes[1], -1e3),
        sizes[0] * sizes[1],
    )  # fmt: skip
    assert stored is not None, "the pairs were not stored"
    rng = np.random.default_rng(5)
    corrections = [epsilon * rng.uniform(-1, 1, size) for size in sizes]
    center = case.f + epsilon * rng.uniform(-3, 3, sizes[0])
    masses = [mass * np.exp(each / epsilon) for mass, each in zip(own, corrections, strict=True)]
    potentials = case.f, case.g
    softmins = case.softmin, case.exact.softmin(*case.theirs[::-1], case.f, epsilon)
    vectors = []
    for side, order in enumerate(stored.orders):
        with np.errstate(divide="ignore"):
            base = potentials[side] + epsilon * np.log(own[side]) + corrections[side]
        alone = softmins[side] + corrections[side]
        of_side = masses[side], base, alone, potentials[side]
        vectors.append(StoredVectors(*(each[order] for each in of_side)))
    iteration = case.operations.start_stored_iteration(
        stored, (vectors[0], vectors[1]), center[stored.orders[0]], inverse_rho
    )
    if iteration is None:
        return None
    return _Started(
        iteration, (masses[0], masses[1]), (corrections[0], corrections[1]), stored.orders, center
    )


def _excess(
    case: CloudCase,
    started: _Started,
    want: _Step,
    got: IterationNumbers,
    f: Float64,
    g: Float64,
) -> float:
    """Return the largest error in nats; duals and masses count relative to the mass."""
    epsilon = case.epsilon
    pairs = [
        (got.mass, want.mass, want.mass),
        (got.row_dual, want.row_dual, epsilon * want.mass),
        (got.column_dual, want.column_dual, epsilon * want.mass),
        (got.residual, want.residual, 1.0),
    ]
    if started.center is not None:
        massive, masses = started.masses[0] > 0, started.masses[0]
        moved = np.where(massive, want.f - started.center, 0.0)
        moved -= masses @ moved / masses.sum()
        pairs.append((got.moved, float(np.abs(moved[massive]).max()), epsilon))
    errors = [abs(one - other) / size for one, other, size in pairs]
    for one, other, mass in zip((f, g), (want.f, want.image), started.masses, strict=True):
        # Points without mass have no stored pairs: their softmins stay what they were.
        counts = np.full(len(mass), started.center is None) | (mass > 0)
        errors.append(float(np.abs(one - other)[counts].max()) / epsilon)
    return max(errors) if got.finite else np.inf


def _step(case: CloudCase, started: _Started, g: Float64, rho: list[float]) -> _Step:
    """Return what an iteration from g leads to."""
    exact, (x, y), epsilon = case.exact, case.theirs, case.epsilon
    masses, corrections = started.masses, started.corrections
    dampings = [1.0 if np.isinf(each) else each / (each + epsilon) for each in rho]
    softmin = exact.softmin(x, y, g, epsilon) + corrections[0]
    s = _shift(masses, rho, (dampings[0], g), softmin, epsilon)
    t_rows, shifted = softmin - s, g + s
    f = dampings[0] * t_rows
    mass = float(np.sum(masses[0] * np.exp((f - t_rows) / epsilon)))
    row_dual = _dual(masses, rho, (f, shifted), mass, epsilon)
    softmin = exact.softmin(y, x, f, epsilon) + corrections[1]
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
    """Return the s at which the dual no longer grows, by bisection."""
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
