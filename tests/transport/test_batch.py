"""Many problems at once: each as `sinkhorn` solves it, on every device and on NumPy."""

from unittest.mock import Mock

import numpy as np
import pytest
from clouds import PAIRS
from count_transfers import TransferCount
from residuals import true_residual

import clmorph
from clmorph import ConvergenceWarning, InputError
from clmorph.backends.numpy import NumPyOperations
from clmorph.backends.opencl.kernels.launches import LaunchBudget
from clmorph.transport import certificate, sinkhorn_batch
from clmorph.transport._solver import softmin


def cloud(rng, n, dimension=3, zeros=0.0):
    weights = rng.random(n) + 0.1
    weights[rng.random(n) < zeros] = 0.0
    weights[0] = 1.0
    return weights / weights.sum(), rng.random((n, dimension))


def random_pairs(rng, count=8, sizes=(1, 90), **more):
    return [
        tuple(cloud(rng, int(rng.integers(*sizes)), **more) for _ in range(2)) for _ in range(count)
    ]


def solve(pairs, *given, **options):
    return clmorph.sinkhorn_batch(*map(list, zip(*pairs, strict=True)), *given, **options)


def assert_alike(found, pairs, backend, **options):
    """Each problem of a batch has what a solve of its own has."""
    assert len(found) == len(pairs)
    told = list(zip(found.statuses, found.residuals, strict=True))
    assert told == [(ours.status, ours.residual) for ours in found]
    for pair, ours in zip(pairs, found, strict=True):
        alone = clmorph.sinkhorn(*pair, backend=backend, **options)
        assert (ours.f.shape, ours.g.shape) == (alone.f.shape, alone.g.shape)
        assert (ours.blur, ours.reach, ours.status) == (alone.blur, alone.reach, alone.status)
        if not alone.converged:
            continue
        # Certificates enclose one optimum.
        assert max(ours.dual, alone.dual) <= min(ours.primal, alone.primal)
        assert true_residual(pair, ours) <= ours.residual <= options.get("tol", 1e-3)
        assert ours.residual == ours.residuals[-1]
        assert ours.certificate.masses == pytest.approx(alone.certificate.masses)
        assert ours.row_mass.sum() == pytest.approx(ours.transported_mass)
        assert ours.transported_mass == pytest.approx(alone.transported_mass, rel=0.01)
        assert 0 < ours.truncation_error < 1e-5
        told = f"converged in {ours.n_iter} iterations (residual {ours.residual:.1e} epsilon)"
        assert ours.message == told


@pytest.mark.parametrize(
    ("reach", "tol"),
    [
        (0.3, 1e-3), (None, 1e-3), ((0.3, None), 1e-3), (0.01, 1e-3), (50.0, 1e-3), (0.5, 1e-1),
        (0.5, 1e-4), (0.5, 1e-6),
    ],
)  # fmt: skip
def test_each_problem_is_solved_as_by_sinkhorn(any_backend, rng, reach, tol):
    pairs, options = random_pairs(rng, zeros=0.2), {"blur": 0.1, "reach": reach, "tol": tol}
    found = solve(pairs, **options, backend=any_backend)
    assert found.converged
    assert repr(found) == "<PotentialsBatch of 8 problems, all converged>"
    assert_alike(found, pairs, any_backend, **options)


def test_small_and_large_problems_in_units_of_epsilon(any_backend, rng):
    """Some problems of a batch need better exponents than float32, and others do not."""
    pairs = random_pairs(rng, 3, (20, 60))
    pairs += [tuple((w, 30 * x) for w, x in pair) for pair in random_pairs(rng, 3, (20, 60))]
    found = solve(pairs, 0.1, 0.5, backend=any_backend)
    assert_alike(found, pairs, any_backend, blur=0.1, reach=0.5)
    want = [clmorph.sinkhorn(*pair, 0.1, 0.5, backend=any_backend).precise for pair in pairs]
    assert [each.precise for each in found] == want


def nasty_pairs(rng):
    names = "one and many", "all equal", "one mass among zeros", "ten orders of mass"
    return [
        *(tuple((weights, x) for x, weights in PAIRS[name](rng)) for name in names),
        (([1e-3], [[0.1, 0.2]]), ([1e3], [[0.3, 0.1]])),
        tuple((weights, x + 500) for weights, x in random_pairs(rng, 1)[0]),
        *random_pairs(rng, 1, (1, 2)),
    ]


