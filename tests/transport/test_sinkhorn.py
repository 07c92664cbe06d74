"""The solver on every device and on NumPy: closed forms, the reference, nasty measures."""

import numpy as np
import pytest
from plain import lift, reference, sinkhorn

import clmorph
from clmorph import ConvergenceWarning, InputError
from clmorph.measures.measure import Measure
from clmorph.transport._solver.coarse_grid import CorrectedProblem
from clmorph.transport._solver.problem import Problem


def measure(points, weights):
    points = np.asarray(points, float)
    return Measure(
        points[:, :2], points[:, 2:], np.asarray(weights, float), (1, len(points)), 1.0, "true"
    )


def random_pair(rng, n=60, m=75):
    a, b = rng.random(n), rng.random(m)
    scale = [1, 1, 0.5, 0.5, 0.5]
    return measure(rng.random((n, 5)) * scale, a), measure(rng.random((m, 5)) * scale, b)


@pytest.mark.parametrize("reach", [0.05, 0.3, 2.0])
@pytest.mark.parametrize(("a", "b"), [(1, 1), (0.2, 5), (1e-5, 1e5)])
def test_two_diracs(any_backend, a, b, reach):
    """log m = ((rho + eps)(log a + log b) - C) / (2 rho + eps)."""
    source = measure([[0.1, 0.2, 0.3, 0.4, 0.5]], [a])
    target = measure([[0.4, 0.1, 0.3, 0.6, 0.2]], [b])
    cost = 0.5 * np.sum((source.points - target.points) ** 2)
    potentials = sinkhorn(source, target, 0.05, reach, tol=1e-6, backend=any_backend)
    assert potentials.converged
    epsilon, rho = potentials.epsilon, potentials.rho
    want = ((rho + epsilon) * (np.log(a) + np.log(b)) - cost) / (2 * rho + epsilon)
    plan = reference.transport_plan(source, target, potentials)
    assert np.log(plan.sum()) == pytest.approx(want, abs=1e-5)


def test_without_convergence_there_is_a_warning(rng):
    source, target = random_pair(rng)
    with pytest.warns(ConvergenceWarning, match="raise max_iter") as caught:
        potentials = clmorph.sinkhorn(source, target, 0.02, 1.0, max_iter=3, backend="numpy")
    assert not potentials.converged
    assert potentials.n_iter == 3
    assert potentials.residual > 1e-3
    assert caught[0].filename == __file__


def test_measures_must_fit_together():
    one = lift(np.zeros((2, 2)))
    with pytest.raises(InputError, match="color_weight"):
        sinkhorn(one, lift(np.zeros((2, 2)), 1.0), backend="numpy")
    with pytest.raises(InputError, match="extent"):
        sinkhorn(one, lift(np.zeros((2, 2)), extent="unit"), backend="numpy")


@pytest.mark.parametrize("corrected", [False, True])
@pytest.mark.parametrize("rho", [(0.2, 0.2), (0.1, 0.7), (np.inf, 0.3), (0.3, np.inf),
                                 (np.inf, np.inf)])  # fmt: skip
def test_masses_after_half_steps_have_closed_forms(rng, rho, corrected):
    source, target = random_pair(rng, 20, 25)
    source.weights[3] = 0.0
    epsilon = 0.05
    if all(np.isinf(rho)):
        source = measure(source.points, source.weights * target.mass / source.mass)
    problem = CorrectedProblem.between(clmorph.get_backend("numpy"), source, target, rho)
    if corrected:
        problem.correct(epsilon * rng.normal(size=20), epsilon * rng.normal(size=25), epsilon)
    g = 0.1 * rng.random(25)
    softmin = problem.softmin(0, g, epsilon, True)
    rows = problem.half_step(0, g, softmin, epsilon)
    softmin = problem.softmin(1, rows.new, epsilon, True)
    own, after = (
        problem.half_step(1, rows.new, softmin, epsilon, before) for before in (None, rows.log_mass)
    )
    for side, found, exact in ((0, rows, rows), (1, after, own)):
        general = problem.marginal(side, exact.new, exact.softmin, epsilon).sum()
        assert found.mass == pytest.approx(general, rel=1e-12)
        pair = (found.old, found.new) if side else (found.new, found.old)
        summed, closed = (
            problem.dual(*pair, found.mass, epsilon, enough) for enough in (0.0, 1e-6)
        )
        assert closed == pytest.approx(summed, abs=1e-11 * epsilon * general)
    assert np.allclose(after.new, own.new, rtol=0, atol=1e-13)
    assert np.allclose(after.old, own.old, rtol=0, atol=1e-13)


