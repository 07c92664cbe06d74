"""Each operation on each device against its NumPy version."""

import inspect
import itertools
from dataclasses import dataclass

import numpy as np
import pytest
from clouds import PAIRS

from clmorph.backends.interface import KERNEL_ERROR, Operations
from clmorph.backends.opencl.backend import OpenCLOperations
from clmorph.backends.opencl.build.constants import MOMENT_CHUNK
from clmorph.backends.opencl.build.variants import all_variants
from clmorph.backends.opencl.kernels.gauss_transform import moments_pay
from clmorph.backends.opencl.kernels.launches import LaunchBudget
from clmorph.backends.opencl.verification.bench import Bench, Clouds, log_sum_exp_tolerance
from clmorph.backends.opencl.verification.splats import Range, splat_tolerance
from clmorph.backends.opencl.verification.table import TABLE
from clmorph.backends.records import WIDTH_LEVELS, PlanTerms
from clmorph.reference import NumPyOperations

REFERENCE = NumPyOperations()
#: Particles that each way of splatting adds up before they join the total.
CHUNKS = {"gather": 256, "moments": MOMENT_CHUNK}
BLURS = [1.0, 0.3, 0.1, 0.05, 0.02, 0.01, 0.003]


def _upload(operations, pair):
    return [operations.upload(*cloud) for cloud in pair]


def _potential(rng, n, epsilon):
    """Potentials of the size that solutions have, rough by a few epsilon."""
    return 0.2 * rng.random() + epsilon * rng.normal(size=n)


@dataclass(frozen=True)
class NastyBench(Bench):
    """A backend that is compared on a pair of clouds of `PAIRS`."""

    pair: tuple = ()
    blur: float = 1.0

    def clouds(self, *_, **__):
        return [Clouds(*self.both, *self.pair, self.blur**2)]


@pytest.mark.parametrize(
    "file", sorted({built.file for built in all_variants() if built.dimension})
)
@pytest.mark.parametrize("blur", BLURS[::2])
@pytest.mark.parametrize("name", PAIRS)
def test_reductions(variant, rng, name, blur, file):
    """What the table of checks compares is right for nasty clouds, too."""
    bench = NastyBench(variant, pair=PAIRS[name](rng), blur=blur)
    for row, built in itertools.product(TABLE, all_variants()):
        # Thresholds of columns are rounded by more than precise exponents.
        rounded = file == "plan_rows.cl" and built.precise
        if row.file == built.file == file and not rounded:
            for finding in row.run(bench, built):
                assert finding.passed, str(finding)


def _exactly(pair, g, epsilon):
    """T(g) in long double."""
    (x, _), (y, b) = pair
    wide = np.longdouble
    cost = np.zeros((len(x), len(y)), wide)
    for d in range(x.shape[1]):
        cost += (wide(1) * x[:, None, d] - wide(1) * y[:, d]) ** 2 / 2
    with np.errstate(divide="ignore"):
        exponents = (wide(1) * g - cost) / wide(epsilon) + np.log(wide(1) * b)
    largest = exponents.max(axis=1)
    return -wide(epsilon) * (largest + np.log(np.exp(exponents - largest[:, None]).sum(axis=1)))


@pytest.mark.parametrize("blur", BLURS)
@pytest.mark.parametrize("name", PAIRS)
def test_bounded_softmin_is_as_near_as_it_says(variant, rng, name, blur):
    """The error does not exceed the reported bound, which is small."""
    pair = PAIRS[name](rng)
    epsilon = blur**2
    g = _potential(rng, len(pair[1][0]), epsilon)
    want = _exactly(pair, g, epsilon)
    sizes = [np.abs(cloud[0]).max() for cloud in pair]
    largest = pair[0][0].shape[1] * max(sizes) ** 2 / epsilon
    for backend in (variant, REFERENCE):
        got, error = backend.bounded_softmin(*_upload(backend, pair), g, epsilon)
        assert np.abs(got - want).max() / epsilon <= error
        assert error <= 1e-8 + 1e-11 * (100 + largest)


