"""Compare the solution through clusters with the direct solution."""

from functools import partial

import numpy as np
import plain
import pytest
from clouds import drawings
from marks import full
from plain import reference, sinkhorn

import clmorph
from clmorph.backends import records
from clmorph.backends.opencl.backend import OpenCLOperations
from clmorph.backends.opencl.build import program
from clmorph.measures.cluster import make_clusters
from clmorph.measures.points import WeightedPoints
from clmorph.transport._solver import annealing, multiscale
from clmorph.transport._solver.coarse_grid import (
    STORED_CHOICES,
    CorrectedProblem,
    StoredChoice,
    StoredProblem,
    expanded,
    stored_grid,
)
from clmorph.transport._solver.iteration import Iteration
from clmorph.transport._solver.problem import Problem
from clmorph.transport._solver.softmin import Softmin
from clmorph.transport._solver.steps import DeviceSteps, HostSteps, new_steps
from clmorph.transport.regularization import regularization


def pictures(side, noise=0.0, color_weight=1.0):
    rng = np.random.default_rng(0)
    noisy = [image + noise * rng.normal(size=image.shape) for image in drawings(side)]
    return [plain.lift(np.clip(image, 0, 1), color_weight) for image in noisy]


def same_up_to_a_constant(got, want, tolerance):
    shift = 0.0 if got.reach is not None else np.mean(got.f - want.f)
    assert np.abs(got.f - want.f - shift).max() <= tolerance * got.epsilon
    assert np.abs(got.g - want.g + shift).max() <= tolerance * got.epsilon


def bound_one_optimum(got, want):
    rounding = 2e-5 * got.epsilon * got.transported_mass
    assert got.dual - rounding <= want.primal + want.marginal_error
    assert want.dual - rounding <= got.primal + got.marginal_error


def solved(pair, blur, tol=1e-4, backend="numpy"):
    """A solution through clusters, and a better one over all pairs in NumPy."""
    got = sinkhorn(*pair, blur, 0.3, tol, backend=backend, multiscale=True)
    assert got.converged
    return got, sinkhorn(*pair, blur, 0.3, 1e-5, backend="numpy", multiscale=False)


@pytest.fixture
def tried(monkeypatch):
    """The choices and the grid of each attempt to store pairs."""
    found = []

    def recorded(*arguments):
        found.append((list(arguments[-1]), stored_grid(*arguments)))
        return found[-1][1]

    monkeypatch.setattr(multiscale, "stored_grid", recorded)
    return found


# --- clusters ------------------------------------------------------------------------------


def test_clusters_without_mass_and_with_offsets():
    points = np.array([[0.1], [0.2], [5.0], [5.05], [9.0]])
    weights = np.array([1.0, 3.0, 0.0, 0.0, 0.0])
    clusters = make_clusters(WeightedPoints(points, weights, np.arange(5.0)), 1.0)
    assert clusters.measure.weights.tolist() == [4.0, 0.0, 0.0]
    assert np.allclose(clusters.measure.points[:, 0], [0.175, 5.025, 9.0])
    assert np.allclose(clusters.measure.offsets, [0.75, 2.5, 4.0])
    assert np.allclose(clusters.restrict(points[:, 0], weights), [0.175, 5.025, 9.0])


def test_clusters_of_eleven_dimensions_far_apart(rng):
    """More places than an integer can count."""
    points = 1e3 * rng.normal(size=(500, 11))
    points[250:] = points[:250] + 1e-7
    clusters = make_clusters(WeightedPoints(points, np.ones(500)), 1e-3)
    assert 250 <= len(clusters.measure) <= 260
    assert np.mean(clusters.labels[:250] == clusters.labels[250:]) > 0.95


# --- the correction ---------------------------------------------------------------------


