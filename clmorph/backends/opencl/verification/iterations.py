"""Checks of iterations on the device, by the definitions of what they compute.

The formulas of the solver stand elsewhere, so nothing of them is used here: a shift is found by
bisection, the dual is summed over its terms, and an extrapolation is a least-squares solution.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from clmorph.backends.opencl.build.variants import KERNELS, Variant
from clmorph.backends.opencl.verification.batches import batch_iterations
from clmorph.backends.opencl.verification.bench import Bench, Clouds, Findings, check
from clmorph.backends.opencl.verification.findings import Finding, largest
from clmorph.backends.records import (
    IMAGE,
    PARITY,
    START,
    Float64,
    IterationNumbers,
    PlanTerms,
    ResidentIteration,
    StoredVectors,
    control_of,
    next_source,
)

#: Points of a side whose loops have more work-groups than a group of 64 has items.
LONG_VECTOR = 5003
#: Penalties of the marginals in units of epsilon.
STRENGTHS = 30.0, 12.0
#: Share of the remaining residual that an extrapolation adds.
MIXING = 1.5
#: Errors of potentials and of the dual may be so many times that of a softmin, as they pass on the
#: errors of the softmins before them. Without damping an extrapolation enlarges errors.
PLAIN, UNDAMPED = 6.0, 200.0
#: A trust region that limits no extrapolation, and one that limits each.
WIDE, NARROW = 1e9, 1.0

Pair = tuple[Float64, Float64]


@check("half_steps.cl", *KERNELS["half_steps.cl"], "log_sum_exp")
def iterations(bench: Bench, variant: Variant) -> Findings:
    """Compare iterations over all pairs, of one problem and of a batch."""
    tiles, long, *lifted = bench.clouds(columns=LONG_VECTOR)
    for case in (tiles, long, *lifted[1:2]):
        for balanced in range(4):
            yield from iterate(case, balanced)
    yield from batch_iterations(bench)


@check("sparse_half_steps.cl", *KERNELS["sparse_half_steps.cl"], *KERNELS["sliced_ellpack.cl"],
       *KERNELS["plan_rows.cl"])  # fmt: skip
def stored_iterations(bench: Bench, variant: Variant) -> Findings:
    """Compare iterations over stored pairs, with corrections of the softmins."""
    most = getattr(getattr(bench.operations, "stored_steps", None), "most_groups", None)
    # Loops of several rounds in two groups, and sums of more groups than a group has items.
    tiles, long, *lifted = bench.clouds(columns=LONG_VECTOR)
    for case, groups in ((tiles, 2), (long, most), *((case, most) for case in lifted[1:2])):
        with bench.forced("stored_steps", "most_groups", groups):
            for balanced in range(4):
                yield from iterate(case, balanced, True)


class _Problem(NamedTuple):
    """What is iterated, in the caller's order; from the first side to the second one."""

    case: Clouds
    masses: tuple[Float64, ...]
    corrections: tuple[Float64, ...]  #: of both softmins
    rho: tuple[float, ...]
    center: Float64 | None = None  #: of the trust region

    @property
    def rates(self) -> tuple[float, ...]:
        """1 / rho of both sides."""
        return tuple(0.0 if np.isinf(each) else 1.0 / each for each in self.rho)

    def damping(self, side: int) -> float:
        """Return rho / (rho + epsilon)."""
        return 1.0 / (1.0 + self.case.epsilon * self.rates[side])

    def half_step(self, side: int, other: Float64) -> tuple[Float64, Float64, Float64, Float64]:
        """Return a side's potential, softmin, the other shifted, masses; by bisection."""
        case, epsilon, damping = self.case, self.case.epsilon, self.damping(side)
        clouds = case.theirs if side == 0 else case.theirs[::-1]
        softmin = case.exact.softmin(*clouds, other, epsilon) + self.corrections[side]
        own, rate = self.masses[side], self.rates[1 - side]

        def masses(s: float) -> Float64:
            return own * np.exp((damping - 1) * (softmin - s) / epsilon)

        low, high = -1e3 * epsilon, 1e3 * epsilon
        for _ in range(80):
            middle = 0.5 * (low + high)
            wanted = self.masses[1 - side] @ np.exp(-rate * (other + middle))
            low, high = (middle, high) if wanted > masses(middle).sum() else (low, middle)
        s = 0.0 if not any(self.rates) else 0.5 * (low + high)
        return damping * (softmin - s), softmin, other + s, masses(s)

    def dual(self, potentials: Pair, mass: float) -> float:
        """Return the dual without its constant (paper, 2.1)."""
        value = -self.case.epsilon * mass
        for weights, rate, potential in zip(self.masses, self.rates, potentials, strict=True):
            gains = potential if rate == 0 else (1 - np.exp(-potential * rate)) / rate
            value += float(weights @ gains)
        return value


