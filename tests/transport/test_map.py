"""The entropic map against its formula in float64, closed forms, and the plan's own means."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import softmax

import clmorph
from clmorph import InputError
from clmorph.backends.numpy import NumPyOperations
from clmorph.transport import entropic_map

#: Share of the target's diameter by which means may be wrong: sums of float32, and exponents
#: rounded by `entropic_map.ROUNDING` nats at most.
FLOAT32 = 3 * entropic_map.ROUNDING


def measures(rng, dimension, m=40, offsets=False):
    pair = []
    for n, begin, fourth in ((30, 0.0, 1.0), (m, 0.3, 0.0)):
        weights = rng.uniform(0.5, 2.0, n)
        weights[3] *= fourth
        cost = 0.02 * rng.random(n) if offsets else None
        points = begin + rng.random((n, dimension))
        pair.append(clmorph.WeightedPoints(points, weights / weights.sum(), cost))
    return tuple(pair)


def direct(points, target, g, epsilon):
    """T(x) = sum_j w_j y_j, w_j ~ b_j exp((g_j - C(x, y_j)) / epsilon)."""
    costs = 0.5 * np.square(points[:, None] - target.points[None]).sum(axis=2)
    costs = costs if target.offsets is None else costs + target.offsets
    masses = np.log(np.maximum(target.weights, 1e-300))
    return softmax((g - costs) / epsilon + masses, axis=1) @ target.points


@pytest.mark.parametrize("dimension", [1, 3, 5])
@pytest.mark.parametrize("reach", [None, 0.5, (0.3, None)])
def test_any_points_against_the_formula(any_backend, rng, dimension, reach):
    source, target = measures(rng, dimension, offsets=dimension == 3)
    solved = clmorph.sinkhorn(source, target, 0.1, reach, backend=any_backend)
    points = rng.normal(0.5, 1.0, (150, dimension))
    got = solved.map(points, backend=any_backend)
    want = direct(points, target, solved.g, solved.epsilon)
    np.testing.assert_allclose(got, want, rtol=0, atol=FLOAT32)
    back = solved.swapped().map(points, backend=any_backend)
    want_back = direct(points, source, solved.f, solved.epsilon)
    np.testing.assert_allclose(back, want_back, rtol=0, atol=FLOAT32)
    own = clmorph.sinkhorn(source, source, 0.1, reach, backend=any_backend)
    debiased = solved.map(points, own=own, backend=any_backend)
    steps = want - direct(points, source, own.g, own.epsilon)
    np.testing.assert_allclose(debiased, points + steps, rtol=0, atol=2 * FLOAT32)


@pytest.mark.parametrize("distance", [1e2, 1e4, 1e6])
@pytest.mark.parametrize("blur", [0.3, 0.01])
def test_far_points_are_as_exact(any_backend, rng, distance, blur):
    """They are sent to the outermost points, near ones of the same call to their own places."""
    source, target = measures(rng, 3)
    solved = clmorph.sinkhorn(source, target, blur, 1.0, tol=0.1, backend=any_backend)
    directions = rng.normal(size=(8, 3))
    directions /= np.abs(directions).max(axis=1, keepdims=True)
    points = np.concatenate([source.points, distance * directions])
    want = direct(points, target, solved.g, solved.epsilon)
    try:
        got = solved.map(points, backend=any_backend)
    except InputError as error:
        refused = str(error)
    else:
        np.testing.assert_allclose(got, want, rtol=0, atol=FLOAT32)
        return
    assert "use backend='numpy'" in refused
    assert distance / solved.epsilon > 1e9
    assert not isinstance(clmorph.get_backend(any_backend), NumPyOperations)


def test_own_points_have_the_means_of_the_plan(any_backend, rng):
    source, target = (clmorph.lift(rng.random((8, 9, 3)), color_weight=0.5) for _ in range(2))
    solved = clmorph.sinkhorn(source, target, 0.05, 0.3, backend=any_backend)
    plan = clmorph.barycentric_plan(source, target, solved, backend=any_backend)
    got = solved.map(source, backend=any_backend)
    np.testing.assert_allclose(got[:, :2], plan.positions, rtol=0, atol=FLOAT32)
    np.testing.assert_allclose(got[:, 2:] / 0.5, plan.colors, rtol=0, atol=2 * FLOAT32)
    again = solved.map(source.points, backend=any_backend)
    np.testing.assert_array_equal(got, again)


def test_debiased_map_of_equal_measures_is_the_identity(any_backend, rng):
    source, _ = measures(rng, 3)
    own = clmorph.sinkhorn(source, source, 0.2, 0.7, backend=any_backend)
    points = rng.random((50, 3))
    np.testing.assert_array_equal(own.map(points, own=own, backend=any_backend), points)


def test_many_points_are_mapped_in_parts(monkeypatch, rng):
    source, target = measures(rng, 11)
    solved = clmorph.sinkhorn(source, target, 0.1, backend="numpy")
    points = np.concatenate([rng.random((20, 11)), 1e3 * rng.random((20, 11))])
    want = solved.map(points, backend="numpy")
    monkeypatch.setattr(entropic_map, "CHUNK", 7)
    np.testing.assert_allclose(solved.map(points, backend="numpy"), want, rtol=0, atol=1e-12)


def test_small_cases(any_backend):
    one = np.ones(1), np.array([[2.0, 3.0, 4.0]])
    solved = clmorph.sinkhorn(one, one, backend=any_backend)
    assert solved.map(np.empty((0, 3)), backend=any_backend).shape == (0, 3)
    got = solved.map([[5.0, -1e6, 0.0]], backend=any_backend)
    np.testing.assert_array_equal(got, [[2.0, 3.0, 4.0]])


def test_target_can_be_given(rng):
    source, target = measures(rng, 2)
    solved = clmorph.sinkhorn(source, target, 0.1, backend="numpy")
    points = rng.random((5, 2))
    bare = replace(solved, measures=None)
    got = bare.map(points, target=(target.weights, target.points), backend="numpy")
    np.testing.assert_array_equal(got, solved.map(points, backend="numpy"))


@pytest.mark.parametrize(
    ("points", "options", "words"),
    [
        (np.zeros((4, 3)), {}, r"points have shape \(4, 3\): expected \(K, 2\)"),
        (np.zeros(4), {}, "expected"),
        ([[np.nan, 0.0]], {}, "finite"),
        ([[1e7, 0.0]], {}, "finite coordinates within"),
        ("x", {}, "points"),
        (np.zeros((1, 2)), {"target": (np.ones(2), np.zeros((2, 2)))}, "40 points|2"),
        (np.zeros((1, 2)), {"own": 3}, "own"),
    ],
)
def test_mistakes_are_named(rng, points, options, words):
    source, target = measures(rng, 2)
    solved = clmorph.sinkhorn(source, target, 0.1, backend="numpy")
    with pytest.raises(InputError, match=words) as caught:
        solved.map(points, backend="numpy", **options)
    assert "\n" not in str(caught.value)


def test_other_regularization_of_own_is_refused(rng):
    source, target = measures(rng, 2)
    solved = clmorph.sinkhorn(source, target, 0.1, backend="numpy")
    for blur, reach in ((0.2, None), (0.1, 0.5)):
        own = clmorph.sinkhorn(source, source, blur, reach, backend="numpy")
        with pytest.raises(InputError, match="own has blur="):
            solved.map(source.points, own=own, backend="numpy")


def test_own_of_other_measures_is_refused(rng):
    source, target = measures(rng, 2, m=30)
    solved = clmorph.sinkhorn(source, target, 0.1, backend="numpy")
    moved = replace(source, points=source.points + 5)
    for pair in ((moved, moved), (source, target)):
        own = clmorph.sinkhorn(*pair, 0.1, backend="numpy")
        with pytest.raises(InputError, match="own: potentials are of other measures"):
            solved.map(source.points, own=own, backend="numpy")


def test_unknown_measures_are_named(rng):
    pair = measures(rng, 2)
    batch = clmorph.sinkhorn_batch([pair[0]], [pair[1]], blur=0.1, backend="numpy")
    with pytest.raises(InputError, match="do not hold their measures"):
        batch[0].map(np.zeros((1, 2)), backend="numpy")
    a = np.random.default_rng(0).random((3, 3, 3))
    metric = np.tile(np.eye(3), (3, 3, 1, 1))
    source, target = clmorph.lift(a, color_metric=metric), clmorph.lift(a)
    solved = clmorph.sinkhorn(source, target, backend="numpy")
    with pytest.raises(InputError, match="do not hold their measures"):
        solved.map(target, backend="numpy")


def test_damaged_measures_are_named(rng):
    pair = measures(rng, 2)
    solved = clmorph.sinkhorn(*pair, 0.1, backend="numpy")
    own = clmorph.sinkhorn(pair[0], pair[0], 0.1, backend="numpy")
    points = np.zeros((1, 2))
    for damaged, words in (
        ("x", "do not hold"),
        (pair[:1], "do not hold"),
        (pair[::-1], "expected 30 and 30"),
        (("x", "x"), "target is a str"),
        (measures(rng, 3), "expected .K, 3."),
    ):
        with pytest.raises(InputError, match=words):
            replace(solved, measures=damaged).map(points, backend="numpy")
    for damaged in ("x", pair, measures(rng, 3, m=30)):
        with pytest.raises(InputError, match=r"own|points have shape"):
            solved.map(points, own=replace(own, measures=damaged), backend="numpy")
