"""The permutation between equal clouds, and the bound on its cost, against SciPy's exact solver."""

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

import clmorph
from clmorph.transport.assignment import assign, lower_bound, permutation_cost


def _clouds(n: int, dimensions: int = 5) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(n)
    return rng.uniform(size=(n, dimensions)), rng.uniform(size=(n, dimensions)) ** 2


def _optimum(source: np.ndarray, target: np.ndarray) -> float:
    cost = cdist(source, target, "sqeuclidean") / 2
    return float(cost[linear_sum_assignment(cost)].mean())


@pytest.mark.parametrize("n", [1, 2, 3, 199, 200, 201, 1000])
def test_permutation(n):
    source, target = _clouds(n)
    found = assign(source, target)
    assert sorted(found.permutation) == list(range(n))
    assert found.cost == permutation_cost(source, target, found.permutation)
    optimum = _optimum(source, target)
    assert optimum * (1 - 1e-12) <= found.cost <= 1.01 * optimum


def test_same_clouds_are_matched_exactly():
    source, _ = _clouds(500)
    order = np.random.default_rng(1).permutation(500)
    found = assign(source, source[order])
    assert found.cost == 0.0
    np.testing.assert_array_equal(order[found.permutation], np.arange(500))


def test_equal_points():
    found = assign(np.zeros((300, 5)), np.ones((300, 5)))
    assert sorted(found.permutation) == list(range(300))
    assert found.cost == 2.5


def test_seed_fixes_the_permutation():
    clouds = _clouds(600)
    first, second = (assign(*clouds, seed=3).permutation for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_time_limit_still_gives_a_permutation():
    clouds = _clouds(500)
    found = assign(*clouds, seconds=0.0)
    assert sorted(found.permutation) == list(range(500))
    assert found.cost > assign(*clouds).cost


def test_destinations_begin_the_search():
    source, target = _clouds(400)
    order = np.random.default_rng(2).permutation(400)
    found = assign(source, target, destinations=target[order], seconds=0.0)
    np.testing.assert_array_equal(found.permutation, order)


@pytest.mark.parametrize("scale", [0.0, 1e-3, 0.1, 10.0])
def test_any_potentials_give_a_bound(scale):
    source, target = _clouds(300)
    g = scale * np.random.default_rng(0).standard_normal(300)
    expected = (cdist(source, target, "sqeuclidean") / 2 - g).min(axis=1).mean() + g.mean()
    bound = lower_bound(source, target, g)
    assert bound <= _optimum(source, target)
    assert bound <= expected
    assert bound == pytest.approx(expected, abs=1e-11 * max(1.0, scale))


def test_bound_of_the_solver_is_tight(device):
    source, target = _clouds(200)
    masses = np.full(200, 1 / 200)
    potentials = clmorph.sinkhorn(
        (masses, source), (masses, target), blur=0.03, tol=1e-2, backend=device
    )
    optimum = _optimum(source, target)
    assert 0.98 * optimum <= lower_bound(source, target, potentials.g) <= optimum
