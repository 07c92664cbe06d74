"""Test plans that are too large to store: draws from their rows, and moments of their rows."""

import numpy as np
import pytest
from plain import lift, morph, reference, sinkhorn
from several import pictures

import clmorph
from clmorph import InputError, barycentric_plan, particles, sample_plan, transport_plan


@pytest.fixture(scope="module")
def pair():
    rng = np.random.default_rng(7)
    source, target = lift(rng.random((9, 8, 3)), 0.7), lift(rng.random((7, 11, 3)), 0.7)
    potentials = sinkhorn(source, target, 0.15, 0.4, 1e-6, backend="numpy")
    return source, target, potentials, reference.transport_plan(source, target, potentials)


@pytest.mark.parametrize("draws", [1, 2, 8])
def test_draws_average_to_the_plan(any_backend, pair, draws):
    source, target, potentials, dense = pair
    plans = [
        sample_plan(source, target, potentials, draws, seed=seed, backend=any_backend)
        for seed in range(60)
    ]
    n, m = dense.shape
    for plan in plans:
        for marginal, axis in zip(plan.marginals, (1, 0), strict=True):
            assert np.allclose(marginal, dense.sum(axis=axis), rtol=1e-4)
        assert np.all(plan.row_mass > 0)
        assert np.all(plan.column_mass > 0)  # however few the draws
        assert len(plan) <= max(1, draws - 1) * n + m
        assert plan.dropped_mass < 1e-9
    mean = np.mean([plan.to_scipy().toarray() for plan in plans], axis=0)
    # The variance of one draw of mass w is at most w pi; stratified draws deviate less.
    one = 1 / (max(1, draws - 1) / dense.sum(axis=1)[:, None] + 1 / dense.sum(axis=0))
    assert np.all(np.abs(mean - dense) <= 5 * np.sqrt(one * dense / 60) + 2 * one / 60)
    for axis in (0, 1):
        assert np.allclose(mean.sum(axis=axis), dense.sum(axis=axis), rtol=0.5 / np.sqrt(draws))
    assert np.abs(mean - dense).sum() < 0.4 / np.sqrt(draws) * dense.sum()


@pytest.mark.parametrize("reach", [None, 0.3, (0.1, None)])
@pytest.mark.parametrize("draws", [1, 3])
def test_births_and_deaths_are_those_of_the_transport(any_backend, pair, reach, draws):
    """What draws happened to hit decides neither what dies nor what is born."""
    source, target = pair[:2]
    potentials = sinkhorn(source, target, 0.15, reach, 1e-4, backend=any_backend)
    plan = sample_plan(source, target, potentials, draws, backend=any_backend)
    moving = particles(source, target, plan)
    n, m = len(source), len(target)
    born, dying = np.zeros(m), np.zeros(n)
    rests = moving.links[:, 0] == moving.links[:, 1]
    ends = moving.links[rests, 0].astype(int)
    dying += np.bincount(ends[ends < n], moving.weights[rests, 0][ends < n], n)
    born += np.bincount(ends[ends >= n] - n, moving.weights[rests, 1][ends >= n], m)
    for rested, measure, moved in (
        (dying, source, potentials.row_mass),
        (born, target, potentials.column_mass),
    ):
        assert np.allclose(rested, np.maximum(0, measure.weights - moved), atol=1e-4 / n)
    # Both ends stay exact: every pixel has its own mass.
    for end, measure, first in ((0, source, 0), (1, target, n)):
        here = moving.weights[:, end] > 0
        points = moving.links[here, end].astype(int) - first
        masses = np.bincount(points, moving.weights[here, end], len(measure))
        assert np.allclose(masses, measure.weights, rtol=1e-9)
    # With "drop" it is the drawn pairs alone.
    moving = particles(source, target, plan, unmatched="drop")
    assert np.array_equal(moving.weights, np.column_stack((plan.mass, plan.mass)))


def test_the_same_seed_draws_the_same(device, pair):
    source, target, potentials, _ = pair
    one, same, other = (
        sample_plan(source, target, potentials, 4, seed=seed, backend=device) for seed in (3, 3, 4)
    )
    assert np.array_equal(one.indices, same.indices)
    assert np.array_equal(one.mass, same.mass)
    assert not np.array_equal(one.indices, other.indices)


def test_barycentric(any_backend, pair):
    source, target, potentials, dense = pair
    got = barycentric_plan(source, target, potentials, backend=any_backend)
    share = dense / dense.sum(axis=1, keepdims=True)
    assert np.allclose(got.positions, share @ target.positions, atol=1e-5)
    assert np.allclose(got.colors, share @ target.colors, atol=1e-5)
    assert np.allclose(got.row_mass, dense.sum(axis=1), rtol=1e-4)
    assert np.allclose(got.column_mass, dense.sum(axis=0), rtol=1e-4)
    for row in (0, 17, 71):
        want = np.cov(target.points.T, aweights=share[row], ddof=0)
        assert np.allclose(got.covariance[row], want, atol=2e-5)
    assert len(got) == len(source)


@pytest.mark.parametrize("options", [{"sample": 6}, {"barycentric": True}])
def test_morphs_of_summaries_look_like_the_whole(device, options):
    whole = morph(*pictures((24, 24)), 3, backend=device)
    less = morph(*pictures((24, 24)), 3, backend=device, **options)
    assert len(less.particles) < 0.5 * len(whole.particles)
    for ours, theirs in zip(less.frames, whole.frames, strict=True):
        assert np.sqrt(np.mean((ours - theirs) ** 2)) < 0.06


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda s, t, p: sample_plan(s, t, p, 0, backend="numpy"), "draws=0"),
        (lambda s, t, p: sample_plan(s, t, p, 2.5, backend="numpy"), "draws=2.5"),
        (lambda s, t, p: sample_plan(s, t, p, 2, seed=-1, backend="numpy"), "seed=-1"),
        (lambda s, t, p: sample_plan(t, s, p, 2, backend="numpy"), "compute them for these"),
        (lambda s, t, p: barycentric_plan("x", t, p), "expected a Measure"),
        (lambda s, t, p: morph(np.zeros((2, 2)), np.zeros((2, 2)), sample=0), "sample=0"),
        (
            lambda s, t, p: morph(np.zeros((2, 2)), np.zeros((2, 2)), sample=2, barycentric=True),
            "contradict",
        ),
    ],
)
def test_mistakes(pair, call, words):
    with pytest.raises(InputError, match=words) as caught:
        call(*pair[:3])
    assert "\n" not in str(caught.value)


def test_without_color_weight_there_is_no_mean_color(pair):
    source, target = (lift(np.eye(4)[first : first + 2], 0.0) for first in (0, 2))
    potentials = sinkhorn(source, target, backend="numpy")
    with pytest.raises(InputError, match="color_weight=0"):
        barycentric_plan(source, target, potentials, backend="numpy")


def test_a_plan_without_mass_draws_nothing(device):
    """A reach so small that all mass dies where it is."""
    source, target = (clmorph.WeightedPoints(np.full((3, 2), at), np.ones(3)) for at in (0.0, 50.0))
    potentials = sinkhorn(source, target, 0.05, 0.05, backend=device)
    plan = sample_plan(source, target, potentials, 2, backend=device)
    assert len(plan) == 0
    assert plan.total_mass == transport_plan(source, target, potentials, backend=device).total_mass