class _Step(NamedTuple):
    """What an iteration from one potential g leads to, in float64."""

    f: Float64
    image: Float64
    mass: float
    row_dual: float
    residual: float
    column_dual: float
    column_mass: Float64


def _step(problem: _Problem, g: Float64) -> _Step:
    """Return what an iteration from g leads to."""
    epsilon, masses = problem.case.epsilon, problem.masses
    f, _, shifted, row_mass = problem.half_step(0, g)
    row_dual = problem.dual((f, shifted), row_mass.sum())
    image, softmin, f, column_mass = problem.half_step(1, f)
    off = largest((shifted - problem.damping(1) * softmin)[masses[1] > 0])
    dual = problem.dual((f, image), column_mass.sum())
    return _Step(f, image, row_mass.sum(), row_dual, off / epsilon, dual, column_mass)


def iterate(case: Clouds, balanced: int, over_stored: bool = False) -> Iterator[Finding]:
    """Compare iterations with their definitions; `balanced` is 1 (source) plus 2 (target)."""
    epsilon = case.epsilon
    rho = tuple(
        np.inf if balanced >> side & 1 else strength * epsilon
        for side, strength in enumerate(STRENGTHS)
    )
    iteration, problem, orders = (start_stored if over_stored else _start)(case, rho)
    if iteration is None:
        return
    operation = "start_stored_iteration" if over_stored else "start_iteration"
    plain, undamped = ((1 + over_stored) * case.tolerance() * x for x in (PLAIN, UNDAMPED))
    later = undamped if balanced == 3 else plain

    def compared(
        x: Float64, allowed: float, detail: str, control: int, radius: float = WIDE
    ) -> tuple[Finding, IterationNumbers, _Step]:
        got, want = iteration.iterate(control, radius), _step(problem, x)
        f, images, _ = iteration.potentials()
        image = images[int((control & PARITY) > 0)]
        found = [np.empty(size) for size in case.shape]
        for order, ours, values in zip(orders, found, (f, image), strict=True):
            ours[order] = values
        error, detail = _excess(problem, want, got, *found), f", balanced {balanced}, {detail}"
        return case.finding(operation, error, allowed, detail=detail), got, want

    iteration.set_potential(case.g[orders[1]], epsilon, False)
    x, previous, weights, source = case.g, None, case.g, START
    ahead: list[Float64] = []
    differences: list[Float64] = []
    for number in range(4):
        radius = NARROW if number == 2 else WIDE
        control = control_of(source, number > 0, max(number - 1, 0), number)
        finding, got, want = compared(
            x, plain if number < 2 else later, f"step {number}", control, radius
        )
        yield finding
        residual = want.image - x
        if previous is None:
            weights = want.column_mass
        else:
            differences.append(residual - previous[1])
            ahead.append(want.image - previous[0] + (MIXING - 1) * differences[-1])
        previous = want.image, residual
        guess: Float64 | None = None
        if differences:
            guess = want.image + _moved(residual, ahead, differences, weights, radius)
            if balanced == 3:
                guess -= want.column_mass @ (guess - want.image) / want.column_mass.sum()
        wrong = float(got.extrapolated != (guess is not None))
        detail = f", balanced {balanced}, guess {number}"
        yield case.finding(operation, wrong, 0.5, "wrong", detail=detail)
        source = next_source(control, guess is not None)
        x = want.image if guess is None else guess
    # The last iterate is dropped, as if its dual were too small.
    iteration.iterate(source, WIDE)
    yield compared(want.image, later, "taken back", IMAGE | source & PARITY)[0]