@pytest.mark.parametrize("costs", [False, True])
def test_the_estimate_at_points_is_a_bound_and_near(device, rng, costs):
    """Where T is expanded around centers of clusters, it is not less than T, and not much more."""
    blur, n = 0.2, 300
    offsets = rng.random(n) if costs else None
    own = WeightedPoints(rng.random((n, 3)), rng.random(n), offsets)
    columns = device.upload(rng.random((200, 3)), rng.random(200))
    g, weights = 0.1 * rng.normal(size=200), np.ones(200)

    def softmin(measure):
        rows = device.upload(measure.points, measure.weights, measure.offsets)
        return Softmin(device, rows, columns, (measure.weights, weights))

    want = softmin(own)(g, blur**2)
    for side, most in ((1e-6, 1e-4), (0.5 * blur, 0.5), (2 * blur, 20.0)):
        clusters = make_clusters(own, side)
        found = expanded(softmin(clusters.measure), g, blur**2, clusters, own)
        above = (found - want) / blur**2
        assert above.min() >= -1e-4
        assert above.max() <= most
        assert (above.max() > 0.01) == (side > 1e-3)


def test_pairs_left_out_do_not_stop_a_coarse_problem(device):
    """Its truncation can be larger than its tolerance, which it reaches nevertheless."""
    measures = pictures(48, noise=0.1)
    problem = CorrectedProblem.between(device, *measures, (0.09, 0.09), 1e-2)
    epsilon = 0.1**2
    for softmin in (problem.to_rows, problem.to_columns):
        softmin.reserve = 0.9  # leaves out about as much as after a bad guess
    goal = regularization(0.1, tol=1e-4, max_iter=400, precision="float32")
    iteration = Iteration(problem, goal, annealing.ignore, certify=False)
    iteration.run(None)
    found = iteration.outcome()
    assert problem.left_out > 1e-3
    assert found.status == "converged"
    assert found.n_iter < 200
    f, g, _, _, residual = found.state
    assert residual <= 1e-4
    exact = Problem.between(device, *measures, (0.09, 0.09))
    softmins = exact.softmin(0, g, epsilon, True), exact.softmin(1, f, epsilon, True)
    assert exact.residual(f, g, *softmins, epsilon) <= 1e-4 + 1.1 * problem.left_out


# --- whole solves -----------------------------------------------------------------------


@pytest.mark.parametrize("reach", [0.05, 0.3, 1.0, None, (0.3, None), (0.1, 0.7)], ids=str)
@pytest.mark.parametrize("blur", [0.02, 0.05, 0.2])
def test_the_solution_is_the_same(device, blur, reach):
    pair = pictures(40)
    got = sinkhorn(*pair, blur, reach, 1e-4, backend=device, multiscale=True)
    want = sinkhorn(*pair, blur, reach, 1e-4, backend=device)
    assert got.converged
    assert got.residual <= 1e-4
    bound_one_optimum(got, want)
    if reach == 0.3:
        same_up_to_a_constant(got, want, 0.02)


def test_few_iterations_over_the_points(device):
    got = sinkhorn(*pictures(64), 0.1, 0.3, backend=device, multiscale=True)
    assert got.converged
    assert got.n_iter <= 4
    assert len(got.residuals) == got.n_iter
    # Each cycle leaves a small part.
    assert np.all(got.residuals[1:] < 0.3 * got.residuals[:-1])


# --- stored pairs -----------------------------------------------------------------------


def sharp(side):
    """Two pictures with noise, whose colors hold most pixels apart."""
    return pictures(side, 0.15, 2.0)


def stored_near(device, side, blur, rho):
    """A problem, its state after an iteration, and the grid of its pairs that matter."""
    source, target = sharp(side)
    problem, epsilon = Problem.between(clmorph.get_backend(device), source, target, rho), blur**2
    reach = tuple(None if np.isinf(each) else each**0.5 for each in rho)
    g = sinkhorn(source, target, blur, reach, 0.3, backend=device).g
    f, g, t_rows, _ = problem.half_step(0, g, problem.softmin(0, g, epsilon, True), epsilon)
    t_columns = problem.softmin(1, f, epsilon, True)
    state = multiscale.State(f, g, t_rows, t_columns, np.inf)
    grid = stored_grid(problem, state, epsilon, 10**8, STORED_CHOICES)
    return problem, f, g, t_rows, t_columns, grid