@pytest.mark.in_turns  # a build for each dimension takes half a minute on some devices
@pytest.mark.parametrize("dimension", [1, 2, 4, 7, 9, 11])
def test_bounded_softmin_in_any_dimension_and_over_near_pairs(variant, rng, dimension):
    pair = [(rng.random((n, dimension)), rng.random(n) ** 30) for n in (100, 150)]
    for cloud in pair:
        cloud[1][::3] = 0
    epsilon = 0.002
    g = _potential(rng, 150, epsilon)
    want = _exactly(pair, g, epsilon)
    for backend in (variant, REFERENCE):
        clouds = _upload(backend, pair)
        got, error = backend.bounded_softmin(*clouds, g, epsilon)
        assert np.abs(got - want).max() / epsilon <= error
        near = backend.near_pairs(*clouds, g, got, epsilon, 1e-3)
        errors = []
        for enough in (0.0, 1e-5, 3e-5, 1e-3, 1.0):
            got, error = backend.bounded_softmin(*clouds, g, epsilon, near, enough)
            missing = (got - want) / epsilon
            assert error <= enough + 3e-6
            assert missing.min() >= -error
            assert np.all(missing <= 1.01 * near.skipped + error)
            errors.append(error)
        assert errors == sorted(errors)
        if isinstance(backend, OpenCLOperations) and backend.constants.precise == 2:
            assert errors[-1] > errors[1] > errors[0]  # float32 is used where it is allowed


@pytest.mark.parametrize("epsilon", [1.0, 1e-3])
def test_a_softmin_of_numbers_without_a_bound_says_so(variant, rng, epsilon):
    """Coordinates so large that their exponents leave float32 no digit."""
    x = np.array([[0.0, 0.0], [1e6, 1e6]])[rng.integers(0, 2, 100)]
    pair = [(x, np.ones(100)), (x + 0.5 * rng.random((100, 2)), np.ones(100))]
    got, error = variant.bounded_softmin(*_upload(variant, pair), np.zeros(100), epsilon)
    assert error > 1e-4
    off = np.abs(got - _exactly(pair, np.zeros(100), epsilon)).max() / epsilon
    assert np.isinf(error) or off <= error


def test_softmin_survives_huge_potentials(variant, rng):
    pair = PAIRS["random"](rng)
    g = np.zeros(403)
    g[::7] = 1e4
    g[1::7] = -1e4
    want = REFERENCE.softmin(*_upload(REFERENCE, pair), g, 0.01)
    for precise in (False, True):
        got = variant.softmin(*_upload(variant, pair), g, 0.01, precise)
        tolerance = log_sum_exp_tolerance(variant, *pair, 0.01, precise)
        assert np.abs(got - want).max() / 0.01 <= tolerance


def _half_solved(pair, epsilon, rng):
    """Clouds of the reference, and potentials after one iteration."""
    clouds = _upload(REFERENCE, pair)
    f = _potential(rng, len(pair[0][0]), epsilon)
    g = REFERENCE.softmin(*clouds[::-1], f, epsilon)
    return clouds, REFERENCE.softmin(*clouds, g, epsilon), g


@pytest.mark.parametrize("guessed", [True, False])
@pytest.mark.parametrize("budget", [1e-7, 1e-4, 0.05])
@pytest.mark.parametrize("blur", [0.3, 0.05, 0.01])
@pytest.mark.parametrize("name", PAIRS)
def test_near_pairs(variant, rng, name, blur, budget, guessed):
    """What is left out is within what is said of it, and that within the budget."""
    pair, epsilon = PAIRS[name](rng), blur**2
    exact, whole, g = _half_solved(pair, epsilon, rng)
    guess = whole + epsilon * (0.5 * rng.normal(size=len(whole)) if guessed else 0.0)
    tolerance = log_sum_exp_tolerance(variant, *pair, epsilon)
    for backend, rounding in ((variant, tolerance), (REFERENCE, 1e-9)):
        clouds = _upload(backend, pair)
        near = backend.near_pairs(*clouds, g, guess, epsilon, budget)
        assert near.skipped.min() >= 0
        assert near.n_pairs >= len(whole) * len(g) or near.skipped.max() > 0
        assert near.skipped.max() <= (30 if guessed else 1.5) * budget
        assert len(whole) <= near.n_pairs
        softmin = backend.softmin(*clouds, g, epsilon, False, near)
        precise = backend.softmin(*clouds, g, epsilon, True, near)
        for values in (near.softmin, softmin, precise):
            missing = (values - whole) / epsilon
            assert missing.min() >= -rounding
            assert np.all(missing <= near.skipped + rounding)
        less = (softmin - near.softmin) / epsilon
        assert less.min() >= -2 * rounding
        assert np.all(less <= near.skipped + 2 * rounding)
        maxima = backend.row_maxima(*clouds, g, epsilon, near)
        largest = REFERENCE.row_maxima(*exact, g, epsilon)
        sums = -whole / epsilon
        shares = np.exp(np.maximum(maxima, largest) - sums)
        assert np.all((np.abs(maxima - largest) <= rounding) | (shares <= 1.1 * near.skipped))


