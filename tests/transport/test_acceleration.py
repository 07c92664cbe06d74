"""Compare the accelerated iteration with the plain one, and test its methods of acceleration."""

import warnings

import numpy as np
import plain
import pytest
from plain import reference, sinkhorn

import clmorph
from clmorph.measures.points import WeightedPoints
from clmorph.transport._solver.anderson import Anderson
from clmorph.transport._solver.iteration import Iteration
from clmorph.transport._solver.problem import Problem
from clmorph.transport._solver.reductions import Segments


def clouds(kind, rng):
    n, m = rng.integers(1, 40, 2)
    dimension = rng.integers(1, 6)
    x, y = rng.random((n, dimension)), rng.random((m, dimension))
    a, b = rng.random(n) + 0.01, rng.random(m) + 0.01
    if kind == "two far clusters":
        x = 0.1 * x + 3 * rng.integers(0, 2, (n, 1))
        y = 0.1 * y + 3 * rng.integers(0, 2, (m, 1))
    if kind == "one place and many":
        x[:] = x[0]
    if kind == "one place":
        x[:], y[:] = 0.5, 0.5
    if kind == "line":
        x[:, 1:], y[:, 1:] = 0, 0
    if kind == "duplicates":
        x, y = np.round(4 * x) / 4, np.round(4 * y) / 4
    if kind == "masses over ten orders":
        a, b = 10 ** rng.uniform(-10, 0, n), 10 ** rng.uniform(-10, 0, m)
    return (a, x), (b, y)


KINDS = [
    "random", "two far clusters", "one place and many", "one place", "line", "duplicates",
    "masses over ten orders",
]  # fmt: skip


def quietly(solve, *arguments, **options):
    with warnings.catch_warnings(action="ignore", category=clmorph.ConvergenceWarning):
        return solve(*arguments, **options)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("reach", [0.1, 0.3, 1.0, None, (0.3, None), (0.2, 1.0)], ids=str)
@pytest.mark.parametrize("kind", KINDS)
def test_the_dual_is_never_below_the_plain_iterations(kind, reach, seed):
    """After equally many softmins, wherever it is stopped."""
    rng = np.random.default_rng([KINDS.index(kind), seed])
    (a, x), (b, y) = clouds(kind, rng)
    if reach is None:
        a, b = a / a.sum(), b / b.sum()
    blur = 10 ** rng.uniform(-1.7, 0)
    for max_iter in (1, 2, 5, 12, 24, 60, 2000):
        ours = quietly(sinkhorn, (a, x), (b, y), blur, reach, max_iter=max_iter, backend="numpy")
        plain = quietly(
            reference.sinkhorn, (a, x), (b, y), blur, reach, 1e-15, max_iter=ours.n_iter
        )  # fmt: skip
        rounding = 1e-9 * (abs(plain.dual) + ours.epsilon * ours.transported_mass)
        assert ours.dual >= plain.dual - rounding, max_iter


@pytest.mark.parametrize("imbalance", [0.3, 0.1, 0.03, 0.01])
def test_mass_that_must_cross_a_gap(rng, imbalance):
    """Two far clusters, balanced: plain iteration gains one epsilon of C at a time."""
    x, y = 0.1 * rng.random((20, 3)), 0.1 * rng.random((20, 3))
    x[10:] += 3
    y[10:] += 3
    a, b = np.full(20, 0.05), np.full(20, 0.05)
    b[:10] *= 1 + imbalance
    b[10:] *= 1 - imbalance
    got = sinkhorn((a, x), (b, y), 0.09, None, max_iter=150, backend="numpy")
    assert got.converged
    plan = reference.transport_plan((a, x), (b, y), got)
    assert plan[10:, :10].sum() == pytest.approx(0.5 * imbalance, rel=0.1)


@pytest.mark.parametrize(
    ("blur", "reach", "limit"),
    [(0.05, 0.3, 45), (0.05, 1.0, 100), (0.05, None, 170), (0.02, 0.3, 110), (0.01, 0.3, 220)],
)
def test_iterations_on_pictures(device, blur, reach, limit):
    y, x = np.mgrid[:48, :48] / 48
    one = np.stack([x, 0.5 + 0.5 * np.sin(7 * y), (x + y > 0.9) * 0.8], axis=-1)
    two = np.stack([(x - 0.5) ** 2 + (y - 0.4) ** 2 < 0.1, y, 0.5 + 0.5 * np.cos(9 * x)], axis=-1)
    got = sinkhorn(plain.lift(one), plain.lift(two), blur, reach, backend=device)
    assert got.converged
    assert got.n_iter <= limit


@pytest.mark.parametrize("bias", [-1e-5, 1e-5])
def test_rounding_beyond_its_bound_leaves_the_acceleration(bias):
    """Sums over rows and over columns can be off by different numbers of nats."""
    rng = np.random.default_rng(11)
    source, target = (WeightedPoints(rng.random((80, 2)), np.full(80, 1 / 80)) for _ in range(2))

    def iterations(bias):
        problem = Problem.between(clmorph.get_backend("numpy"), source, target, (1.0, 1.0))
        exact = problem.softmin
        problem.softmin = lambda side, old, epsilon, *flags: (
            exact(side, old, epsilon, *flags) + side * bias * epsilon
        )
        iteration = Iteration(
            problem, 0.03, 1e-4, 5000, "auto", lambda share: None, certify=False
        )  # fmt: skip
        iteration.run(np.zeros(80))
        found = iteration.outcome()
        assert found.status == "converged"
        return found.n_iter

    assert iterations(bias) <= 1.5 * iterations(0.0)