def test_stored_pairs_stand_for_the_points(device, rng):
    """At their potentials, and as long as these move no farther than is allowed."""
    blur, rho = 0.05, (0.09, 0.09)
    epsilon = blur**2
    problem, f, g, t_rows, t_columns, grid = stored_near(device, 32, blur, rho)
    near = grid.problem
    assert near.to_rows.left_out == 0
    pairs = near.to_rows.stored.n_pairs
    assert pairs < 0.9 * len(f) * len(g)
    rounding = 20 * problem.rounding(epsilon, True) + near.rounding(epsilon, False) + 1e-5
    if device != "numpy":
        rounding += 4 * problem.rounding(epsilon, False)
    # The coarse problem has the points in an order of its own.
    f, t_rows = (grid.source.restrict(each, problem.a) for each in (f, t_rows))
    caller_g, (g, t_columns) = g, (grid.target.restrict(each, problem.b) for each in (g, t_columns))
    assert np.array_equal(grid.target.points_of(g), caller_g)
    assert np.abs(near.to_rows(g, epsilon) - t_rows).max() <= rounding * epsilon
    assert np.abs(near.to_columns(f, epsilon) - t_columns).max() <= rounding * epsilon
    near.center = f
    move = near.trust_radius * epsilon * rng.uniform(-1, 1, len(f))
    assert not near.held(f + 7.0, epsilon)[1]  # all alike is no move
    assert near.held(f + 3 * move, epsilon)[1]
    held = near.held(f + 7.0 + 3 * move, epsilon)[0]
    assert np.abs(held - 7.0 - f).max() <= 1.5 * near.trust_radius * epsilon
    # Each pair that is left out has grown by exp(10) at most against those that are not.
    change = 5 * epsilon * rng.uniform(-1, 1, len(g))
    share = STORED_CHOICES[0].share
    left_out = len(g) * share * np.exp(10)
    assert left_out < 1e-4
    got = near.to_rows(g + change, epsilon)
    want = problem.to_rows(grid.target.points_of(g + change), epsilon, True)
    missed = np.abs(got - grid.source.restrict(want, problem.a))
    assert missed.max() <= (left_out + rounding) * epsilon


def iterates(problem):
    """Return whether iterations run on the problem's device."""
    given = problem.rows, problem.columns, (problem.a, problem.b), problem.inverse_rho
    return problem.operations.start_iteration(*given) is not None


def test_points_without_mass_do_not_leave_the_trust_region():
    """Their potentials decide nothing, and a shift of all potentials moves no point."""
    *_, grid = stored_near("numpy", 16, 0.05, (0.09, 0.09))
    near = grid.problem
    near.a = np.where(np.arange(len(near.a)) % 5 == 0, 0.0, near.a)
    near.masses = float(near.a.sum()), near.masses[1]
    near.center = np.zeros(len(near.a))
    far = 3 * near.trust_radius * 0.05**2
    assert not near.held(np.full(len(near.a), far), 0.05**2)[1]
    assert not near.held(np.where(near.a > 0, 0.0, far), 0.05**2)[1]
    assert near.held(np.where(np.arange(len(near.a)) == 1, far, 0.0), 0.05**2)[1]