def test_near_pairs_leave_out_most_of_far_clusters(variant, rng):
    """Four clusters, as far apart as mass does not go: a quarter of the pairs is left."""
    middles = 3.0 * np.arange(4)[:, None, None]
    x, y = ((middles + 0.1 * rng.random((4, 256, 5))).reshape(-1, 5) for _ in range(2))
    clouds = [variant.upload(points, np.full(1024, 1 / 1024)) for points in (x, y)]
    g = np.zeros(1024)
    whole = variant.softmin(*clouds, g, 0.0025)
    near = variant.near_pairs(*clouds, g, whole, 0.0025, 1e-4)
    assert near.n_pairs <= 1024**2 / 4
    assert near.n_columns <= 256


@pytest.mark.parametrize("blur", [0.1, 0.02])
def test_groups_of_tiles_are_bounded_first(variant, monkeypatch, rng, blur):
    """Nothing else is left out than without groups, but for what the budget allows."""
    middles = rng.random((40, 1, 3))
    x, y = ((middles + 0.05 * rng.random((40, 90, 3))).reshape(-1, 3) for _ in range(2))
    epsilon, g = blur**2, blur**2 * rng.normal(size=3600)
    pair = [(points, np.full(3600, 1 / 3600)) for points in (x, y)]
    clouds = _upload(variant, pair)
    whole = REFERENCE.softmin(*_upload(REFERENCE, pair), g, epsilon)
    thresholds = [np.log(1e-5) + np.full(3600, -np.log(3600)), np.full(3600, np.inf)]
    kept, counts = [], []
    for limit in (1 << 60, 0):
        monkeypatch.setattr("clmorph.backends.opencl.kernels.candidates.WIDE_FROM", limit)
        monkeypatch.setattr("clmorph.backends.opencl.kernels.plan_rows.LISTED_FROM", 0)
        near = variant.near_pairs(*clouds, g, whole, epsilon, 1e-5)
        missing = (near.softmin - whole) / epsilon
        assert near.skipped.max() <= 1.5e-5
        assert missing.max() <= near.skipped.max() + 1e-3
        kept.append(near.n_pairs)
        counts.append(variant.count_plan_rows(PlanTerms(*clouds, whole, g, epsilon, *thresholds)))
    assert kept[1] == pytest.approx(kept[0], rel=0.1)
    assert np.array_equal(*counts)


def test_a_hopeless_guess_costs_pairs_but_not_the_bound(variant, rng):
    """The bound holds for any guess of the sums, and a second choice has a better one.

    Far too small a sum guessed for: everything looks large, and nothing is left out.
    """
    pair = PAIRS["random"](rng)
    clouds, epsilon = _upload(variant, pair), 0.01
    g = np.zeros(403)
    whole = variant.softmin(*clouds, g, epsilon)
    high = variant.near_pairs(*clouds, g, whole + 400 * epsilon, epsilon, 1e-4)
    assert high.n_pairs >= 257 * 403
    few = 400 * (np.arange(257) % 50 == 0)
    rounding = log_sum_exp_tolerance(variant, *pair, epsilon)
    for off in (-400, -30, 3, 30, few, -few):
        near = variant.near_pairs(*clouds, g, whole + off * epsilon, epsilon, 1e-4)
        assert np.all(np.isfinite(near.softmin))
        again = variant.near_pairs(*clouds, g, near.softmin, epsilon, 1e-4)
        third = variant.near_pairs(*clouds, g, again.softmin, epsilon, 1e-4)
        assert third.skipped.max() <= 2e-4
        softmin = variant.softmin(*clouds, g, epsilon, False, near)
        assert np.all((softmin - whole) / epsilon <= near.skipped + rounding)


