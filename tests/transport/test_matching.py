"""The cheapest assignment and its proof, and a quick one, against SciPy's exact solver."""

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

import clmorph
import clmorph.transport.assignment_search as search
import clmorph.transport.pair_costs as pair_costs
from clmorph.errors import ConvergenceWarning, InputError
from clmorph.transport.assignment import assign, permutation_cost


def _costs(x, y, weights=None):
    costs = cdist(x, y, "sqeuclidean") / 2
    return costs / min(costs.shape) if weights is None else costs * weights[:, None]


def _holds(found, x, y, weights=None, gap=0.0):
    """Check a result and its proof against SciPy's."""
    costs = _costs(x, y, weights)
    rows, columns = linear_sum_assignment(costs)
    optimum, size = costs[rows, columns].sum(), costs.mean() * len(rows)
    np.testing.assert_array_equal(found.rows, np.unique(found.rows))
    assert len(np.unique(found.columns)) == len(found.columns) == len(rows)
    own = costs[found.rows, found.columns].sum()
    assert found.cost == pytest.approx(own, rel=1e-12, abs=1e-15 * size)
    assert own <= (1 + gap) * optimum + 1e-13 * size
    assert found.bound <= optimum * (1 + 1e-12) + 1e-14 * size
    f, g = found.prices
    assert (costs - f[:, None] - g).min() >= -1e-13 * size
    if found.bound > 0:
        assert f.sum() + g.sum() == pytest.approx(found.bound, rel=1e-9, abs=1e-11 * size)
    if len(x) != len(y):  # the larger one's
        assert (f if len(x) > len(y) else g).max() <= 1e-12 * size


@pytest.mark.parametrize("gap", [1.0, 3.0, 1000.0])
@pytest.mark.parametrize("n", [60, 200])
def test_a_gap_above_one_is_proven(n, gap):
    """Prices that may miss as much as the cost would have no bound above 0."""
    rng = np.random.default_rng(0)
    y, x = rng.random((200, 2)), rng.random((n, 2))
    found = clmorph.assignment(x, y, gap=gap, backend="numpy")
    assert found.gap <= min(gap, 1.0)
    _holds(found, x, y, gap=gap)


@pytest.mark.parametrize("kind", ["random", "weights", "ties", "same"])
def test_many_pairs_are_searched_on_the_device(device, monkeypatch, kind):
    """Drawn candidates, and bounds of sums over all pairs, prove what trees prove."""
    monkeypatch.setattr(search, "MANY_PAIRS", 1)
    rng = np.random.default_rng(6)
    x, y = rng.random((400, 3)), rng.random((400, 3)) ** 2
    weights = rng.random(400) + 0.1 if kind == "weights" else None
    if kind == "ties":
        x, y = np.round(9 * x), np.round(9 * y)
    elif kind == "same":
        y = x[rng.permutation(400)]
    _holds(clmorph.assignment(x, y, weights=weights, gap=0.01, backend=device), x, y, weights, 0.01)


@pytest.mark.parametrize("rate", [5e9, 1e12])
def test_a_fast_card_searches_without_near_pairs(device, monkeypatch, rate):
    """By its recorded rate it sums over all of some pairs sooner than it chooses near ones."""
    asked, near_pairs = [], device.near_pairs
    monkeypatch.setattr(search, "MANY_PAIRS", 300**2)
    monkeypatch.setattr("clmorph.transport._solver.softmin.MANY_PAIRS", 300**2)
    monkeypatch.setattr(device, "near_pairs", lambda *a: asked.append(1) or near_pairs(*a))
    monkeypatch.setattr(device, "on_processor", False)
    monkeypatch.setattr(device, "pairs_per_second", rate)
    rng = np.random.default_rng(6)
    x, y = rng.random((2, 400, 3))
    found = clmorph.assignment(x, y, gap=0.01, backend=device)
    assert bool(asked) == (rate == 5e9)
    _holds(found, x, y, gap=0.01)


@pytest.mark.parametrize("spare", [0, 60])
def test_without_trees(device, monkeypatch, spare):
    """In many dimensions all pairs are formed."""
    monkeypatch.setattr(pair_costs, "TREE_DIMENSION", 0)
    rng = np.random.default_rng(3)
    x, y = rng.random((300, 3)), rng.random((300 + spare, 3)) ** 2
    _holds(clmorph.assignment(x, y, backend=device), x, y)


