"""Sums over grids, nearest seeds, tables of colors: devices against NumPy, NumPy by definition."""

from dataclasses import replace

import numpy as np
import pytest

from clmorph.backends.numpy import NumPyOperations
from clmorph.backends.opencl.backend import OpenCLOperations
from clmorph.backends.opencl.kernels import nearest_seeds as seed_tree
from clmorph.backends.opencl.kernels.launches import LaunchBudget
from clmorph.backends.opencl.verification.fields import (
    SEED_TOLERANCE,
    SIZES,
    STEPS,
    colors_of,
    grid_case,
    seed_excess,
    table_of,
)

REFERENCE = NumPyOperations()
SHAPES = [(33, 41), (1, 1), (16, 16), (5, 70)]

# --- sums over grids ------------------------------------------------------------------------------


def over_pairs(exponents, axes):
    """The sum over all pairs, in long double."""
    places, cells = (
        np.stack(np.meshgrid(*side, indexing="ij"), -1).reshape(-1, len(axes)).astype(np.longdouble)
        for side in zip(*axes, strict=True)
    )
    terms = exponents.ravel() - ((places[:, None] - cells) ** 2).sum(-1)
    largest = terms.max(axis=1)
    found = largest + np.log(np.exp(terms - largest[:, None]).sum(axis=1))
    return found.reshape([len(x) for x, _ in axes])


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("sizes", SIZES, ids=str)
def test_numpy_sums_over_all_pairs(sizes, step):
    exponents, axes = grid_case(*sizes, step)
    found = REFERENCE.grid_log_sum_exp(exponents, axes)
    want = over_pairs(exponents, axes).astype(float)
    # Exponents near one are rounded before sums whose logarithm may be near zero.
    np.testing.assert_allclose(found, want, rtol=1e-13, atol=1e-14)


def test_without_float64_precise_sums_are_those_of_numpy(device):
    pairs = OpenCLOperations(
        device.device, replace(device.constants, precise=1, float64=0), verify=False
    )
    exponents, axes = grid_case(*SIZES[2], 0.6)
    want = REFERENCE.grid_log_sum_exp(exponents, axes)
    np.testing.assert_array_equal(pairs.grid_log_sum_exp(exponents, axes, True), want)
    assert np.abs(pairs.grid_log_sum_exp(exponents, axes) - want).max() < 1e-4


def test_many_cells_without_mass_are_left_out(each_device):
    """One mass among far more empty cells than float32 counts beside it."""
    exponents = np.full((64, 64), -np.inf)
    exponents[3, 60] = -1.0
    x = 0.5 * np.arange(64.0)
    found = each_device.grid_log_sum_exp(exponents, [(x, x), (x, x)])
    want = -1.0 - (x[:, None] - x[3]) ** 2 - (x - x[60]) ** 2
    np.testing.assert_allclose(found, want, rtol=2e-6, atol=1e-4)


# --- nearest seeds ------------------------------------------------------------------------------


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


# --- tables of colors ---------------------------------------------------------------------------


def by_formula(table, color):
    """One color, corner by corner, in float64."""
    n = len(table)
    place = np.clip(color.astype(float), 0, 1) * (n - 1)
    corner = np.minimum(place.astype(int), n - 2)
    rest = place - corner
    before, total = 1.0, np.zeros(3)
    for axis in sorted(range(3), key=lambda axis: -rest[axis]):
        total += (before - rest[axis]) * table[tuple(corner)]
        before = rest[axis]
        corner[axis] += 1
    return total + before * table[tuple(corner)]


@pytest.mark.parametrize("nodes", [2, 3, 33])
def test_numpy_is_the_formula(nodes):
    table, colors = table_of(nodes), colors_of(100, nodes)
    want = [by_formula(table, color) for color in colors]
    got = REFERENCE.apply_table(REFERENCE.upload_table(table), colors)
    np.testing.assert_allclose(got, want, rtol=0, atol=1e-6)


@pytest.mark.parametrize("nodes", [2, 17, 33, 65])
def test_a_table_of_its_own_colors_changes_nothing(each_device, nodes):
    levels = np.linspace(0, 1, nodes)
    table = np.stack(np.meshgrid(levels, levels, levels, indexing="ij"), axis=-1)
    colors = np.random.default_rng(0).integers(0, 256, (5000, 3)) / np.float32(255)
    for backend in (each_device, REFERENCE):
        on_device = backend.upload_table(table.astype(np.float32))
        got = backend.apply_table(on_device, colors.astype(np.float32))
        assert np.abs(got - colors).max() < 1e-6


# --- launches ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["grid", "table", "spread", "on a circle", "all in one place"])
def test_launches_are_cut_without_changing_a_bit(each_device, monkeypatch, rng, name):
    if name in SEEDS:
        seeds = np.asarray(SEEDS[name](rng), np.float32)

    def run():
        if name == "grid":
            return each_device.grid_log_sum_exp(*grid_case((9, 14, 17), (11, 21, 8), 0.6))
        if name == "table":
            table = each_device.upload_table(table_of(33))
            return each_device.apply_table(table, colors_of(2000, 33))
        return each_device.nearest_seeds(seeds, (33, 41))

    whole = run()
    monkeypatch.setattr(seed_tree, "ROUNDS", 7)
    monkeypatch.setattr(LaunchBudget, "pairs", lambda self: 90)
    np.testing.assert_array_equal(run(), whole)


def test_a_color_alone_is_as_among_others(each_device):
    table, colors = each_device.upload_table(table_of(33)), colors_of(20, 33)
    alone = [each_device.apply_table(table, color[None])[0] for color in colors]
    np.testing.assert_array_equal(alone, each_device.apply_table(table, colors))