@pytest.mark.parametrize("precise", [False, True])
def test_launches_are_cut_without_changing_a_bit(variant, monkeypatch, rng, precise):
    """Over all pairs, and over near ones."""
    pair = [(rng.random((n, 5)), np.full(n, 1 / n)) for n in (700, 900)]
    clouds, g = _upload(variant, pair), rng.random(900)
    guess = variant.softmin(*clouds, g, 0.01)
    results = []
    for pairs in (1 << 40, 1):
        monkeypatch.setattr(LaunchBudget, "pairs", lambda self, pairs=pairs: pairs)
        near = variant.near_pairs(*clouds, g, guess, 0.01, 1e-3)
        sums = [variant.softmin(*clouds, g, 0.01, precise, pairs) for pairs in (None, near)]
        results.append([near.softmin, near.skipped, *sums])
    assert all(np.array_equal(*both) for both in zip(*results, strict=True))


def _solved(pair, epsilon, rng):
    """Potentials about a solution, and thresholds by row and by column."""
    clouds, f, g = _half_solved(pair, epsilon, rng)
    columns = REFERENCE.softmin(clouds[1], clouds[0], f, epsilon)
    row_thresholds = clouds[0].log_weights + np.log(1e-6)
    column_thresholds = (g - columns) / epsilon + clouds[1].log_weights + np.log(1e-8)
    thresholds = [np.where(np.isneginf(x), np.inf, x) for x in (row_thresholds, column_thresholds)]
    return f, g, thresholds


@pytest.mark.parametrize("by_near", [False, True])
@pytest.mark.parametrize("blur", [0.3, 0.05, 0.01])
@pytest.mark.parametrize("name", PAIRS)
def test_sums_over_stored_pairs(variant, rng, name, blur, by_near):
    pair = PAIRS[name](rng)
    epsilon = blur**2
    f, g, thresholds = _solved(pair, epsilon, rng)
    sums = []
    changes = 3 * rng.normal(size=len(g)), 3 * rng.normal(size=len(f))
    for backend in (variant, REFERENCE):
        rows, columns = _upload(backend, pair)
        near = None, None
        if by_near:
            near = tuple(
                backend.near_pairs(*clouds, values, backend.softmin(*clouds, values, epsilon),
                                   epsilon, 1e-9)
                for clouds, values in (((rows, columns), g), ((columns, rows), f))
            )  # fmt: skip
        plan = PlanTerms(rows, columns, f, g, epsilon, *thresholds)
        stored = backend.store_pairs(plan, 10**9, near)
        assert 0 < stored.n_pairs <= len(f) * len(g)
        sums.append([backend.sum_stored(stored, changes[i], bool(i)) for i in range(2)])
        for i, order in enumerate(stored.orders):
            in_order = changes[i][stored.orders[1 - i]]
            got = backend.sum_stored(stored, in_order, bool(i), ordered=True)
            assert np.array_equal(got, sums[-1][i][order])
        assert backend.store_pairs(plan, stored.n_pairs - 1, near) is None
    tolerance = log_sum_exp_tolerance(variant, *pair, epsilon)
    for got, want, (_, weights) in zip(*sums, pair, strict=True):
        assert np.array_equal(np.isneginf(got), weights == 0)
        assert np.array_equal(np.isneginf(want), weights == 0)
        # A pair on the threshold may be stored by one only, and changes by up to e^15.
        difference = np.abs(got[weights > 0] - want[weights > 0])
        assert difference.max() <= 2 * tolerance + 0.1
        assert np.quantile(difference, 0.9) <= 2 * tolerance + 1e-4


def test_stored_sums_are_those_of_changed_potentials(variant, rng):
    """With next to nothing left out, a softmin at other potentials."""
    pair, epsilon = PAIRS["random"](rng), 0.01
    f, g, _ = _solved(pair, epsilon, rng)
    clouds = _upload(variant, pair)
    thresholds = [np.full(len(x), -1e4) for x in (f, g)]
    stored = variant.store_pairs(PlanTerms(*clouds, f, g, epsilon, *thresholds), 10**9)
    assert stored.n_pairs == len(f) * len(g)
    changes = rng.normal(size=len(g)) + 100.0
    tolerance = log_sum_exp_tolerance(variant, *pair, epsilon)
    for farthest in (100.0, 1000.0):  # the last is far beyond what float32 could multiply
        changes[::2] -= farthest - 100.0
        got = variant.sum_stored(stored, changes, False)
        softmin = REFERENCE.softmin(*_upload(REFERENCE, pair), g + epsilon * changes, epsilon)
        want = (f - softmin) / epsilon + np.log(pair[0][1])
        assert np.abs(got - want).max() <= tolerance + farthest * 2.0**-23


