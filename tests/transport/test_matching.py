"""`clmorph.assignment`: the cheapest assignment and its proof, against SciPy's exact solver."""

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

import clmorph
import clmorph.transport.auction as auction
from clmorph.errors import ConvergenceWarning, InputError
from clmorph.transport.assignment_bound import lower_transform


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
    smaller = max(0, int(len(x) > len(y)))
    if len(x) != len(y):
        assert (g, f)[smaller].max() <= 1e-12 * size


def _clouds(kind, rng):
    """Draw clouds of a kind, of some sizes, dimensions and scales."""
    n = int(rng.integers(1, 330))
    m = n + int(rng.integers(0, 150)) * (rng.random() < 0.4)
    d = int(rng.integers(1, 8))
    if kind == "uniform":
        x, y = rng.random((n, d)), rng.random((m, d))
    elif kind == "ties":
        x, y = rng.integers(0, 4, (n, d)) * 1.0, rng.integers(0, 4, (m, d)) * 1.0
    elif kind == "line":
        x, y = rng.random((n, 1)), rng.random((m, 1))
    elif kind == "clusters":
        centers = rng.random((5, d)) * 10
        x, y = (
            centers[rng.integers(0, 5, count)] + 0.01 * rng.standard_normal((count, d))
            for count in (n, m)
        )
    elif kind == "same":
        x = rng.random((n, d))
        y = np.vstack((x, rng.random((m - n, d))))[rng.permutation(m)]
    else:
        x, y = (np.repeat(rng.random((count // 20 + 1, d)), 20, axis=0)[:count] for count in (n, m))
    scale = 10.0 ** rng.integers(-3, 4)
    return x * scale, y * scale


@pytest.mark.parametrize("kind", ["uniform", "ties", "line", "clusters", "same", "duplicates"])
def test_random_problems(device, kind):
    rng = np.random.default_rng(len(kind))
    for _ in range(7):
        x, y = _clouds(kind, rng)
        weights = rng.random(len(x)) * (rng.random(len(x)) > 0.2) + 1e-3
        weights = weights if rng.random() < 0.25 else None
        if weights is None and rng.random() < 0.3:
            x, y = y, x
        found = clmorph.assignment(x, y, weights=weights, backend=device)
        _holds(found, x, y, weights)


def test_large_gap_takes_less_and_holds(device):
    rng = np.random.default_rng(0)
    x, y = rng.random((400, 5)), rng.random((400, 5)) ** 2
    found = clmorph.assignment(x, y, gap=0.05, backend=device)
    assert found.gap <= 0.05
    _holds(found, x, y, gap=0.05)


def test_device_checks_all_pairs(device, monkeypatch):
    """With many pairs the device bounds the cheapest pair of each row."""
    monkeypatch.setattr(auction, "MANY_PAIRS", 1)
    rng = np.random.default_rng(3)
    for spare in (0, 60):
        x, y = rng.random((300, 3)), rng.random((300 + spare, 3)) ** 2
        found = clmorph.assignment(x, y, gap=0.001, backend=device)
        _holds(found, x, y, gap=0.001)


def test_seed_fixes_the_bytes(device):
    rng = np.random.default_rng(4)
    x, y = rng.random((500, 4)), rng.random((500, 4))
    first, second = (clmorph.assignment(x, y, seed=5, backend=device) for _ in range(2))
    assert first.columns.tobytes() == second.columns.tobytes()
    assert first.prices[1].tobytes() == second.prices[1].tobytes()


def test_missed_gap_is_told(monkeypatch):
    monkeypatch.setattr(auction, "CHECKS", 1)
    rng = np.random.default_rng(5)
    x, y = rng.random((300, 2)), rng.random((300, 2))
    with pytest.warns(ConvergenceWarning, match=r"% above the cheapest") as caught:
        found = clmorph.assignment(x, y, backend="numpy")
    assert "\n" not in str(caught[0].message)
    assert found.gap > 0
    assert sorted(found.columns) == list(range(300))
    _holds(found, x, y, gap=found.gap)


def test_any_prices_and_guess_give_a_bound(device):
    rng = np.random.default_rng(6)
    points = rng.random((2, 300, 5))
    pair = [clmorph.WeightedPoints(each, np.full(300, 1 / 300)) for each in points]
    operations = clmorph.get_backend(device)
    for scale, epsilon in ((0.0, 1e-4), (0.1, 1e-7), (10.0, 1e-4)):
        g = scale * rng.standard_normal(300)
        exact = (cdist(*points, "sqeuclidean") / 2 - g).min(axis=1)
        for guess in (None, np.full(300, 5.0)):
            found = lower_transform(*pair, g, epsilon, operations, guess)
            assert np.all(found <= exact)
            assert np.all(found >= exact - epsilon * np.log(300) - 1e-6 * max(1.0, scale))


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"x": np.zeros((0, 2))}, "x has shape"),
        ({"x": np.full((3, 2), np.nan)}, "finite"),
        ({"y": np.zeros((3, 4))}, "dimensions"),
        ({"weights": np.ones(4)}, "weights have shape"),
        ({"weights": -np.ones(3)}, "weights"),
        ({"weights": np.zeros(3)}, "all 0"),
        ({"weights": np.ones(3), "y": np.zeros((2, 2))}, "at least as many points in y"),
        ({"gap": -1.0}, "gap"),
        ({"seed": -1}, "seed"),
        ({"x": np.zeros((3, 11)), "y": np.zeros((4, 11))}, "11 coordinates"),
    ],
)
def test_mistakes_are_named(wrong, words):
    with pytest.raises(InputError, match=words) as caught:
        clmorph.assignment(**{"x": np.zeros((3, 2)), "y": np.ones((3, 2))} | wrong, backend="numpy")
    assert "\n" not in str(caught.value)