@pytest.mark.parametrize("reach", [1e-3, 0.3, 1e3])
def test_nasty_problems_side_by_side(any_backend, rng, reach):
    pairs = nasty_pairs(rng)
    found = solve(pairs, 0.05, reach, backend=any_backend)
    assert_alike(found, pairs, any_backend, blur=0.05, reach=reach)
    for each in found:
        assert np.all(np.isfinite([*each.f, *each.g]))


def test_stacked_arrays_are_a_list_of_measures(rng):
    weights, points, others = rng.random((5, 20)), rng.random((5, 20, 2)), rng.random((5, 30, 2))
    wide = np.full((5, 30), 1 / 30)
    stacked = clmorph.sinkhorn_batch((weights, points), (wide, others), 0.1, 0.3, backend="numpy")
    listed = clmorph.sinkhorn_batch(
        list(zip(weights, points, strict=True)),
        (clmorph.WeightedPoints(x, w) for w, x in zip(wide, others, strict=True)),
        0.1, 0.3, backend="numpy",
    )  # fmt: skip
    for one, other in zip(stacked, listed, strict=True):
        assert np.array_equal(one.f, other.f)
        assert np.array_equal(one.g, other.g)
    flat = [(weights, points[..., axis]) for axis in (0, 1)]
    line = clmorph.sinkhorn_batch(*flat, 0.1, 0.3, backend="numpy")
    fourth = [(each[3], x[3]) for each, x in flat]
    alone = clmorph.sinkhorn(*fourth, 0.1, 0.3, backend="numpy")
    assert line[3].dual == pytest.approx(alone.dual, rel=1e-3)


def test_images_and_maps_of_metrics(any_backend, rng):
    """Measures of images, of several dimensions and with offsets, in one list."""
    pictures = [clmorph.lift(rng.random((5, 6, 3)), 0.5) for _ in range(3)]
    metric = np.broadcast_to(np.diag([1.0, 2.0, 3.0]), (5, 6, 3, 3)) * rng.random((5, 6, 1, 1))
    mapped = clmorph.lift(rng.random((5, 6, 3)), 0.5, color_metric=metric)
    pairs = [(pictures[0], pictures[1]), cloud(rng, 9), (mapped, pictures[2])]
    pairs[1] = pairs[1], cloud(rng, 7)
    found = solve(pairs, 0.1, 0.4, backend=any_backend)
    assert found.converged
    assert_alike(found, pairs, any_backend, blur=0.1, reach=0.4)
    for pair, ours in zip(pairs, found, strict=True):
        measures = clmorph.measures.points.as_pair(*pair)
        plan = clmorph.transport_plan(*measures, ours, backend="numpy")
        assert plan.mass.sum() == pytest.approx(ours.transported_mass, rel=0.02)


def test_a_part_at_a_time_gives_the_same(monkeypatch, rng):
    pairs = random_pairs(rng, 9)
    whole = solve(pairs, 0.1, 0.3, backend="numpy")
    monkeypatch.setattr(sinkhorn_batch, "MAX_BATCH", 100)
    shares = []
    parts = solve(pairs, 0.1, 0.3, backend="numpy", progress=shares.append)
    measures = [clmorph.measures.points.as_pair(*pair) for pair in pairs]
    lists = sinkhorn_batch.together(measures, (0.09, 0.09))
    assert 2 < len(lists) < 9
    assert sorted(number for each in lists for number in each) == list(range(9))
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    for one, other in zip(whole, parts, strict=True):
        assert one.n_iter == other.n_iter
        assert np.allclose(one.f, other.f, rtol=0, atol=1e-9)


@pytest.mark.parametrize(("blur", "reach"), [(0.005, 0.3), (0.02, None), (0.05, (0.2, None))])
def test_hard_problems_take_the_iterations_of_a_solve_alone(any_backend, rng, blur, reach):
    """To the last bit, as hundreds of iterations multiply any rounding."""
    pairs = random_pairs(rng, 5, (20, 150)) + random_pairs(rng, 3, (2, 6))
    spread = [[(10 ** rng.uniform(-12, 0, len(x)), x) for _, x in pair] for pair in pairs[:2]]
    pairs += [tuple((w / w.sum(), x) for w, x in pair) for pair in spread]
    found = solve(pairs, blur, reach, max_iter=3000, backend=any_backend)
    for ours, pair in zip(found, pairs, strict=True):
        alone = clmorph.sinkhorn(*pair, blur, reach, max_iter=3000, backend=any_backend)
        assert ours.status == alone.status
        assert np.array_equal(ours.f, alone.f)
        assert ours.n_iter == alone.n_iter