def test_stored_launches_are_cut_without_changing_a_bit(variant, monkeypatch, rng):
    pair, epsilon = [(rng.random((n, 5)), np.full(n, 1 / n)) for n in (700, 900)], 0.01
    f, g, thresholds = _solved(pair, epsilon, rng)
    results = []
    for most in (1 << 22, 5000):
        monkeypatch.setattr("clmorph.backends.opencl.kernels.row_loop.FILL_PAIRS", most)
        clouds = _upload(variant, pair)
        stored = variant.store_pairs(PlanTerms(*clouds, f, g, epsilon, *thresholds), 10**9)
        results.append([variant.sum_stored(stored, x, by) for x, by in ((g, False), (f, True))])
        parts = len(stored.pairs[0].parts)
    assert parts > 3
    assert all(np.array_equal(*both) for both in zip(*results, strict=True))


@pytest.mark.parametrize("name", PAIRS)
def test_plan_rows_follow_their_counts(variant, rng, name):
    """With counts that are given, and without; columns ascend inside a row."""
    pair = PAIRS[name](rng)
    exact, f, g = _half_solved(pair, 0.0025, rng)
    by_row = REFERENCE.row_maxima(*exact, g, 0.0025) + f / 0.0025 + exact[0].log_weights
    limits = by_row + np.log(1e-3), np.full(len(g), by_row.max() - 3.0)
    for backend in (variant, REFERENCE):
        plan = PlanTerms(*_upload(backend, pair), f, g, 0.0025, *limits)
        counts, rows = backend.count_plan_rows(plan), backend.plan_rows(plan)
        assert rows.indptr.tolist() == [0, *np.cumsum(counts)]
        assert len(rows.mass) == len(rows.indices) == rows.indptr[-1] > 0
        assert all(map(np.array_equal, rows, backend.plan_rows(plan, False, counts)))
        row_of = np.repeat(np.arange(len(f)), counts)
        assert np.all(np.diff(row_of * len(g) + rows.indices) > 0)


@pytest.mark.parametrize("precise", [False, True])
@pytest.mark.parametrize("blur", [0.3, 0.05, 0.01])
@pytest.mark.parametrize("name", PAIRS)
def test_plan_rows_by_lists_are_the_same(variant, monkeypatch, rng, name, blur, precise):
    """Tiles without a pair above its threshold are left out, and nothing else."""
    pair, epsilon = PAIRS[name](rng), blur**2
    exact, f, g = _half_solved(pair, epsilon, rng)
    by_row = REFERENCE.row_maxima(*exact, g, epsilon) + f / epsilon + exact[0].log_weights
    by_column = REFERENCE.row_maxima(*exact[::-1], f, epsilon) + g / epsilon
    by_column += exact[1].log_weights
    clouds = _upload(variant, pair)
    infinite = np.full(len(g), np.inf)
    for thresholds in (
        (by_row + np.log(1e-3), by_column + np.log(1e-2)),
        (np.full(len(f), by_row.max() - 5.0), infinite),
        (np.full(len(f), np.inf), infinite),
        (np.full(len(f), -np.inf), infinite),
    ):
        results = []
        for smallest in (1 << 62, 0):
            monkeypatch.setattr("clmorph.backends.opencl.kernels.plan_rows.LISTED_FROM", smallest)
            plan = PlanTerms(*clouds, f, g, epsilon, *thresholds)
            counts = variant.count_plan_rows(plan, precise)
            rows = variant.plan_rows(plan, precise, counts)
            results.append((counts, *rows[:2]))
            results[-1] += (np.log(np.maximum(rows.mass, 1e-290)),)
        for all_of_it, listed in list(zip(*results, strict=True))[:-1]:
            assert np.array_equal(all_of_it, listed)
        if np.isinf(thresholds[0][0]):  # nothing, or every pair of masses
            massive = [np.count_nonzero(weights) for _, weights in pair]
            assert counts.sum() == (np.prod(massive) if thresholds[0][0] < 0 else 0)
        # Where a row is measured from depends on what is listed.
        difference = np.abs(results[0][-1] - results[1][-1]).max(initial=0.0)
        assert difference <= 2 * log_sum_exp_tolerance(variant, *pair, epsilon, precise)


# --- particles --------------------------------------------------------------------------

