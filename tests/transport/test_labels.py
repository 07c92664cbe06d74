"""Labels: mass keeps its label, exactly, in every form of the plan and at every size."""

import numpy as np
import plain
import pytest
from numpy.testing import assert_allclose
from scipy.special import kl_div, logsumexp

import clmorph
from clmorph import InputError
from clmorph.images.label_maps import reduced_labels
from clmorph.transport import subproblems
from clmorph.transport._solver import softmin
from clmorph.transport.regularization import regularization


def pictures(rng, height=12, width=14):
    """Two random pictures and labels 0 and 5 of both; a corner of the first is 7 alone."""
    a, b = rng.random((2, height, width, 3))
    one, other = np.zeros((2, height, width), int)
    one[4:9, 3:9] = 5
    one[:2, :3] = 7
    other[2:7, 5:12] = 5
    return a, b, (one, other)


def leakage(plan, labels):
    """Return the mass of pairs of different labels."""
    one, other = (each.ravel() for each in labels)
    return plan.mass[one[plan.rows] != other[plan.indices]].sum()


def masked_plan(source, target, labels, blur, reach, rounds=4000):
    """Solve, in float64, the problem whose cost between labels is infinite, over dense arrays."""
    x, y, a, b = source.points, target.points, source.weights, target.weights
    cost = 0.5 * np.sum((x[:, None] - y[None]) ** 2, axis=2)
    cost[labels[0].ravel()[:, None] != labels[1].ravel()[None]] = np.inf
    epsilon, rho = blur**2, reach**2
    f, g = np.zeros(len(a)), np.zeros(len(b))
    damping = -epsilon * rho / (rho + epsilon)
    for _ in range(rounds):
        f = damping * logsumexp((g - cost) / epsilon, axis=1, b=b)
        g = damping * logsumexp((np.where(np.isfinite(f), f, 0) - cost.T) / epsilon, axis=1, b=a)
    finite = np.isfinite(f)
    plan = np.zeros(cost.shape)
    plan[finite] = (
        np.exp((f[finite, None] + g[None] - cost[finite]) / epsilon) * a[finite, None] * b[None]
    )
    value = np.sum(plan[plan > 0] * cost[plan > 0])
    value += rho * (kl_div(plan.sum(1), a).sum() + kl_div(plan.sum(0), b).sum())
    return plan, value + epsilon * kl_div(plan, a[:, None] * b).sum()


@pytest.mark.small
@pytest.mark.parametrize(
    "form",
    [
        {},
        {"sample": 5},
        {"solve_size": 7},
        {"solve_size": 7, "sample": 6},
        {"solve_size": 4, "max_particles": 400},
        {"unmatched": "grow"},
    ],
    ids=str,
)
def test_no_mass_changes_its_label(any_backend, rng, form):
    a, b, labels = pictures(rng)
    morph = plain.morph(a, b, n_frames=2, labels=labels, tol=1e-2, backend=any_backend, **form)
    assert leakage(morph.plan, labels) == 0.0
    assert morph.plan.mass.sum() > 0.4
    # Label 7 has no partner: it stays at its place and fades.
    alone = labels[0].ravel() == 7
    assert not np.isin(morph.plan.rows, np.flatnonzero(alone)).any()
    fading = morph.particles.weights[np.isin(morph.particles.links[:, 0], np.flatnonzero(alone))]
    assert_allclose(fading[:, 0].sum(), morph.source.weights[alone].sum(), rtol=1e-12)
    assert not fading[:, 1].any()
    for t, image in ((0.0, a), (1.0, b)):
        assert np.abs(morph.frame(t) - image).max() < 1e-4
    without = plain.morph(a, b, n_frames=2, tol=1e-2, backend="numpy")
    assert leakage(without.plan, labels) > 0.01  # so that the test can fail


