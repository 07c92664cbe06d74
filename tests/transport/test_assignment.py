"""The permutation between equal clouds, and the bound on its cost, against SciPy's exact solver."""

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

import clmorph
from clmorph.transport.assignment import assign, merged, permutation_cost
from clmorph.transport.assignment_bound import lower_bound


def _clouds(n: int, dimensions: int = 5) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(n)
    return rng.uniform(size=(n, dimensions)), rng.uniform(size=(n, dimensions)) ** 2


def _optimum(source: np.ndarray, target: np.ndarray) -> float:
    cost = cdist(source, target, "sqeuclidean") / 2
    return float(cost[linear_sum_assignment(cost)].mean())


@pytest.mark.parametrize("n", [1, 2, 3, 127, 128, 129, 1000])
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


def test_equal_points_stay():
    found = assign(np.zeros((300, 5)), np.ones((300, 5)))
    assert sorted(found.permutation) == list(range(300))
    assert found.cost == 2.5


def test_seed_fixes_the_permutation():
    clouds = _clouds(600)
    first, second = (assign(*clouds, seed=3).permutation for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_search_ends_at_the_cost_that_is_enough():
    clouds = _clouds(1000)
    best = assign(*clouds).cost
    enough = 1.05 * best
    shares: list[float] = []
    found = assign(*clouds, enough=enough, report=shares.append)
    assert best < found.cost <= enough
    assert shares[-1] == 1.0
    assert all(0 <= share <= 1 for share in shares)


def test_destinations_begin_the_search():
    source, target = _clouds(400)
    order = np.random.default_rng(2).permutation(400)
    found = assign(source, target, destinations=target[order], enough=np.inf)
    begun = permutation_cost(source, target, order)
    assert found.cost <= min(begun, permutation_cost(source, target, np.arange(400)))


def test_potentials_do_not_change_the_cost_of_a_block():
    source, target = _clouds(100)
    g = np.random.default_rng(3).standard_normal(100)
    assert assign(source, target, g=g).cost == pytest.approx(_optimum(source, target), rel=1e-12)


def test_merged_permutation_is_cheaper_than_both():
    source, target = _clouds(300)
    rng = np.random.default_rng(4)
    first = np.arange(300)
    second = first.copy()
    for block in np.arange(300).reshape(-1, 5):  # cycles of five
        second[block] = rng.permutation(block)
    found = merged(first, second, source, target)
    assert sorted(found) == list(range(300))
    costs = [permutation_cost(source, target, each) for each in (first, second, found)]
    assert costs[2] < min(costs[:2])


@pytest.mark.parametrize(("scale", "epsilon"), [(0.0, 1e-4), (1e-3, 1e-7), (0.1, 1e-7), (10, 1e-4)])
def test_any_potentials_give_a_bound(device, scale, epsilon):
    source, target = _clouds(300)
    g = scale * np.random.default_rng(0).standard_normal(300)
    exact = (cdist(source, target, "sqeuclidean") / 2 - g).min(axis=1).mean() + g.mean()
    bound = lower_bound(source, target, g, epsilon, clmorph.get_backend(device))
    assert bound <= max(0.0, exact)
    # Beside epsilon log N it loses what the device's rounding may be.
    assert bound >= exact - epsilon * np.log(300) - 1e-6 * max(1.0, scale)


def test_bound_and_a_wrong_guess(device):
    """A wrong guess costs time; it must not change the bound."""
    source, target = _clouds(300)
    g = np.zeros(300)
    operations = clmorph.get_backend(device)
    exact = (cdist(source, target, "sqeuclidean") / 2).min(axis=1).mean()
    for guess in (np.full(300, 5.0), np.full(300, -5.0), np.zeros(300)):
        bound = lower_bound(source, target, g, 1e-5, operations, guess)
        assert exact - 1e-4 <= bound <= exact


def test_bound_of_the_solver_is_tight(device):
    source, target = _clouds(200)
    masses = np.full(200, 1 / 200)
    operations = clmorph.get_backend(device)
    potentials = clmorph.sinkhorn(
        (masses, source), (masses, target), blur=0.03, tol=1e-2, backend=operations
    )
    optimum = _optimum(source, target)
    bound = lower_bound(source, target, potentials.g, 1e-6, operations, potentials.f)
    assert 0.98 * optimum <= bound <= optimum


def test_far_points_have_a_bound_too(device):
    source, target = (1e3 * cloud for cloud in _clouds(100))
    bound = lower_bound(source, target, np.zeros(100), 1.0, clmorph.get_backend(device))
    assert 0 < bound <= _optimum(source, target)
