"""A quick permutation between equal clouds, against SciPy's exact solver."""

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from clmorph.transport.assignment import assign, permutation_cost


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
    assert sorted(found) == list(range(n))
    optimum = _optimum(source, target)
    assert optimum * (1 - 1e-12) <= permutation_cost(source, target, found) <= 1.01 * optimum


def test_same_clouds_are_matched_exactly():
    source, _ = _clouds(500)
    order = np.random.default_rng(1).permutation(500)
    found = assign(source, source[order])
    np.testing.assert_array_equal(order[found], np.arange(500))


def test_destinations_begin_the_search():
    source, target = _clouds(400)
    order = np.random.default_rng(2).permutation(400)
    found = assign(source, target, destinations=target[order])
    begun = permutation_cost(source, target, order)
    cost = permutation_cost(source, target, found)
    assert cost <= min(begun, permutation_cost(source, target, np.arange(400)))