@pytest.mark.small
def test_the_plan_is_that_of_an_infinite_cost_between_labels(any_backend, rng):
    """And the certificate encloses the value of that problem."""
    a, b, labels = pictures(rng, 8, 9)
    source, target = plain.lift(a), plain.lift(b)
    options = {"blur": 0.1, "reach": 0.3}
    morph = plain.morph(a, b, n_frames=2, labels=labels, tol=1e-4, backend=any_backend, **options)
    wanted, value = masked_plan(source, target, labels, **options)
    found = morph.plan.to_scipy().toarray()
    # Pairs below 1e-4 of the largest one of their row are dropped; the residual is in nats.
    assert np.abs(found - wanted).max() < 2e-3 * wanted.max()
    assert_allclose(morph.plan.marginals[0], wanted.sum(1), rtol=2e-3, atol=1e-12)
    assert_allclose(morph.plan.marginals[1], wanted.sum(0), rtol=2e-3, atol=1e-12)
    potentials = morph.potentials
    slack = 1e-9 * abs(value)
    assert potentials.dual - slack <= value <= potentials.primal + slack
    assert potentials.gap < 1e-4 * abs(value)
    assert_allclose(potentials.transported_mass, wanted.sum(), rtol=1e-3)
    assert potentials.certificate.masses == (source.mass, target.mass)


def test_mean_destinations_are_means_of_their_own_label(rng):
    """Colors of label 0 of the target have no green, and those of label 5 are all green."""
    a, b, labels = pictures(rng)
    b[..., 1] = labels[1] == 5
    for size in (None, 7):
        options = {"barycentric": True, "solve_size": size, "backend": "numpy"}
        morph = plain.morph(a, b, n_frames=2, labels=labels, **options)
        own = labels[0].ravel()
        assert_allclose(morph.plan.colors[own == 5, 1], 1.0, atol=1e-6)
        assert_allclose(morph.plan.colors[own == 0, 1], 0.0, atol=1e-6)
        assert_allclose(morph.plan.positions[own == 7], morph.source.positions[own == 7])
        assert not morph.plan.row_mass[own == 7].any()


def test_reduced_pictures_have_the_label_that_most_pixels_have(rng):
    labels = np.array([[1, 1, 2], [1, 2, 2], [3, 3, 9]])
    assert reduced_labels(labels, (1, 1)).tolist() == [[1]]
    assert reduced_labels(labels, (3, 3)) is labels
    large = rng.integers(0, 3, (40, 30))
    small = reduced_labels(large, (8, 6))
    for row in range(8):
        for column in range(6):
            counts = np.bincount(large[5 * row : 5 * row + 5, 5 * column : 5 * column + 5].ravel())
            assert small[row, column] == np.argmax(counts)
    a, b = rng.random((2, 40, 30, 3))
    morph = plain.morph(a, b, n_frames=2, labels=(large, large), size=8, backend="numpy")
    assert morph.source.shape == (8, 6)
    assert leakage(morph.plan, (small, small)) == 0.0


def test_labels_with_landmarks_metrics_and_opacity(rng):
    a, b, labels = pictures(rng)
    marks, options = [((5, 6), (8, 4))], {"n_frames": 2, "labels": labels, "backend": "numpy"}
    morph = plain.morph(a, b, landmarks=marks, color_weight=0.5, **options)
    assert leakage(morph.plan, labels) == 0.0
    forth, _ = morph.plan.mean_destinations(morph.source.positions, morph.target.positions)
    corner = morph.target.positions.min(axis=0)
    assert np.hypot(*((forth[6 * 14 + 5] - corner) * 13 - (8, 4))) < 1.0
    metric = 1 + rng.random((12, 14))
    morph = plain.morph(a, b, color_metric=metric, **options)
    assert leakage(morph.plan, labels) == 0.0
    clear = np.dstack((a, rng.integers(0, 2, (12, 14))))
    for form in ({}, {"solve_size": 7}, {"solve_size": 4, "sample": 3}):
        morph = plain.morph(clear, b, **options, **form)
        assert leakage(morph.plan, labels) == 0.0
        assert not morph.plan.row_mass[clear[..., 3].ravel() == 0].any()


def test_balanced_labels_need_equal_masses(rng):
    a, b, labels = pictures(rng)
    labels[0][labels[0] == 7] = 0
    options = {"n_frames": 2, "labels": labels, "reach": None, "blur": 0.1, "backend": "numpy"}
    with pytest.raises(InputError, match=r"label 0 has mass 0.821429 in image_a and 0.791667"):
        plain.morph(a, b, **options)
    inside = [each == 5 for each in labels]
    maps = [np.where(each, 0.3 / each.sum(), 0.7 / (~each).sum()) for each in inside]
    morph = plain.morph(a, b, weights=tuple(maps), **options)
    assert leakage(morph.plan, labels) == 0.0
    assert_allclose(morph.plan.marginals[0], maps[0].ravel(), rtol=2e-2)
    assert morph.potentials.marginal_error < 1e-2
    # In float32 the masses of a label are equal but for rounding.
    rounded = tuple(each.astype(np.float32) for each in maps)
    plain.morph(a, b, weights=rounded, **options)
    some = np.where(a[..., 0] < 0.1, 7, 0), 0 * labels[1]
    with pytest.raises(InputError, match="label 7 has mass"):
        plain.morph(a, b, **options | {"labels": some, "reach": (None, 0.3)})