SPLATS = {
    "spread": lambda rng: rng.uniform(-0.5, 40.5, (3000, 2)),
    "one": lambda rng: np.array([[17.25, 3.5]]),
    "on pixels": lambda rng: rng.integers(0, 40, (500, 2)),
    "on bin edges": lambda rng: 8.0 * rng.integers(-1, 6, (200, 2)),
    "all in one place": lambda rng: np.full((1500, 2), 11.3),  # more than are summed at once
    "outside": lambda rng: rng.uniform(-200, 200, (2000, 2)),
    "far outside": lambda rng: rng.uniform(-1e9, 1e9, (300, 2)),
}
SHAPES = [(33, 41), (1, 1), (16, 16), (5, 70)]


def _splats(rng, name, operations, spaced=False):
    positions = np.asarray(SPLATS[name](rng), np.float32)
    rng = np.random.default_rng(7)
    colors = rng.random((len(positions), 3)).astype(np.float32)
    weights = (10 ** rng.uniform(-10, 0, len(positions))).astype(np.float32)
    spacings = [(2 ** rng.uniform(-4, 3, len(weights))).astype(np.float32)] if spaced else []
    return [backend.upload_splats(positions, colors, weights, *spacings) for backend in operations]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("name", SPLATS)
def test_bins_and_nearest_pixels(variant, rng, name, shape):
    """Bins are exact, and deposits are, but for rounding and squares of tiny masses."""
    splats, exact = _splats(rng, name, (variant, REFERENCE))
    assert variant.bin_size == REFERENCE.bin_size
    got, want = variant.bin_splats(splats, shape, 2), REFERENCE.bin_splats(exact, shape, 2)
    assert got.shape == want.shape
    assert np.array_equal(got.starts, want.starts)
    assert np.array_equal(got.order, want.order)
    got, want = variant.deposit(splats, shape), REFERENCE.deposit(exact, shape)
    n, largest = len(exact.weights), exact.weights.max()
    relative = splat_tolerance(n, CHUNKS["gather"])
    for values, wanted, unit in zip(got, want, (largest, largest**2), strict=True):
        assert values.shape == shape
        assert np.all(np.abs(values - wanted) <= relative * wanted + n * unit * 1e-30)


@pytest.fixture(params=["gather", "moments"])
def method(request, variant, monkeypatch):
    """Both ways from particles to pixels, wherever the second serves."""
    monkeypatch.setattr(variant.splatting, "method", request.param)
    return request.param


@pytest.mark.parametrize("sigma", [0.0, 0.3, 0.34, 1.34, 6.0, 40.0])
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("name", SPLATS)
def test_splat(variant, method, rng, name, shape, sigma):
    splats, exact = _splats(rng, name, (variant, REFERENCE))
    radius = 4.5 * sigma
    sums = variant.splat(splats, shape, sigma, radius)
    assert sums[0].shape == (*shape, 3)
    assert sums[1].shape == shape
    # Far-out positions are rounded to float32 before the distance is taken; the kernel
    # then is where the reference puts it, because the reference has the same positions.
    relative = splat_tolerance(len(exact.weights), CHUNKS[method])
    assert Range.of(exact, shape, sigma, radius).excess(sums, relative) <= 1
    if method == "gather":
        want = REFERENCE.splat(exact, shape, sigma, radius)
        assert np.all(np.abs(sums[1] - want[1]) <= relative * want[1])
        assert np.all(np.abs(sums[0] - want[0]) <= relative * want[1][..., None])


@pytest.mark.parametrize("radius_in_sigmas", [2.0, 3.0, 4.5])
def test_the_cut_stays_within_its_bound(variant, method, rng, radius_in_sigmas):
    splats, exact = _splats(rng, "spread", (variant, REFERENCE))
    shape, sigma = (41, 41), 1.4
    cut = variant.splat(splats, shape, sigma, radius_in_sigmas * sigma)
    uncut = REFERENCE.splat(exact, shape, sigma, np.inf)
    bound = exact.weights.sum() * np.exp(-0.5 * radius_in_sigmas**2)
    missing = uncut[1] - cut[1]
    assert missing.max() <= bound
    off = KERNEL_ERROR * exact.weights.sum() if method == "moments" else 0.0
    assert missing.min() >= -1e-4 * bound - off
    assert np.abs(uncut[0] - cut[0]).max() <= bound