def test_where_the_host_iterates_over_stored_pairs(device, monkeypatch):
    """Without memory for vectors; and where a weak penalty leaves closed forms too few digits."""
    problem, *_, grid = stored_near(device, 16, 0.05, (0.09, 0.09))
    near = grid.problem
    near.center = np.zeros(len(near.a))
    with monkeypatch.context() as patch:
        patch.setattr("clmorph.backends.opencl.kernels.sparse_half_steps.MOST_MEMORY", 0.0)
        assert isinstance(new_steps(near), HostSteps)
    steps = [new_steps(near) for _ in range(2)]
    assert {type(each) for each in steps} == {DeviceSteps if iterates(problem) else HostSteps}
    if iterates(problem):
        # Another iteration over the same pairs takes the memory of the first one.
        one, other = (each._iteration.arguments["rows"] for each in steps)
        assert one is other
    near.inverse_rho = 1e-12, 0.0
    assert isinstance(new_steps(near), HostSteps)


@pytest.mark.full
def test_levels_without_clusters_that_join_points(monkeypatch):
    """A level takes the points themselves where few would be joined; the solution is the same."""
    pair = sharp(24)
    near, far = (annealing._coarser(pair, blur) for blur in (1e-4, 1.0))
    assert near.clusters is None
    assert all(one is other for one, other in zip(near.pair, pair, strict=True))
    assert far.clusters is not None
    assert len(far.pair[0]) * len(far.pair[1]) <= annealing.FEWER * len(pair[0]) * len(pair[1])
    solve = partial(sinkhorn, *pair, 0.02, 0.3, 1e-5, backend="numpy", multiscale=True)
    monkeypatch.setattr(annealing, "FEW_PAIRS", 1)
    found = []
    for share in (0.0, 1.0):  # all levels take the points; none does
        monkeypatch.setattr(annealing, "FEWER", share)
        found.append(solve())
        assert found[-1].converged
    assert np.abs(found[0].f - found[1].f).max() <= 2e-3 * found[0].epsilon


def test_large_problems_take_clusters_that_save_less(monkeypatch):
    """Few pairs of each point can be stored there; the solution is the same."""
    pair = sharp(24)
    pairs = len(pair[0]) * len(pair[1])
    blur = next(
        blur
        for blur in np.geomspace(0.01, 0.5, 50)
        if np.prod([len(make_clusters(each, blur).measure) for each in pair]) <= 0.48 * pairs
    )
    problem = Problem.between(clmorph.get_backend("numpy"), *pair, (0.09, 0.09))
    goal = regularization(blur, tol=1e-5, max_iter=500)
    solve = multiscale.Multiscale(problem, pair, goal, lambda share: None)
    assert solve._choose_clusters() is None
    monkeypatch.setattr(multiscale, "ENOUGH_OF_MANY", ((10**6, 0.9), (1, 0.5)))
    clusters = solve._choose_clusters()
    share = len(clusters[0].measure) * len(clusters[1].measure) / pairs
    assert multiscale.ENOUGH[-1] < share <= 0.5
    same_up_to_a_constant(*solved(pair, blur, tol=1e-5), 2e-3)


def test_a_level_without_clusters_has_the_clouds_of_the_finer_one(device, rng):
    """Nothing is uploaded again, and the level chooses near pairs of its own."""
    pair = [WeightedPoints(rng.random((n, 3)), rng.random(n), rng.random(n)) for n in (150, 130)]
    finer = Problem.between(clmorph.get_backend(device), *pair, (0.1, np.inf), 1e-4)
    level = annealing._Level(0.3, tuple(pair), None, tuple(pair))
    coarse = annealing._level_problem(finer, level, finer)
    assert coarse.rows is finer.rows
    assert coarse.columns is finer.columns
    assert (coarse.rho, coarse.oscillations) == (finer.rho, finer.oscillations)
    assert coarse.to_rows is not finer.to_rows
    assert coarse.to_rows.reserve == coarse.to_columns.reserve == annealing.FAR_RESERVE
    assert finer.to_rows.reserve != annealing.FAR_RESERVE
    other = finer.with_truncation(None)
    assert (other.to_rows.truncation, other.to_columns.truncation) == (None, None)
    g = 0.1 * rng.random(130)
    again = Problem.between(clmorph.get_backend(device), *pair, (0.1, np.inf))
    for epsilon in (0.1, 0.01):
        assert np.array_equal(other.to_rows(g, epsilon), again.to_rows(g, epsilon))