@pytest.mark.parametrize("kind", ["clusters", "sites", "far", "one place", "one"])
def test_hard_problems(kind):
    """Bids alone would take long: far groups of other sizes, many ties, and clouds far apart."""
    rng = np.random.default_rng(8)
    if kind == "clusters":
        centers = 10 * rng.random((5, 2))
        x, y = (centers[rng.integers(0, 5, 700)] + 0.01 * rng.random((700, 2)) for _ in range(2))
    elif kind == "sites":
        x, y = rng.integers(0, 8, (2, 700, 2)) * 1.0
    elif kind == "far":
        x, y = rng.random((600, 3)), rng.random((600, 3)) ** 2 + 1e4
    elif kind == "one":
        x, y = np.zeros((200, 2)), np.zeros((300, 2))
    else:
        x, y = np.zeros((600, 2)), np.vstack((np.zeros((400, 2)), np.ones((300, 2))))
    _holds(clmorph.assignment(x, y, backend="numpy"), x, y)


def test_bytes_are_the_same_again(device):
    rng = np.random.default_rng(4)
    x, y = rng.random((500, 4)), rng.random((500, 4))
    first, second = (clmorph.assignment(x, y, backend=device) for _ in range(2))
    assert first.columns.tobytes() == second.columns.tobytes()
    assert first.prices[1].tobytes() == second.prices[1].tobytes()


def test_missed_gap_is_told(monkeypatch):
    monkeypatch.setattr(search, "CHECKS", 1)
    monkeypatch.setattr(search, "CANDIDATES", 2)
    monkeypatch.setattr(search, "BIDS", 2)
    rng = np.random.default_rng(5)
    x, y = rng.random((300, 2)), rng.random((300, 2))
    with pytest.warns(ConvergenceWarning, match=r"% above the cheapest") as caught:
        found = clmorph.assignment(x, y, backend="numpy")
    assert "\n" not in str(caught[0].message)
    assert found.gap > 0
    assert sorted(found.columns) == list(range(300))
    _holds(found, x, y, gap=found.gap)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"x": np.zeros((0, 2))}, "x has shape"),
        ({"x": np.full((3, 2), np.nan)}, "finite"),
        ({"y": np.zeros((3, 4))}, "dimensions"),
        ({"weights": np.ones(4)}, "weights have shape"),
        ({"weights": -np.ones(3)}, "weights: one is -1; expected masses"),
        ({"weights": np.full(3, 1e300)}, r"weights: their sum is 3e\+300; expected masses"),
        ({"weights": np.zeros(3)}, "their sum is 0"),
        ({"weights": np.ones(3), "y": np.zeros((2, 2))}, "at least as many points in y"),
        ({"gap": -1.0}, "gap"),
        ({"seed": -1}, "seed"),
        ({"x": np.zeros((3, 1024)), "y": np.zeros((4, 1024))}, "1024 coordinates"),
    ],
)
def test_mistakes_are_named(wrong, words):
    with pytest.raises(InputError, match=words) as caught:
        clmorph.assignment(**{"x": np.zeros((3, 2)), "y": np.ones((3, 2))} | wrong, backend="numpy")
    assert "\n" not in str(caught.value)


# --- a quick permutation of equal clouds ------------------------------------------------------


@pytest.mark.parametrize("n", [1, 2, 3, 127, 128, 129, 1000])
def test_quick_permutations_are_near_the_cheapest(n):
    rng = np.random.default_rng(n)
    source, target = rng.uniform(size=(n, 5)), rng.uniform(size=(n, 5)) ** 2
    found = assign(source, target)
    assert sorted(found) == list(range(n))
    costs = _costs(source, target)
    optimum = costs[linear_sum_assignment(costs)].sum()
    assert optimum * (1 - 1e-12) <= permutation_cost(source, target, found) <= 1.01 * optimum


def test_same_clouds_are_matched_exactly(rng):
    source, order = rng.random((500, 5)), rng.permutation(500)
    np.testing.assert_array_equal(order[assign(source, source[order])], np.arange(500))


def test_destinations_begin_the_search(rng):
    source, target, order = rng.random((400, 5)), rng.random((400, 5)) ** 2, rng.permutation(400)
    found = assign(source, target, destinations=target[order])
    begun = permutation_cost(source, target, order)
    cost = permutation_cost(source, target, found)
    assert cost <= min(begun, permutation_cost(source, target, np.arange(400)))