def test_strips_change_nothing_but_rounding(variant, monkeypatch, rng):
    splats, exact = _splats(rng, "spread", (variant, REFERENCE))
    monkeypatch.setattr(variant.splatting, "method", "moments")
    shape = 100, 41
    whole = variant.splat(splats, shape, 0.8, 3.6)
    monkeypatch.setattr("clmorph.backends.opencl.kernels.gauss_transform.STRIP_BYTES", 1)
    strips = variant.splat(splats, shape, 0.8, 3.6)
    for sums in (whole, strips):
        relative = splat_tolerance(len(exact.weights))
        assert Range.of(exact, shape, 0.8, 3.6).excess(sums, relative) <= 1


def test_moments_are_taken_where_they_pay():
    dense = moments_pay(300_000, (64, 64), 1.4, 6.3, 16)
    assert dense
    assert not moments_pay(3000, (64, 64), 1.4, 6.3, 16)  # hardly one to a pixel
    assert not moments_pay(300_000, (2048, 2048), 1.4, 6.3, 16)
    assert not moments_pay(300_000, (64, 64), 0.0, 0.0, 16)
    assert not moments_pay(300_000, (64, 64), 0.2, 0.9, 16)
    assert not moments_pay(300_000, (64, 64), 1.4, np.inf, 16)


def test_nearest_pixel_gives_each_splat_to_one_pixel(variant, method, rng):
    positions = rng.uniform(-0.5, 19.499, (400, 2)).astype(np.float32)
    ones = np.ones(400, np.float32)
    splats = variant.upload_splats(positions, np.ones((400, 3), np.float32), ones)
    _, counts = variant.splat(splats, (20, 20), 0.0, 0.0)
    pixels = np.floor(positions + np.float32(0.5)).astype(int)
    want = np.zeros((20, 20))
    np.add.at(want, (pixels[:, 1], pixels[:, 0]), 1)
    assert np.array_equal(counts, want)


@pytest.mark.parametrize("name", ["spread", "all in one place"])
def test_splatting_launches_are_cut_without_changing_a_bit(variant, method, monkeypatch, rng, name):
    """With the particles of a bin in chunks, too."""
    splats, _ = _splats(rng, name, (variant, REFERENCE))
    results = []
    for pairs in (1 << 30, 1):
        monkeypatch.setattr(LaunchBudget, "pairs", lambda self, pairs=pairs: pairs)
        results.append(variant.splat(splats, (300, 41), 1.4, 6.3))
    assert all(map(np.array_equal, *results))


def test_offsets_add_to_the_cost(variant, rng):
    """C_ij = |X_i - Y_j|^2 / 2 + r_i + s_j in every reduction, by the definition."""
    epsilon, n, m = 0.05, 90, 131
    x, y = rng.random((n, 5)), rng.random((m, 5))
    a, b = rng.random(n), rng.random(m)
    r, s = rng.normal(size=n), rng.normal(size=m)
    f, g = 0.1 * rng.random(n), 0.1 * rng.random(m) + s
    exponents = (
        g - s - r[:, None] - 0.5 * np.sum((x[:, None] - y) ** 2, axis=2)
    ) / epsilon + np.log(b)
    for backend, tolerance in ((variant, 2e-4), (REFERENCE, 1e-12)):
        rows, columns = backend.upload(x, a, r), backend.upload(y, b, s)
        want = -epsilon * np.logaddexp.reduce(exponents, axis=1)
        softmin = backend.softmin(rows, columns, g, epsilon)
        assert np.abs(softmin - want).max() <= tolerance * epsilon
        maxima = backend.row_maxima(rows, columns, g, epsilon)
        assert np.abs(maxima - exponents.max(axis=1)).max() <= tolerance
        log_plan = exponents + (f / epsilon + np.log(a))[:, None]
        kept = backend.plan_rows(
            PlanTerms(rows, columns, f, g, epsilon, np.full(n, -np.inf), np.full(m, np.inf))
        )
        assert len(kept.mass) == n * m
        dense = np.exp(log_plan)
        assert np.all(np.abs(kept.mass.reshape(n, m) - dense) <= 2 * tolerance * dense)
        share = np.exp(exponents + softmin[:, None] / epsilon)
        mean, _ = backend.plan_moments(rows, columns, g, softmin, epsilon)
        assert np.abs(mean - share @ y).max() <= 10 * tolerance
        projected = backend.barycentric_projection(rows, columns, g, epsilon)
        assert np.abs(projected[0] - want).max() <= tolerance * epsilon
        assert np.abs(projected[1] - share @ y).max() <= 10 * tolerance