@pytest.mark.parametrize("refused", ["near_field.cl", "sliced_ellpack.cl"])
def test_a_solve_does_without_a_program_that_cannot_be_built(device, monkeypatch, refused):
    """Over all pairs, or over pairs that are not stored; this is told once."""
    build, asked = program.build, []

    def refuse(context, name, *more):
        asked.append(name)
        if name == refused:
            raise records.ProgramError("refused: 1:1: error: no dominating alternative")
        return build(context, name, *more)

    def solve():
        operations = OpenCLOperations(device.device, device.constants, verify=False)
        options = {"backend": operations, "multiscale": True, "truncation": 1e-6}
        return sinkhorn(*sharp(24), 0.05, 0.3, 1e-5, **options)

    want = solve()
    monkeypatch.setattr(program, "build", refuse)
    monkeypatch.setattr(records, "_told", set())
    with pytest.warns(clmorph.ClmorphWarning, match="longer: refused: 1:1") as told:
        got = solve()
    assert len(told) == 1
    assert refused in asked
    assert got.converged
    assert np.abs(got.f - want.f).max() <= 2e-3 * got.epsilon


def test_choices_that_have_had_too_many_pairs_are_not_tried_again(monkeypatch, tried):
    """And the last choice is for small residuals alone."""
    blur = 0.05
    problem, f, g, t_rows, t_columns, grid = stored_near("numpy", 24, blur, (0.09, 0.09))
    first, second, last = STORED_CHOICES
    monkeypatch.setattr(multiscale, "STORED_PER_POINT", 1)
    monkeypatch.setattr(multiscale, "STORED", grid.problem.to_rows.stored.n_pairs - 1)
    goal = regularization(blur, tol=1e-5, max_iter=500)
    solve = multiscale.Multiscale(problem, sharp(24), goal, lambda share: None)
    solve.state = multiscale.State(f, g, t_rows, t_columns, 1.1 * last.residual)
    for _ in range(2):
        assert solve._stored_grid().problem.choice == second
    monkeypatch.setattr(multiscale, "STORED", 1)
    assert solve._stored_grid() is None
    assert solve._stored_grid() is None
    solve.state = solve.state._replace(residual=0.9 * last.residual)
    monkeypatch.setattr(multiscale, "STORED", 10**8)
    assert solve._stored_grid().problem.choice == last
    assert [choices for choices, _ in tried] == [[first, second], [second], [second], [], [last]]


@pytest.mark.full
@pytest.mark.parametrize("counts", [0.2, 1.0])
def test_cycles_that_end_at_the_edge_of_the_trust_region_are_no_failures(monkeypatch, counts):
    """They bring potentials that move far to the solution, if they do not count as failures."""
    monkeypatch.setattr(multiscale, "STORED_CHOICES", (StoredChoice(1e-13, 0.2),))
    monkeypatch.setattr(multiscale, "AT_THE_EDGE", counts)
    left, iterate = [], multiscale.Multiscale._iterate_points

    def recorded(self, *given, last):
        left.append(last)
        return iterate(self, *given, last=last)

    monkeypatch.setattr(multiscale.Multiscale, "_iterate_points", recorded)
    got = sinkhorn(*sharp(24), 0.05, 0.3, backend="numpy", multiscale=True)
    assert got.converged
    assert any(left) == (counts == 1.0)


@pytest.mark.full
def test_pairs_that_wait_for_a_smaller_residual_are_stored_then(device, monkeypatch, tried):
    """Iterations over the points reach the residual; cycles over the pairs follow."""
    choice = StoredChoice(1e-4, 6.0, residual=0.5)
    monkeypatch.setattr(multiscale, "STORED_CHOICES", (choice,))
    pair, shares = sharp(32), []
    options = {"backend": device, "multiscale": True, "progress": shares.append}
    got = sinkhorn(*pair, 0.03, 0.3, 1e-4, **options)
    assert [choices for choices, _ in tried] == [[], [choice]]
    assert tried[1][1] is not None
    assert got.converged
    assert np.all(np.diff(shares) >= 0)
    want = sinkhorn(*pair, 0.03, 0.3, 1e-5, backend="numpy", multiscale=False)
    assert got.n_iter < want.n_iter
    same_up_to_a_constant(got, want, 0.02)