_Started = tuple[ResidentIteration | None, _Problem, tuple]


def _start(case: Clouds, rho: tuple[float, ...]) -> _Started:
    """Start an iteration over all pairs; None if the host iterates."""
    masses, corrections = _corrected(case, np.random.default_rng(5))
    problem = _Problem(case, masses, corrections, rho)
    iteration = case.operations.start_iteration(*case.ours, masses, problem.rates, corrections)
    return iteration, problem, tuple(map(np.arange, case.shape))


def _corrected(case: Clouds, rng: np.random.Generator) -> tuple[Pair, Pair]:
    """Return corrections of both softmins, after the masses that belong to them."""
    rows, columns = (case.epsilon * rng.uniform(-1, 1, size) for size in case.shape)
    factors = np.exp(rows / case.epsilon), np.exp(columns / case.epsilon)
    return (case.rows[1] * factors[0], case.columns[1] * factors[1]), (rows, columns)


def start_stored(case: Clouds, rho: tuple[float, ...]) -> _Started:
    """Start an iteration over stored pairs, which are all pairs but those of no mass at all."""
    epsilon, own, potentials = case.epsilon, (case.rows[1], case.columns[1]), (case.softmin, case.g)
    limits = (np.full(size, -1e3) for size in case.shape)
    plan = PlanTerms(*case.ours, *potentials, epsilon, *limits)
    stored = case.operations.store_pairs(plan, case.shape[0] * case.shape[1])
    assert stored is not None, "the pairs were not stored"
    rng = np.random.default_rng(5)
    masses, corrections = _corrected(case, rng)
    center = case.softmin + epsilon * rng.uniform(-3, 3, case.shape[0])
    softmins = case.softmin, case.exact.softmin(*case.theirs[::-1], case.softmin, epsilon)
    vectors = []
    for side, order in enumerate(stored.orders):
        with np.errstate(divide="ignore"):
            base = potentials[side] + epsilon * np.log(own[side]) + corrections[side]
        alone = softmins[side] + corrections[side]
        of_side = masses[side], base, alone, potentials[side]
        vectors.append(StoredVectors(*(each[order] for each in of_side)))
    problem = _Problem(case, masses, corrections, rho, center)
    iteration = case.operations.start_stored_iteration(
        stored, tuple(vectors), center[stored.orders[0]], problem.rates
    )
    return iteration, problem, stored.orders


def _excess(problem: _Problem, want: _Step, got: IterationNumbers, f: Float64, g: Float64) -> float:
    """Return the largest error in nats; duals and masses count relative to the mass."""
    epsilon, masses, center = problem.case.epsilon, problem.masses, problem.center
    errors = [
        abs(got.mass / want.mass - 1),
        abs(got.row_dual - want.row_dual) / (epsilon * want.mass),
        abs(got.column_dual - want.column_dual) / (epsilon * want.mass),
        abs(got.residual - want.residual),
    ]
    if center is not None:
        massive = masses[0] > 0
        moved = np.where(massive, want.f - center, 0.0)
        moved -= masses[0] @ moved / masses[0].sum()
        errors.append(abs(got.moved - largest(moved[massive])) / epsilon)
    for one, other, mass in zip((f, g), (want.f, want.image), masses, strict=True):
        # Points without mass have no stored pairs: their softmins stay what they were.
        counts = (mass > 0) | (center is None)
        errors.append(largest((one - other)[counts]) / epsilon)
    return largest(np.array(errors)) if got.finite else np.inf


def _moved(
    residual: Float64, ahead: list[Float64], differences: list[Float64], weights: Float64,
    radius: float,
) -> Float64:  # fmt: skip
    """Return by how much an extrapolation differs from the image, by least squares."""
    root = np.sqrt(weights)
    factors = np.linalg.lstsq((np.array(differences) * root).T, residual * root, rcond=None)[0]
    moved = (MIXING - 1) * residual - factors @ np.array(ahead)
    longest = radius * float(np.linalg.norm(root * residual))
    return np.asarray(min(1.0, longest / float(np.linalg.norm(root * moved))) * moved)
