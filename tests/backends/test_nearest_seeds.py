"""The nearest seed of each pixel: devices against NumPy, and NumPy against all distances."""

import numpy as np
import pytest

from clmorph.backends.numpy import NumPyOperations
from clmorph.backends.opencl.kernels import nearest_seeds as seed_tree
from clmorph.backends.opencl.kernels.launches import LaunchBudget
from clmorph.backends.opencl.verification.fields import SEED_TOLERANCE, seed_excess

REFERENCE = NumPyOperations()
SHAPES = [(33, 41), (1, 1), (16, 16), (5, 70)]


def _circle(rng, count=3000):
    angles = rng.uniform(0, 2 * np.pi, count)
    return np.stack((20 + 18 * np.cos(angles), 16 + 18 * np.sin(angles)), axis=1)


SEEDS = {
    "spread": lambda rng: rng.uniform(-0.5, 40.5, (3000, 2)),
    "one": lambda rng: np.array([[17.25, 3.5]]),
    "two": lambda rng: np.array([[17.25, 3.5], [2.0, 9.0]]),
    "few": lambda rng: rng.uniform(0, 40, (9, 2)),
    "all in one place": lambda rng: np.full((5000, 2), 11.3),
    "in a line": lambda rng: np.stack((np.full(2000, 20.5), rng.uniform(0, 33, 2000)), axis=1),
    "in a small cluster": lambda rng: rng.normal(9.0, 1e-4, (3000, 2)),
    "in clusters of all sizes": lambda rng: 20 + 10 ** rng.uniform(-6, 2, (3000, 1))
    * rng.normal(size=(3000, 2)),
    "on a circle": _circle,
    "outside": lambda rng: rng.uniform(200, 300, (2000, 2)),
    "far outside": lambda rng: rng.uniform(-1e9, 1e9, (300, 2)),
    "as far as allowed": lambda rng: rng.uniform(-1e18, 1e18, (300, 2)),
    "one far outside": lambda rng: np.vstack((rng.uniform(0, 40, (2000, 2)), [[-1e17, 1e17]])),
}  # fmt: skip
#: Seeds whose distances to pixels are exact in float32, with ties.
EXACT = {
    "on pixels": lambda rng: rng.integers(0, 40, (500, 2)),
    "between pixels": lambda rng: rng.integers(-5, 45, (3000, 2)) + 0.5,
    "between four of the same": lambda rng: np.array([[1, 1], [3, 1], [1, 3], [3, 3]] * 9)[::-1],
    "halves of negative zero": lambda rng: np.array([[0.0, -0.0], [-0.0, 0.0], [0.5, 0.0]] * 5),
    "in a row": lambda rng: np.stack((np.arange(40)[::-1], np.full(40, 7)), axis=1),
}


def _by_all_distances(seeds, shape):
    """By the definition, in float64."""
    pixels = np.stack(np.mgrid[: shape[0], : shape[1]][::-1], axis=-1).reshape(-1, 1, 2)
    return np.square(pixels - seeds.astype(float)).sum(axis=2).argmin(axis=1).reshape(shape)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("name", [*SEEDS, *EXACT])
def test_seeds_are_the_nearest(variant, rng, name, shape):
    """And of those that are equally near the one of the lowest index."""
    seeds = np.asarray((SEEDS | EXACT)[name](rng), np.float32)
    want = _by_all_distances(seeds, shape)
    for backend, tolerance in ((variant, SEED_TOLERANCE), (REFERENCE, 0.0)):
        got = backend.nearest_seeds(seeds, shape)
        assert got.shape == shape
        assert got.dtype == np.int32
        assert seed_excess(seeds, got, want) <= tolerance
        assert name in SEEDS or np.array_equal(got, want)


def test_seeds_in_the_same_place_are_equal(variant, rng):
    """At any place, where distances are rounded, too."""
    places = rng.uniform(0, 40, (50, 2)).astype(np.float32)
    seeds = places[np.concatenate((rng.permutation(50), rng.integers(0, 50, 2000)))]
    for backend in (variant, REFERENCE):
        assert backend.nearest_seeds(seeds, (33, 41)).max() < 50


def test_distances_are_rounded_as_numpy_rounds(variant, rng):
    """To the bit, so that a device contracts no product and sum."""
    seeds = rng.normal((1000.0, 700.0), 1e-3, (700, 2)).astype(np.float32)
    y, x = np.mgrid[:33, :41].astype(np.float32)[..., None]
    dx, dy = x - seeds[:, 0], y - seeds[:, 1]
    assert np.array_equal(
        variant.nearest_seeds(seeds, (33, 41)), (dx * dx + dy * dy).argmin(axis=2)
    )


@pytest.mark.parametrize("name", ["spread", "on a circle", "all in one place"])
def test_launches_are_cut_without_changing_a_bit(each_device, monkeypatch, rng, name):
    seeds = np.asarray(SEEDS[name](rng), np.float32)
    whole = each_device.nearest_seeds(seeds, (33, 41))
    monkeypatch.setattr(seed_tree, "ROUNDS", 7)
    monkeypatch.setattr(LaunchBudget, "pairs", lambda self: 90)
    assert np.array_equal(each_device.nearest_seeds(seeds, (33, 41)), whole)


def test_many_seeds_take_few_visits(each_device, monkeypatch, rng):
    """Each pixel near its own seed: about as much work as pixels."""
    side = 256
    seeds = rng.uniform(-0.5, side - 0.5, (side * side, 2)).astype(np.float32)
    visits, learn = [], LaunchBudget.learn

    def noted(self, rounds, seconds):
        visits.append(rounds)
        learn(self, rounds, seconds)

    monkeypatch.setattr(LaunchBudget, "learn", noted)
    each_device.nearest_seeds(seeds, (side, side))
    assert sum(visits) <= 100 * side * side / min(4, each_device.constants.width)
