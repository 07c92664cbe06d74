"""Gradients in closed form, against central differences of dense solves in float64."""

from dataclasses import replace

import numpy as np
import pytest
from plain import reference

import clmorph
from clmorph import ConvergenceWarning, InputError
from clmorph.transport._solver.plan_softmin import FEW_NEAR

REACHES = [0.4, 3.0, (0.3, 1.0), (0.5, None), None]
#: Of the largest component.
TOLERANCE = 1e-4
STEP, EXACT = 1e-4, {"tol": 1e-11, "max_iter": 10**5}
NAMES = ("source_weights", "source_points", "target_weights", "target_points")


def problem(rng, balanced, n=9, m=12, dimension=2):
    a, b = rng.uniform(0.5, 1.5, n), rng.uniform(0.5, 2.0, m)
    if balanced:
        a, b = a / a.sum(), b / b.sum()
    return (a, rng.random((n, dimension))), (b, 0.3 + rng.random((m, dimension)))


def value(source, target, blur, reach):
    """The value of a transport problem, from a solve in float64."""
    return clmorph.sinkhorn(source, target, blur, reach, backend="numpy", **EXACT).dual


def divergence(source, target, blur, reach):
    masses = source[0].sum(), target[0].sum()
    cross = value(source, target, blur, reach) + 0.5 * blur**2 * (masses[0] - masses[1]) ** 2
    selves = value(source, source, blur, reach) + value(target, target, blur, reach)
    return cross - 0.5 * selves


def check(got, function, pair, rng, balanced):
    """Compare with central differences in a random direction of each of the four arrays."""
    for number, name in enumerate(NAMES):
        derivative = getattr(got, name)
        direction = rng.normal(size=derivative.shape)
        if balanced and name.endswith("weights"):
            direction -= direction.mean()  # masses stay equal
        values = []
        for step in (STEP, -STEP):
            moved = [*pair[0], *pair[1]]
            moved[number] = moved[number] + step * direction
            values.append(function(tuple(moved[:2]), tuple(moved[2:])))
        want = (values[0] - values[1]) / (2 * STEP)
        limit = TOLERANCE * np.abs(derivative).max() * np.abs(direction).sum() ** 0.5
        assert np.vdot(derivative, direction) == pytest.approx(want, rel=0, abs=limit), name


@pytest.mark.parametrize("reach", REACHES)
def test_value_against_differences(any_backend, rng, reach):
    pair = problem(rng, reach in (None, (0.5, None)))
    solved = clmorph.sinkhorn(*pair, 0.2, reach, 1e-6, 5000, any_backend)
    got = clmorph.gradient(*pair, solved, backend=any_backend)
    check(got, lambda *moved: value(*moved, 0.2, reach), pair, rng, reach is None)


@pytest.mark.parametrize("reach", [0.1, 0.4, 3.0, None])
def test_divergence_against_differences(any_backend, rng, reach):
    pair = problem(rng, reach is None)
    found = clmorph.sinkhorn_divergence(*pair, 0.2, reach, 1e-6, 5000, any_backend, gradient=True)
    check(found.gradient, lambda *moved: divergence(*moved, 0.2, reach), pair, rng, reach is None)


@pytest.mark.filterwarnings("ignore::clmorph.ConvergenceWarning")
@pytest.mark.parametrize("reach", [0.3, None])
@pytest.mark.parametrize("blur", [0.1, pytest.param(0.01, marks=pytest.mark.small)])
def test_against_the_dense_plan(any_backend, rng, blur, reach):
    """Every component, at a blur so small that exponents need more than float32."""
    pair = problem(rng, reach is None, 30, 25, 3)
    (a, x), (_, y) = pair
    # some devices round so much that 1e-6 is out of reach
    solved = clmorph.sinkhorn(*pair, blur, reach, 1e-6, 20000, any_backend)
    assert solved.status == "converged" or (solved.status == "precision" and solved.residual < 1e-5)
    got = clmorph.gradient(*pair, solved, backend=any_backend)
    exact = clmorph.sinkhorn(*pair, blur, reach, 1e-9, 20000, "numpy")
    plan = reference.transport_plan(*pair, exact)
    forth = plan.sum(axis=1)[:, None] * x - plan @ y
    back = plan.sum(axis=0)[:, None] * y - plan.T @ x
    np.testing.assert_allclose(got.source_points, forth, atol=TOLERANCE * np.abs(forth).max())
    np.testing.assert_allclose(got.target_points, back, atol=TOLERANCE * np.abs(back).max())
    if reach is None:
        np.testing.assert_allclose(got.source_weights.mean(), 0, atol=1e-12)
    else:
        # OT is positively homogeneous but for the entropic term: Euler's relation.
        rho, epsilon = reach**2, blur**2
        mass = plan.sum()
        want = (rho + epsilon * pair[1][0].sum()) * a.sum() - (rho + epsilon) * mass
        assert a @ got.source_weights == pytest.approx(want, rel=1e-5)