def test_many_pairs_are_solved_alone(monkeypatch, rng):
    pairs = random_pairs(rng, 3, (30, 40))
    monkeypatch.setattr(softmin, "MANY_PAIRS", 900)
    found = solve(pairs, 0.1, 0.3, backend="numpy")
    for pair, ours in zip(pairs, found, strict=True):
        alone = clmorph.sinkhorn(*pair, 0.1, 0.3, truncation=1e-4, backend="numpy")
        assert ours.truncation == alone.truncation
        assert np.array_equal(ours.f, alone.f)


def test_finished_problems_cost_nothing(rng, monkeypatch):
    pairs, operations = random_pairs(rng, 60, (2, 12)), NumPyOperations()
    softmin = Mock(side_effect=operations.softmin)
    monkeypatch.setattr(operations, "softmin", softmin)
    found = solve(pairs, 0.05, 1.0, backend=operations)
    rows = [call.args[0] for call in softmin.call_args_list]
    counts = [len(each) for each in rows if isinstance(each, list)]
    needed = 2 * found.n_iter
    assert needed.max() > 1.5 * np.median(needed)
    # A sixteenth of the problems may have stopped before they are taken out. Half-steps that are
    # taken back cost one more softmin.
    assert sum(counts) <= 1.15 * needed.sum()
    # Levels of the annealing begin for all problems at the same time.
    assert len(counts) <= 1.6 * needed.max()
    assert counts[-1] < 10


def test_the_number_of_launches_is_that_of_the_slowest(device, rng, monkeypatch):
    # After a slow launch, as on a busy machine, the next ones would be cut.
    monkeypatch.setattr(LaunchBudget, "pairs", lambda budget: 1 << 22)
    pairs = random_pairs(rng, 40, (30, 70))
    solve(pairs, 0.1, 0.5, backend=device)
    with TransferCount() as count:
        found = solve(pairs, 0.1, 0.5, backend=device)
    # Two softmins an iteration, with the arithmetic after each on the device, two for all
    # certificates, and those that were taken back.
    each = 4 if not device.constants.longest_loop else 2
    n_iter = found.n_iter.max()
    assert each * n_iter <= count.n_launches <= 1.15 * each * n_iter + 20
    with TransferCount() as count:
        list(found)
    assert not count.n_launches


def test_potentials_are_made_when_they_are_asked_for(monkeypatch, rng):
    counted = Mock(side_effect=certificate.certify)
    monkeypatch.setattr("clmorph.transport._solver.problem.certify", counted)
    found = solve(random_pairs(rng, 6), 0.1, 0.3, backend="numpy")
    assert not counted.called
    assert found[2] is found[2]
    assert found[-1] is found[5]
    assert counted.call_count == 2
    assert [each is found[number] for number, each in enumerate(found)] == [True] * 6
    assert found[1:4] == [found[1], found[2], found[3]]
    for index, error, words in (
        (6, IndexError, "index 6: expected -6 to 5"), ("a", TypeError, "index 'a': expected a"),
    ):  # fmt: skip
        with pytest.raises(error, match=words):
            found[index]
    # Arrays are copies: a change of one problem's cannot reach another's.
    found[0].f[:] = np.nan
    assert np.all(np.isfinite(found[1].f))
    again = solve(random_pairs(np.random.default_rng(0), 6), 0.1, 0.3, backend="numpy")
    assert again.n_iter.tolist() == [each.n_iter for each in again]


def test_repeated_solves_are_equal(device, rng):
    pairs = random_pairs(rng, 12)
    one, other = (solve(pairs, 0.05, 0.5, backend=device) for _ in range(2))
    for first, second in zip(one, other, strict=True):
        assert np.array_equal(first.f, second.f)
        assert first.certificate.dual == second.certificate.dual


def test_nothing_to_solve():
    found = clmorph.sinkhorn_batch([], [], backend="numpy")
    assert (len(found), list(found), found.converged) == (0, [], True)
    assert len(clmorph.divergence_matrix([], backend="numpy")) == 0
    empty = np.zeros((0, 3))
    assert len(clmorph.sinkhorn_batch((empty, empty), (empty, empty), backend="numpy")) == 0