def test_residuals_are_the_history(rng):
    (a, x), (b, y) = clouds("random", np.random.default_rng(1))
    got = sinkhorn((a, x), (b, y), 0.05, 0.5, backend="numpy")
    assert got.residuals[-1] == got.residual <= 1e-3
    assert got.n_iter - 2 <= len(got.residuals) <= got.n_iter + 1
    assert np.all(got.residuals > 0)


def test_extrapolation_solves_a_linear_problem_at_once(rng):
    """x <- M x + c with M of rank 4: a Krylov method ends after as many steps."""
    basis = np.linalg.qr(rng.normal(size=(30, 4)))[0]
    matrix = basis @ np.diag([0.99, 0.9, 0.5, -0.3]) @ basis.T
    offset = basis @ rng.normal(size=4)
    solution = np.linalg.solve(np.eye(30) - matrix, offset)
    memory, x = Anderson(), np.zeros(30)
    memory.ring.radius = 1e6
    for _ in range(9):
        image = matrix @ x + offset
        x, _ = memory.extrapolate(x, image, np.ones(30))
    assert np.abs(x - solution).max() < 1e-6 * np.abs(solution).max()
    assert np.abs(np.linalg.matrix_power(matrix, 9) @ solution).max() > 0.1


def test_an_extrapolation_keeps_its_length(rng):
    memory = Anderson()
    plain, found = memory.extrapolate(np.zeros(3), np.ones(3), np.ones(3))
    assert not found
    assert np.array_equal(plain, np.ones(3))
    # Hardly any change of the residual: the next iterates lie very far away.
    guess, found = memory.extrapolate(np.ones(3), 2 - 1e-9 * np.ones(3), np.ones(3))
    assert found
    assert np.linalg.norm(guess - 2) == pytest.approx(32 * 3**0.5, rel=1e-6)
    memory.ring.accepted()
    longer, _ = memory.extrapolate(guess, guess + 1 - 2e-9, np.ones(3))
    assert np.linalg.norm(longer - guess) > 100
    memory.rejected()
    assert not memory.extrapolate(guess, guess + 1, np.ones(3))[1]


@pytest.mark.parametrize("sizes", [(7, 1, 12), (9, 9, 9)])
def test_many_memories_are_those_of_each_problem(rng, sizes):
    """One problem begins anew at times, and one is taken out."""
    maps = [rng.uniform(-0.5, 0.95, size) for size in sizes]
    weights = [rng.random(size) + 0.5 for size in sizes]
    many, alone = Anderson(Segments(np.array(sizes))), [Anderson() for _ in sizes]
    x, numbers = [rng.random(size) for size in sizes], np.arange(3)
    for step in range(30):
        if step in (3, 9, 24):
            many.rejected(numbers == 2)
            alone[2].rejected()
        elif step:
            many.ring.accepted(numbers != 2)
            for number in numbers[:-1]:
                alone[number].ring.accepted()
        if step == 20:
            kept, left = np.array([0, 2]), Segments(np.array([sizes[0], sizes[2]]))
            many.take(kept, Segments(np.array(sizes)).points_of(kept), left)
            x, numbers = [x[0], x[2]], kept
        images = [maps[number] * own + 1 for number, own in zip(numbers, x, strict=True)]
        masses = [weights[number] for number in numbers]
        got, found = many.extrapolate(*map(np.concatenate, (x, images, masses)))
        want = [
            alone[number].extrapolate(*given)
            for number, *given in zip(numbers, x, images, masses, strict=True)
        ]
        assert found.tolist() == [bool(extrapolated) for _, extrapolated in want]
        x = [guess for guess, _ in want]
        assert np.allclose(got, np.concatenate(x), rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("patience", [3, 7])
def test_rounding_ends_an_iteration_after_its_patience(rng, monkeypatch, patience):
    """A residual that rounding explains, and that does not fall, ends the iteration."""
    pair = [clmorph.WeightedPoints(rng.random((n, 2)), np.full(n, 1 / n)) for n in (20, 30)]
    problem = Problem.between(clmorph.get_backend("numpy"), *pair, (0.1, 0.1))
    monkeypatch.setattr(Problem, "residual", lambda *given: 0.5)
    for rounding, expected in ((1.0, 1 + patience), (0.01, 40)):
        monkeypatch.setattr(Problem, "rounding", lambda *given, value=rounding: value)
        iteration = Iteration(
            problem, 0.1, 1e-3, 40, "float64", lambda share: None, certify=False, patience=patience
        )
        iteration.run(np.zeros(30))
        found = iteration.outcome()
        assert found.n_iter == expected
        assert found.status == ("precision" if rounding == 1.0 else "max_iter")