@pytest.mark.parametrize("reach", [0.3, None])
def test_equal_measures_and_points_without_mass(any_backend, rng, reach):
    (a, x), _ = problem(rng, True)
    a[2] = 0.0
    a /= a.sum()
    options = {"tol": 1e-6, "backend": any_backend, "gradient": True}
    same = clmorph.sinkhorn_divergence((a, x), (a, x), 0.2, reach, **options).gradient
    for name in NAMES:
        assert not getattr(same, name).any()
    moved = clmorph.sinkhorn_divergence((a, x), (a, x + 0.2), 0.2, reach, **options).gradient
    for name in NAMES:
        assert np.isfinite(getattr(moved, name)).all()
    assert not moved.source_points[2].any()
    # The weight of a point far from the target should shrink, also if the point has no mass.
    assert np.ptp(moved.source_weights) > 0


def test_no_gradient_of_other_problems(rng):
    pair = problem(rng, False)
    solved = clmorph.sinkhorn(*pair, 0.2, 0.5, backend="numpy")
    with pytest.raises(InputError, match="other measures"):
        clmorph.gradient(pair[0], (pair[1][0], pair[1][1] + 1), solved, backend="numpy")
    # Neither their interval nor a second derivative would be true.
    moved, change = (pair[0][0], pair[0][1] + 0.3), (*pair[0][::-1], *pair[1][::-1])
    divergence = clmorph.sinkhorn_divergence(*pair, 0.2, 0.5, backend="numpy", cross=solved)
    for known in (solved, replace(solved, measures=None, passes=None)):
        with pytest.raises(InputError, match="other measures"):
            clmorph.sinkhorn_divergence(moved, pair[1], 0.2, 0.5, backend="numpy", cross=known)
    for known in (solved, divergence):
        with pytest.raises(InputError, match="solved: potentials are of other measures"):
            clmorph.hessian_product(moved, pair[1], known, clmorph.Gradient(*change))
    with pytest.raises(InputError, match="gradient='yes'"):
        clmorph.sinkhorn_divergence(*pair, 0.2, 0.5, backend="numpy", gradient="yes")
    metric = np.tile(np.eye(3), (3, 3, 1, 1))
    source = clmorph.lift(rng.random((3, 3, 3)), color_metric=metric)
    target = clmorph.lift(rng.random((3, 3, 3)))
    solved = clmorph.sinkhorn(source, target, 0.2, 0.5, backend="numpy")
    with pytest.raises(InputError, match="metric for each source pixel"):
        clmorph.gradient(source, target, solved, backend="numpy")


@pytest.mark.parametrize("reach", [0.4, None])
def test_a_batch_gives_what_a_loop_gives(any_backend, rng, reach):
    pairs = [problem(rng, reach is None, n, m) for n, m in ((9, 12), (30, 7), (1, 1))]
    pairs.append((pairs[0][0], pairs[0][0]))  # equal measures
    pairs.append((pairs[0][0], pairs[1][1]))  # measures that occurred before
    sources, targets = zip(*pairs, strict=True)
    options = {"tol": 1e-6, "max_iter": 5000, "backend": any_backend, "gradient": True}
    found = clmorph.sinkhorn_divergence_batch(sources, targets, 0.2, reach, **options)
    for pair, got in zip(pairs, found, strict=True):
        want = clmorph.sinkhorn_divergence(*pair, 0.2, reach, **options)
        assert got.value == pytest.approx(want.value, rel=1e-5, abs=1e-7)
        assert max(got.interval[0], want.interval[0]) <= min(got.interval[1], want.interval[1])
        largest = max(np.abs(getattr(want.gradient, name)).max() for name in NAMES)
        for name in NAMES:
            ours, theirs = (getattr(each.gradient, name) for each in (got, want))
            np.testing.assert_allclose(ours, theirs, rtol=0, atol=TOLERANCE * largest + 1e-7)
    assert float(found[3]) == 0.0
    assert not found[3].gradient.source_points.any()
    assert clmorph.sinkhorn_divergence_batch([], [], 0.2, reach, backend="numpy") == []