@pytest.mark.parametrize("max_iter", [1, 2, 7, 30])
def test_iterations_that_run_out(any_backend, rng, max_iter):
    pairs = random_pairs(rng, 5, (20, 40))
    with pytest.warns(ConvergenceWarning, match=r"5 of 5 solves .* problem 0: not conv") as told:
        found = solve(pairs, 0.01, 5.0, 1e-6, max_iter, backend=any_backend)
    assert told[0].filename == __file__
    assert found.statuses == ["max_iter"] * 5
    assert np.all(found.n_iter <= max_iter)
    assert "not all" not in repr(found)
    for each, pair in zip(found, pairs, strict=True):
        assert each.residual >= true_residual(pair, each)
        assert each.dual <= each.primal


@pytest.mark.filterwarnings("ignore::clmorph.ConvergenceWarning")
def test_rounding_that_is_in_the_way_is_told(device, rng):
    pairs = [*random_pairs(rng, 2, (30, 60)), *random_pairs(rng, 1, (1, 2))]
    found = solve(pairs, 0.1, 0.3, 1e-12, 300, backend=device)
    alone = [clmorph.sinkhorn(*pair, 0.1, 0.3, 1e-12, 300, backend=device) for pair in pairs]
    assert found.statuses == [each.status for each in alone]
    assert "precision" in found.statuses


def test_errors_name_the_problem(rng):
    good = random_pairs(rng, 1)[0]
    for wrong, text in (
        (((-np.ones(3), np.zeros((3, 3))), good[1]), r"^problem 1: source: its weights: one is -1"),
        ((good[0], (np.ones(2), np.zeros((2, 2)))), r"^problem 1: source has points in 3 dim"),
        (((2 * good[0][0], good[0][1]), good[1]), r"^problem 1: the masses .* differ"),
        (((good[0][0], 1e6 * good[0][1]), good[1]), r"^problem 1: blur=1e-05 is too small"),
    ):
        blur = 1e-5 if "blur" in text else 0.1
        with pytest.raises(InputError, match=text):
            solve([good, wrong], blur, backend="numpy")
    with pytest.raises(InputError, match=r"there are 2 sources and 1 targets"):
        clmorph.sinkhorn_batch([good[0]] * 2, [good[1]], backend="numpy")
    weights = np.ones((3, 4))
    weights[1, 2] = np.nan
    even = np.ones((3, 4))
    with pytest.raises(InputError, match=r"targets\[1\]: its weights: one is nan; expected masses"):
        clmorph.sinkhorn_batch((even, even), (weights, even), backend="numpy")
    for shapes in (((3, 4), (3, 5)), ((3,), (3, 2)), ((3, 4), (4, 3, 2)), ((2, 0), (2, 0, 3))):
        stack = tuple(map(np.ones, shapes))
        with pytest.raises(InputError):
            clmorph.sinkhorn_batch(stack, stack, backend="numpy")
    for wrong in (None, "text", good[0][0], clmorph.WeightedPoints(good[0][1], good[0][0]), {}):
        with pytest.raises(InputError, match=r"^sources is a \w+: expected stacked arrays"):
            clmorph.sinkhorn_batch(wrong, [good[1]], backend="numpy")


@pytest.mark.parametrize("name", ["method", "start", "truncation", "verify", "multiscale", "x"])
def test_options_of_single_problems_are_refused(rng, name):
    with pytest.raises(InputError, match=rf"^sinkhorn_batch has no option '{name}': .*[^\n]*$"):
        solve(random_pairs(rng, 1), backend="numpy", **{name: None})


def test_points_too_far_apart_for_float32_are_told(device):
    near, far = ([1.0], [[0.0]]), ([1.0, 1.0], [[0.0], [1e6]])
    pair = near, ([1.0], [[0.1]])
    pairs = [pair, (([1.0, 1.0], [[0.0], [1e6]]), far), pair]
    with pytest.raises(InputError) as alone:
        clmorph.sinkhorn(*pairs[1], 1.0, 1e5, backend=device)
    with pytest.raises(InputError, match=r"^problem 1: ") as told:
        solve(pairs, 1.0, 1e5, backend=device)
    assert str(told.value) == f"problem 1: {alone.value}"


# --- divergences --------------------------------------------------------------------------------


