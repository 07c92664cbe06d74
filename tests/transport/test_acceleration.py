"""Compare the accelerated iteration with the plain one, and test its methods of acceleration."""

import numpy as np
import plain
import pytest
from clouds import drawings, of_kind
from plain import reference, sinkhorn

import clmorph
from clmorph.measures.points import WeightedPoints
from clmorph.transport._solver.anderson import Anderson
from clmorph.transport._solver.iteration import Iteration
from clmorph.transport._solver.problem import Problem
from clmorph.transport.regularization import regularization

KINDS = [
    "random", "two far clusters", "one place and many", "equal", "line", "duplicates", "ten orders",
]  # fmt: skip


@pytest.mark.filterwarnings("ignore::clmorph.ConvergenceWarning")
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("reach", [0.1, 0.3, 1.0, None, (0.3, None), (0.2, 1.0)], ids=str)
@pytest.mark.parametrize("kind", KINDS)
def test_the_dual_is_never_below_the_plain_iterations(kind, reach, seed):
    """After equally many softmins, wherever it is stopped."""
    rng = np.random.default_rng([KINDS.index(kind), seed])
    (a, x), (b, y) = of_kind(kind, rng, *rng.integers(1, 40, 2))
    if reach is None:
        a, b = a / a.sum(), b / b.sum()
    blur = 10 ** rng.uniform(-1.7, 0)
    for max_iter in (1, 2, 5, 12, 24, 60, 2000):
        ours = sinkhorn((a, x), (b, y), blur, reach, max_iter=max_iter, backend="numpy")
        plain = reference.sinkhorn((a, x), (b, y), blur, reach, 1e-15, max_iter=ours.n_iter)
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
    got = sinkhorn(*map(plain.lift, drawings(48)), blur, reach, backend=device)
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
        goal = regularization(0.03, tol=1e-4, max_iter=5000)
        iteration = Iteration(problem, goal, lambda share: None, certify=False)
        iteration.run(np.zeros(80))
        found = iteration.outcome()
        assert found.status == "converged"
        return found.n_iter

    assert iterations(bias) <= 1.5 * iterations(0.0)


def test_residuals_are_the_history(rng):
    got = sinkhorn(*of_kind("random", rng, 20, 30), 0.05, 0.5, backend="numpy")
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