def test_inspection_measures_the_plan_that_a_morph_draws(rng):
    a, b, labels = pictures(rng)
    for form in ({}, {"solve_size": 7}, {"max_bytes": 50.0}, {"max_bytes": 50.0, "solve_size": 7}):
        options = {"labels": labels, "n_frames": 2, "backend": "numpy"}
        found = plain.inspect(a, b, **options, **form)
        form = {name: value for name, value in form.items() if name != "max_bytes"}
        morph = plain.morph(a, b, **options, **form)
        assert found.divergence is None
        assert "labels" in found.no_divergence
        assert_allclose(found.transported, morph.plan.total_mass, rtol=1e-9)
        assert_allclose(found.potentials.primal, morph.potentials.primal)
        moved = clmorph.displacement_statistics(morph.source, morph.target, morph.plan)
        assert_allclose(found.destroyed, moved.destroyed.sum(), rtol=0.05)
        if "solve_size" not in form:
            assert_allclose(found.displacement.mean, moved.mean, rtol=2e-3)
        assert any("labels" in line for line in found.lines())


@pytest.mark.parametrize(
    ("labels", "told"),
    [
        ((np.zeros((3, 3), int), np.zeros((12, 14), int)), r"labels of image_a has shape \(3, 3\)"),
        ((np.zeros((12, 14)), np.zeros((12, 14), int)), "dtype float64: expected integers"),
        ((np.zeros((12, 14), int), np.ones((12, 14), int)), r"no label has mass in both.*0 and 1"),
        ((np.arange(168).reshape(12, 14), np.arange(168, 336).reshape(12, 14)), "336 different"),
        (np.zeros((12, 14), int), "expected a pair of label images"),
        ((np.zeros((12, 14), int), None), "expected a pair of label images"),
        (("a.png", "b.png"), "labels of image_a is a path.*clmorph.read_labels"),
        ("ab", "expected a pair"),
    ],
)
def test_labels_that_cannot_be_used(rng, labels, told):
    a, b, _ = pictures(rng)
    with pytest.raises(InputError, match=told):
        plain.morph(a, b, n_frames=2, labels=labels, backend="numpy")


def test_a_label_of_all_pixels_changes_nothing(rng):
    a, b, labels = pictures(rng)
    one = tuple(np.full(each.shape, -3) for each in labels)
    for form in ({}, {"solve_size": 7}, {"barycentric": True, "solve_size": 7}):
        morph = plain.morph(a, b, n_frames=3, labels=one, backend="numpy", **form)
        alone = plain.morph(a, b, n_frames=3, backend="numpy", **form)
        assert_allclose(morph.frame(0.5), alone.frame(0.5), atol=1e-6)
        assert_allclose(morph.potentials.dual, alone.potentials.dual, rtol=1e-12)


def test_large_labels_go_through_coarser_problems(monkeypatch, rng):
    """The problem of each label is solved as `clmorph.sinkhorn` solves one."""
    a, b, labels = pictures(rng, 24, 24)
    given = regularization(0.05, 0.3, None, None)
    source, target = plain.lift(a), plain.lift(b)
    found = subproblems.by_label(source, target, labels, None, given)
    assert [part.label for part in found] == [0, 5]
    with monkeypatch.context() as changed:
        changed.setattr(softmin, "MANY_PAIRS", 1)
        masses, backend = (source.mass, target.mass), clmorph.get_backend("numpy")
        solved, whole = subproblems.solve_parts(found, masses, given, backend, lambda share: None)
    assert whole.truncation is not None
    for part, potentials in zip(found, solved, strict=True):
        alone = clmorph.sinkhorn(*part.measures, 0.05, 0.3, backend="numpy")
        assert_allclose(potentials.dual, alone.dual, rtol=1e-5)