@pytest.mark.filterwarnings("ignore::clmorph.ConvergenceWarning")
@pytest.mark.parametrize(("tol", "max_iter"), [(1e-4, 6), (1e-4, 8), (1e-4, 20), (0.3, 500)])
def test_waiting_for_a_smaller_residual_keeps_the_limits(device, monkeypatch, tol, max_iter):
    """The largest number of iterations holds meanwhile, and so does a tolerance above 0.2."""
    choice = StoredChoice(1e-4, 6.0, residual=0.5)
    monkeypatch.setattr(multiscale, "STORED_CHOICES", (choice,))
    pair = sharp(32)
    got = sinkhorn(*pair, 0.03, 0.3, tol, max_iter=max_iter, backend=device, multiscale=True)
    assert got.n_iter <= max_iter
    assert got.converged == (got.residual <= tol)
    assert got.converged or got.status == "max_iter"
    assert got.converged or tol < 0.3


def test_many_clusters_give_only_the_first_potentials(device, monkeypatch):
    """Cycles correct few clusters; after many they are those of stored pairs."""
    source, target = pictures(40)
    corrected = []
    correct = multiscale.Multiscale._correct
    monkeypatch.setattr(
        multiscale.Multiscale, "_correct",
        lambda self, grid, image: corrected.append(grid.problem) or correct(self, grid, image),
    )  # fmt: skip
    found = []
    for cycles in (True, False):
        fineness = multiscale.Fineness(1.0, 1e-12, 3e-6, cycles)
        monkeypatch.setattr(multiscale, "FINENESSES", (fineness,))
        corrected.clear()
        found.append(sinkhorn(source, target, 0.05, 0.3, 1e-4, backend=device, multiscale=True))
        assert found[-1].converged
        assert isinstance(corrected[0], StoredProblem) == (not cycles)
    same_up_to_a_constant(*found, 0.02)


@pytest.mark.parametrize("choice", [1, 2])
def test_choices_of_fewer_pairs_lead_to_the_solution(device, monkeypatch, choice):
    only = STORED_CHOICES[choice]._replace(residual=np.inf)
    monkeypatch.setattr(multiscale, "STORED_CHOICES", (only,))
    same_up_to_a_constant(*solved(sharp(24), 0.05, backend=device), 0.02)


@pytest.mark.parametrize("reach", [0.05, 0.3, 1.0, *full(None), (0.3, None)], ids=str)
def test_small_blurs_are_solved_over_stored_pairs(device, tried, reach):
    pair = sharp(40)
    got = sinkhorn(*pair, 0.03, reach, 1e-4, backend=device, multiscale=True)
    want = sinkhorn(*pair, 0.03, reach, 1e-4, backend=device, multiscale=False)
    assert got.converged
    assert tried
    assert all(grid for _, grid in tried)
    # Balanced problems over stored pairs fall slowly: 10 iterations with vectors of 8 lanes.
    assert got.n_iter <= (12 if reach is None else 8) < want.n_iter
    bound_one_optimum(got, want)
    if reach == 0.3:
        same_up_to_a_constant(got, want, 0.02)


def test_without_memory_for_pairs_points_are_iterated_over(device, monkeypatch):
    monkeypatch.setattr(multiscale, "STORED_PER_POINT", 1)
    monkeypatch.setattr(multiscale, "STORED", 1)
    got = sinkhorn(*sharp(24), 0.03, 0.3, backend=device, multiscale=True)
    assert got.converged
    assert got.n_iter > 10