@pytest.mark.full
@pytest.mark.filterwarnings("ignore::clmorph.ConvergenceWarning")
def test_weights_of_measures_whose_points_hardly_share_mass(any_backend):
    """Plans of measures with themselves are nearly diagonal: they determine f + g alone."""
    rng = np.random.default_rng(0)
    points, weights = rng.random((2, 40, 3)), np.full(40, 1 / 40)
    pair = (weights, points[0]), (weights, points[1])
    direction = rng.normal(size=40)
    direction -= direction.mean()
    more, less = (
        divergence((weights + step * direction, points[0]), pair[1], 0.05, None)
        for step in (1e-5, -1e-5)
    )
    want = (more - less) / 2e-5
    options = {"blur": 0.05, "tol": 1e-6, "backend": any_backend, "gradient": True}
    # float32 ends the solve between both measures a little before
    (batched,) = clmorph.sinkhorn_divergence_batch([pair[0]], [pair[1]], **options)
    alone = clmorph.sinkhorn_divergence(*pair, **options)
    for found in (batched, alone):
        assert found.gradient.source_weights @ direction == pytest.approx(want, rel=3e-4)
    for own in (batched.source_self, batched.target_self, clmorph.sinkhorn(pair[0], pair[0], 0.05)):
        assert np.array_equal(own.f, own.g)


def test_a_batch_names_the_pair_that_is_wrong(rng):
    good, bad = problem(rng, False), (([1.0], [[np.nan, 0.0]]), ([1.0], [[0.0, 0.0]]))
    with pytest.raises(InputError, match=r"^problem 1: "):
        clmorph.sinkhorn_divergence_batch(*zip(good, bad, strict=True), 0.2, 0.5, backend="numpy")
    with pytest.warns(ConvergenceWarning, match="problem 0"):
        clmorph.sinkhorn_divergence_batch([good[0]], [good[1]], 0.01, 0.5, 1e-6, 1, backend="numpy")


@pytest.mark.full
@pytest.mark.parametrize(("blur", "length"), [(0.02, 12.0), (0.3, 1.0)])
def test_truncated_sums(any_backend, rng, blur, length):
    """With few near pairs, and with so many that all pairs are summed."""
    (a, x), (b, y) = problem(rng, False, 700, 900)
    pair = (a, x * [length, 1.0]), (b, y * [length, 1.0])
    options = {"tol": 1e-5, "max_iter": 5000, "backend": any_backend, "multiscale": False}
    near = clmorph.sinkhorn(*pair, blur, 0.2, **options, truncation=1e-7)
    assert (near.visited <= FEW_NEAR) == (length > 1)
    got = clmorph.gradient(*pair, near, backend=any_backend)
    exact = clmorph.sinkhorn(*pair, blur, 0.2, **options, truncation=None)
    want = clmorph.gradient(*pair, exact, backend=any_backend)
    for name in NAMES:
        limit = TOLERANCE * np.abs(getattr(want, name)).max()
        np.testing.assert_allclose(getattr(got, name), getattr(want, name), rtol=0, atol=limit)


def test_mistakes_of_hessian_products_are_named(rng):
    parts = [rng.random((6, 2)), rng.random(6) + 0.5, rng.random((8, 2)), rng.random(8) + 0.5]
    change = [rng.standard_normal(each.shape) for each in parts]
    pair = (parts[1], parts[0]), (parts[3], parts[2])
    solved = clmorph.sinkhorn(*pair, blur=0.3, reach=0.5, backend="numpy")
    good = clmorph.Gradient(*change)
    for arguments, words in (
        ((*pair, None, good), "solved"),
        ((*pair, solved, None), "direction"),
        ((*pair, solved, clmorph.Gradient(*change[::-1])), "direction: source_points"),
        (((0 * parts[1] + [0, 1, 1, 1, 1, 1], parts[0]), pair[1], solved, good), "positive"),
    ):
        with pytest.raises(InputError, match=words) as caught:
            clmorph.hessian_product(*arguments)
        assert "\n" not in str(caught.value)