@pytest.mark.parametrize("reach", [0.3, None])
def test_divergences_are_those_of_each_pair(any_backend, rng, reach):
    measures = [cloud(rng, n) for n in (1, 20, 70, 33)]
    options = {"blur": 0.1, "reach": reach, "tol": 1e-5, "backend": any_backend}
    matrix = clmorph.divergence_matrix(measures, **options)
    assert matrix.converged
    assert np.array_equal(np.asarray(matrix), matrix.values)
    assert np.array_equal(matrix.values, matrix.values.T)
    assert np.all(np.diag(matrix.values) == 0)
    for i in range(4):
        for j in range(4):
            alone = clmorph.sinkhorn_divergence(measures[i], measures[j], **options)
            found = matrix[i, j]
            assert found.interval[0] <= alone.interval[1]
            assert alone.interval[0] <= found.interval[1]
            assert found.value == pytest.approx(alone.value, rel=1e-3, abs=1e-6)
            entries = [part[i, j] for part in (matrix.values, matrix.low, matrix.high)]
            assert [found.value, *found.interval] == entries
            sizes = len(measures[i][0]), len(measures[j][0])
            assert (len(found.cross.f), len(found.cross.g)) == sizes
    assert matrix[0, 1].closer_than(matrix[0, 0]) is not True


def test_measures_with_themselves_converge_in_batches(any_backend, rng):
    """Few iterations are enough, and as many as in a solve of each one alone."""
    points, weights = rng.random((12, 64, 3)), np.full((12, 64), 1 / 64)
    options = {"blur": 0.05, "tol": 1e-6, "backend": any_backend}
    found = clmorph.sinkhorn_batch((weights, points), (weights, points), **options)
    assert found.converged
    assert found.n_iter.max() < 60
    for number, each in enumerate(found):
        measure = weights[number], points[number]
        alone = clmorph.sinkhorn(measure, measure, **options)
        assert alone.converged
        assert np.abs(each.f - alone.f).max() < 3e-6 * each.epsilon
        assert true_residual((measure, measure), each) <= each.residual


def test_small_residuals_are_reached_on_every_backend(any_backend, rng):
    """Sums in float32 end slow balanced solves at 1e-6 to 1e-5; then exact sums take over."""
    sources, targets = rng.random((2, 8, 40, 3))
    weights = np.full((8, 40), 1 / 40)
    options = {"blur": 0.07, "tol": 1e-8, "max_iter": 5000, "backend": any_backend}
    found = clmorph.sinkhorn_batch((weights, sources), (weights, targets), **options)
    assert found.converged
    for number, each in enumerate(found):
        pair = (weights[number], sources[number]), (weights[number], targets[number])
        alone = clmorph.sinkhorn(*pair, **options)
        for solved in (each, alone):
            assert solved.converged
            assert true_residual(pair, solved) <= solved.residual <= 1e-8


def test_self_terms_are_solved_once(monkeypatch, rng):
    solve_many = Mock(side_effect=sinkhorn_batch.solve_many)
    monkeypatch.setattr("clmorph.transport.divergence_batch.solve_many", solve_many)
    weights, points = np.full((5, 6), 1 / 6), rng.random((5, 6, 2))
    points[4] = points[1]
    matrix = clmorph.divergence_matrix((weights, points), 0.1, 0.3, backend="numpy")
    # Five with themselves; of ten pairs one is of equal measures.
    assert sum(len(call.args[0]) for call in solve_many.call_args_list) == 5 + 9
    assert matrix.values[1, 4] == matrix.low[1, 4] == 0
    assert np.count_nonzero(matrix.values) == 18
    assert repr(matrix) == "<DivergenceMatrix of 5 measures, all converged>"
    for wrong, words in (
        (lambda: list(matrix), "expected two, as in"),
        (lambda: matrix[0, :], "whole"),
    ):
        with pytest.raises(TypeError, match=words):
            wrong()


def test_what_has_no_divergence(rng):
    measures = [cloud(rng, 4), cloud(rng, 5)]
    with pytest.raises(InputError, match=r"expected one number for both measures"):
        clmorph.divergence_matrix(measures, 0.1, (0.1, 0.2), backend="numpy")
    heavy = 2 * measures[1][0], measures[1][1]
    with pytest.raises(InputError, match=r"^measures 0 and 1: the masses .* differ"):
        clmorph.divergence_matrix([measures[0], heavy], 0.1, backend="numpy")
    with pytest.raises(InputError, match=r"^measures 0 and 1: source has points in 3 dimensions"):
        clmorph.divergence_matrix([measures[0], cloud(rng, 4, 2)], 0.1, backend="numpy")
    offsets = clmorph.WeightedPoints(measures[0][1], measures[0][0], np.ones(4))
    with pytest.raises(InputError, match=r"no divergence"):
        clmorph.divergence_matrix([offsets], 0.1, backend="numpy")
    with pytest.warns(ConvergenceWarning, match=r"1 of 3 .* measures 0 and 1: not conv") as told:
        clmorph.divergence_matrix(measures, 0.02, 2.0, 1e-6, 30, backend="numpy")
    assert told[0].filename == __file__