@pytest.mark.parametrize(
    ("measures", "changes"),
    [
        (pictures, {"SIDES": (6.0,), "ENOUGH": (1.0,)}),
        pytest.param(sharp, {"STORED_CHOICES": (StoredChoice(0.3, 50.0),)}, marks=pytest.mark.full),
    ],
    ids=["clusters", "pairs"],
)
def test_what_misleads_is_left(monkeypatch, measures, changes):
    """Clusters far larger than the blur, or far too few pairs: cycles fail, the solve does not."""
    for name, value in changes.items():
        monkeypatch.setattr(multiscale, name, value)
    same_up_to_a_constant(*solved(measures(24), 0.04, tol=1e-3), 0.1)


def test_points_without_mass_over_stored_pairs(device, rng):
    pair = [(each.weights * (rng.random(576) > 0.3), each.points) for each in sharp(24)]
    same_up_to_a_constant(*solved(pair, 0.03, backend=device), 0.05)


@pytest.mark.full
def test_without_clusters_that_save_anything(rng):
    """With a blur below the points' distance each point is a separate cluster, without any gain."""
    pair = [(np.full(60, 1 / 60), rng.random((60, 3))) for _ in range(2)]
    got = sinkhorn(*pair, 0.01, 0.3, 1e-4, backend="numpy", multiscale=True)
    want = reference.sinkhorn(*pair, 0.01, 0.3, 1e-6, 10**5)
    assert got.converged
    same_up_to_a_constant(got, want, 0.05)


def test_an_earlier_solution_is_a_start(device):
    solve = partial(sinkhorn, *pictures(48), 0.1, 0.3, backend=device, multiscale=True)
    first = solve()
    again = solve(start=first)
    assert again.converged
    assert again.n_iter <= 2


def test_max_iter_and_progress(rng):
    shares = []
    options = {"multiscale": True, "progress": shares.append}
    with pytest.warns(clmorph.ConvergenceWarning, match="not converged after 2 iterations"):
        got = sinkhorn(*pictures(32), 0.1, 1.0, 1e-9, 2, "numpy", **options)
    assert (got.status, got.n_iter) == ("max_iter", 2)
    assert shares[-1] == 1
    assert np.all(np.diff(shares) >= 0)


def test_costs_with_offsets(device, rng):
    """A color metric for each pixel: eleven coordinates and offsets."""
    image = rng.random((24, 24, 3))
    metric = np.eye(3) + 0.1 * np.abs(rng.normal(size=(24, 24, 1, 1)))
    source = plain.lift(image, 0.5, color_metric=metric)
    target = plain.lift(rng.random((24, 24, 3)), 0.5)
    same_up_to_a_constant(*solved((source, target), 0.1, backend=device), 0.02)


def test_small_problems_are_solved_as_ever(device):
    """Bit by bit, and without a truncation."""
    source, target = pictures(32)
    ours = sinkhorn(source, target, backend=device)
    plain = sinkhorn(source, target, backend=device, multiscale=False, truncation=None)
    assert np.array_equal(ours.f, plain.f)
    assert np.array_equal(ours.g, plain.g)
    assert (ours.truncation, ours.visited) == (None, 1.0)
    assert ours.truncation_error < 1e-8  # rounding alone


@pytest.mark.filterwarnings("ignore::clmorph.ConvergenceWarning")
@pytest.mark.parametrize("precision", ["auto", "float32"])
@pytest.mark.parametrize("reach", [0.3, None])
def test_cycles_end_where_rounding_begins(device, rng, precision, reach):
    """However small the tolerance, in clusters and over stored pairs."""
    for blur in (0.1, 0.8):
        pair = [(np.full(30, 1 / 30), rng.random((30, 2))) for _ in range(2)]
        got = sinkhorn(*pair, blur, reach, 1e-9, 3000, device, precision=precision, multiscale=True)
        assert got.n_iter < 1500
        assert got.status in ("precision", "converged")