@pytest.mark.parametrize("sigma", [0.3, 1.2])
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("name", SPLATS)
def test_splats_with_own_widths(variant, method, rng, name, shape, sigma):
    splats, exact = _splats(rng, name, (variant, REFERENCE), spaced=True)
    distances = 2 ** rng.uniform(-3, 7, shape)
    own = [variant.adapt_widths(splats, distances, sigma)]
    own.append(REFERENCE.adapt_widths(exact, distances, sigma))
    levels, wanted = variant.width_levels(own[0]), REFERENCE.width_levels(own[1])
    # Between two levels rounding decides, and then so does float32.
    assert np.abs(levels - wanted).max() <= 1
    assert np.mean(levels != wanted) <= 1e-3
    # From here on with the same levels.
    scaled = exact.weights.astype(float) / WIDTH_LEVELS.factor(levels) ** 2
    same = own[1]._replace(width_levels=levels, weights=scaled)
    got = variant.splat(own[0], shape, sigma, 4.5 * sigma)
    relative = 2 * splat_tolerance(len(levels), CHUNKS[method])
    assert Range.of(same, shape, sigma, 4.5 * sigma).excess(got, relative) <= 1


def test_widths_by_their_definition(variant):
    """max(sigma spacing, distance / 2), and each kernel's sum is that of sigma."""
    position = np.array([[20.0, 20.0]], np.float32)
    one, white = np.ones(1, np.float32), np.ones((1, 3), np.float32)
    for backend in (variant, REFERENCE):
        for spacing, distance, width in ((1, 0, 1), (4, 0, 4), (1, 8, 4), (0.25, 1, 0.5)):
            splats = backend.upload_splats(position, white, one, np.float32([spacing]))
            own = backend.adapt_widths(splats, np.full((41, 41), float(distance)), 1.0)
            assert WIDTH_LEVELS.factor(backend.width_levels(own)[0]) == width
            _, sums = backend.splat(own, (41, 41), 1.0, 4.5)
            y, x = np.mgrid[:41, :41] - 20.0
            want = np.exp(-(x**2 + y**2) / (2 * width**2)) / width**2
            inside = (np.abs(x) <= 4.5 * width) & (np.abs(y) <= 4.5 * width)
            assert np.allclose(sums, np.where(inside, want, 0), rtol=1e-4, atol=1e-9)
        assert backend.width_levels(splats).tolist() == [WIDTH_LEVELS.base]


@pytest.mark.full
def test_a_canvas_of_4096_pixels_a_side(device):
    """At every place a frame equals the frame on a small canvas around that place."""
    rng = np.random.default_rng(0)
    places = np.round(64 * rng.uniform(-20, 4116, (60_000, 2))) / 64  # exact when moved
    colors, weights = rng.random((2, 60_000, 3))[0], rng.random(60_000)

    def drawn(places, chosen, side):
        arrays = (each[chosen].astype(np.float32) for each in (places, colors, weights))
        return device.splat(device.upload_splats(*arrays), (side, side), 1.5, 7.0)

    whole = drawn(places, slice(None), 4096)
    for corner in ((0, 0), (2048, 3000), (4032, 4032)):
        moved = places - corner[::-1]  # places are (x, y)
        near = np.all((moved > -16) & (moved < 80), axis=1)
        assert near.sum() > 20
        for large, small in zip(whole, drawn(moved, near, 64), strict=True):
            assert np.abs(small).max() > 0.1
            section = large[corner[0] : corner[0] + 64, corner[1] : corner[1] + 64]
            # The cut may lie a kernel width farther out in one of both.
            assert np.abs(section - small).max() <= 10 * (
                KERNEL_ERROR + np.exp(-0.5 * (7 / 1.5) ** 2)
            )


def test_twins_have_the_protocols_signatures(device):
    names = [name for name in vars(Operations) if not name.startswith("_")]
    operations = [name for name in names if callable(getattr(Operations, name, None))]
    assert operations
    for name in operations:
        wanted = list(inspect.signature(getattr(Operations, name)).parameters)[1:]
        for backend in (REFERENCE, device):
            assert list(inspect.signature(getattr(backend, name)).parameters) == wanted, name