def test_a_closed_form_with_too_few_digits_is_not_used(rng):
    source, target = random_pair(rng, 20, 25)
    epsilon, rho = 0.05, 1e9
    problem = Problem.between(clmorph.get_backend("numpy"), source, target, (rho, rho))
    g = 0.1 * rng.random(25)
    step = problem.half_step(0, g, problem.softmin(0, g, epsilon, True), epsilon)
    exact = problem.dual(step.new, step.old, step.mass, epsilon)
    assert problem.dual(step.new, step.old, step.mass, epsilon, 1e-7) == exact
    assert problem.dual(step.new, step.old, step.mass, epsilon, 1.0) != exact


def test_half_steps_are_finite_where_masses_underflow(rng):
    """Far beyond the reach, the plan's mass is below the range of float64."""
    x, y = rng.random((20, 2)), rng.random((25, 2)) + 40
    source, target = (measure(points, np.full(len(points), 1 / len(points))) for points in (x, y))
    epsilon, rho = 0.3, 0.5
    problem = Problem.between(clmorph.get_backend("numpy"), source, target, (rho, rho))
    g = np.zeros(25)
    rows = problem.half_step(0, g, problem.softmin(0, g, epsilon, True), epsilon)
    softmin = problem.softmin(1, rows.new, epsilon, True)
    columns = problem.half_step(1, rows.new, softmin, epsilon, rows.log_mass)
    assert rows.mass == 0
    for enough in (0.0, 1e-6):
        for found in (rows, columns):
            f, g = (found.new, found.old) if found is rows else (found.old, found.new)
            assert np.all(np.isfinite([*f, *g]))
            assert np.isfinite(problem.dual(f, g, found.mass, epsilon, enough))


def test_residual_looks_at_both_sides_and_at_mass_only(rng):
    source, target = random_pair(rng, 5, 6)
    a, b = source.weights.copy(), target.weights.copy()
    a[2], b[3] = 0, 0
    problem = Problem.between(
        clmorph.get_backend("numpy"), measure(source.points, a), measure(target.points, b),
        (np.inf, np.inf),
    )  # fmt: skip
    f, g = np.zeros(5), np.zeros(6)
    df, dg = np.array([1, 2, 90, 3, 1.0]), np.array([1, 2, 3, 90, 1, 4.0])
    assert problem.residual(f, g, df, g, 1.0) == 3
    assert problem.residual(f, g, df, dg, 2.0) == 2


def test_masses_that_differ_at_a_large_reach(any_backend):
    """Two Diracs of masses 1 and 5 meet in the middle: sqrt(5)."""
    source, target = (measure([[0.5] * 5], [mass]) for mass in (1.0, 5.0))
    potentials = sinkhorn(source, target, 0.05, 1e3, backend=any_backend)
    plan = reference.transport_plan(source, target, potentials)
    assert plan.sum() == pytest.approx(5**0.5, rel=2e-3)
    with pytest.warns(ConvergenceWarning, match="use .*a smaller reach"):
        sinkhorn(source, target, 0.05, 3e3, 1e-6, backend="numpy")


def dual(problem_data, f, g, epsilon, rho):
    """D(f, g), dense, as it is written."""
    source, target, cost = problem_data
    a, b = source.weights, target.weights
    value = -epsilon * a @ (np.exp((f[:, None] + g - cost) / epsilon) - 1) @ b
    for potential, weights, strength in ((f, a, rho[0]), (g, b, rho[1])):
        if np.isinf(strength):
            value += weights @ potential
        else:
            value += strength * weights @ (1 - np.exp(-potential / strength))
    return value


@pytest.mark.parametrize("rho", [(0.2, 0.2), (0.1, 0.7), (np.inf, 0.3), (0.3, np.inf)])
def test_half_steps_maximize_the_dual_over_translations_too(rng, rho):
    source, target = random_pair(rng, 20, 25)
    epsilon = 0.05
    problem = Problem.between(clmorph.get_backend("numpy"), source, target, rho)
    data = source, target, reference.transport.cost_matrix(source, target)

    def best(f, g, arguments):
        """Dual at the half-step and beside it, along translations of the old potential."""
        at = dual(data, f, g, epsilon, rho)
        for step in (1e-3, 1e-2, 0.1):
            for s in (step, -step):
                assert dual(data, *arguments(s), epsilon, rho) < at

    g = 0.1 * rng.random(25)
    f, g, t_rows, _ = problem.half_step(0, g, problem.softmin(0, g, epsilon, True), epsilon)
    source_damping, target_damping = problem.damping(epsilon)
    assert np.allclose(t_rows, problem.softmin(0, g, epsilon, True), rtol=0, atol=1e-12)
    best(f, g, lambda s: (source_damping * (t_rows - s), g + s))
    g, f, t_columns, _ = problem.half_step(1, f, problem.softmin(1, f, epsilon, True), epsilon)
    best(f, g, lambda s: (f + s, target_damping * (t_columns - s)))
