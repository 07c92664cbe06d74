"""Solves in 12 to 1,024 dimensions: certificates, derivatives, plans, batches."""

import numpy as np
import pytest

import clmorph
from clmorph.measures.points import as_pair
from clmorph.transport._solver.problem import is_large

DIMENSIONS = [12, 13, 17, 30, 50, 64, 128, 1024]
BLUR, REACH = 0.3, 1.0


def clouds(rng, dimension, n=70, m=45):
    """Two Gaussian clouds whose squared distances are about 1 in any dimension."""
    x, y = (rng.normal(size=(count, dimension)) / (2 * dimension) ** 0.5 for count in (n, m))
    a, b = rng.random(n), rng.random(m)
    return (a / a.sum(), x), (b / b.sum(), y + 0.2 / dimension**0.5)


def exact_dual(source, target, f, g, reach):
    """The dual at given potentials, summed over all pairs in float64 from differences."""
    (a, x), (b, y), epsilon = source, target, BLUR**2
    cost = 0.5 * np.array([np.square(row - y).sum(axis=1) for row in x])
    penalty = np.array(0.0)
    for weights, potential in ((a, f), (b, g)):
        if reach is None:
            penalty = penalty + weights @ potential
        else:
            penalty = penalty - reach**2 * (weights @ np.expm1(-potential / reach**2))
    mass = a @ np.exp((f[:, None] + g - cost) / epsilon) @ b
    return penalty + epsilon * (a.sum() * b.sum() - mass)


@pytest.mark.parametrize("reach", [REACH, None])
@pytest.mark.parametrize("dimension", DIMENSIONS)
def test_certificates(any_backend, rng, dimension, reach):
    """The bounds enclose the value of a far better solve, wherever the points are."""
    pair = clouds(rng, dimension)
    exact = clmorph.sinkhorn(*pair, BLUR, reach, tol=1e-9, backend="numpy")
    for offset in (0.0, 1e5):
        moved = [(weights, points + offset) for weights, points in pair]
        found = clmorph.sinkhorn(*moved, BLUR, reach, backend=any_backend)
        assert found.converged
        assert max(found.dual, exact.dual) <= min(found.primal, exact.primal)
        dual = exact_dual(*moved, found.f, found.g, reach)
        assert found.dual <= dual + 1e-10
        assert dual - found.dual <= 1e-3 * BLUR**2
        assert found.map(moved[0][1]).shape == pair[0][1].shape


@pytest.mark.parametrize("dimension", DIMENSIONS)
def test_derivatives(any_backend, rng, dimension):
    pair = clouds(rng, dimension, 20, 17)
    options = {"blur": BLUR, "reach": REACH}
    near = clmorph.sinkhorn_divergence(
        *pair, **options, tol=1e-6, gradient=True, backend=any_backend
    )
    direction = rng.normal(size=pair[0][1].shape)
    step = 1e-4 / np.abs(direction).max()
    low, high = (
        clmorph.sinkhorn_divergence(
            (pair[0][0], pair[0][1] + sign * step * direction), pair[1],
            **options, tol=1e-10, backend="numpy",
        ).value
        for sign in (-1, 1)
    )  # fmt: skip
    slope = near.gradient.source_points
    size = np.linalg.norm(slope) * np.linalg.norm(direction)
    assert np.vdot(slope, direction) == pytest.approx((high - low) / (2 * step), abs=1e-4 * size)


@pytest.mark.parametrize("dimension", DIMENSIONS)
def test_plans_and_stored_forms(any_backend, rng, dimension):
    pair = clouds(rng, dimension)
    found = clmorph.sinkhorn(*pair, BLUR, REACH, tol=1e-6, backend=any_backend)
    (a, x), (b, y) = pair
    cost = 0.5 * np.array([np.square(row - y).sum(axis=1) for row in x])
    want = a[:, None] * b * np.exp((found.f[:, None] + found.g - cost) / BLUR**2)
    plan = clmorph.transport_plan(*pair, found, relative=1e-9, backend=any_backend)
    assert plan.toarray() == pytest.approx(want, rel=1e-4, abs=1e-9)
    truncated = clmorph.sinkhorn(
        *pair, BLUR, REACH, multiscale=True, truncation=1e-5, tol=1e-4, backend=any_backend
    )
    assert truncated.converged
    assert max(truncated.dual, found.dual) <= min(truncated.primal, found.primal)


@pytest.mark.parametrize("dimension", DIMENSIONS)
def test_batches_agree_with_single_problems(any_backend, rng, dimension):
    pairs = [clouds(rng, dimension, n, m) for n, m in ((30, 70), (65, 1), (20, 20))]
    sources, targets = zip(*pairs, strict=True)
    options = {"blur": BLUR, "reach": REACH, "backend": any_backend}
    many = clmorph.sinkhorn_batch(list(sources), list(targets), **options)
    for found, pair in zip(many, pairs, strict=True):
        alone = clmorph.sinkhorn(*pair, **options)
        assert found.n_iter == alone.n_iter
        assert found.f == pytest.approx(alone.f, abs=1e-5)
        assert max(found.dual, alone.dual) <= min(found.primal, alone.primal)


def test_many_pairs_in_many_dimensions_are_summed_whole():
    """Boxes and clusters hardly save anything there."""
    for dimension, large in ((11, True), (12, False)):
        points = np.zeros((12_000, dimension))
        assert is_large(as_pair(points, points)) == large
