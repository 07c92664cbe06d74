"""Tiles of points, bounds of the shares of their pairs, lists made of them, and their levels."""

import numpy as np
import pytest
from clouds import PAIRS

from clmorph.backends.numpy import NumPyOperations
from clmorph.backends.opencl.build.constants import SENTINEL
from clmorph.backends.opencl.kernels import candidates, row_loop, tile_bounds
from clmorph.backends.opencl.kernels.clouds import tile_order
from clmorph.backends.opencl.kernels.launches import LaunchBudget
from clmorph.backends.opencl.kernels.row_loop import LOG2_E
from clmorph.backends.opencl.kernels.tile_bounds import all_tiles
from clmorph.backends.opencl.kernels.tile_bounds import tile_bounds as bounds_of
from clmorph.backends.opencl.kernels.tile_pairs import column_bounds, row_bounds

#: Clouds in five dimensions, and in others.
CLOUDS = {**PAIRS, **dict.fromkeys((1, 2, 11))}


def test_equal_points_keep_their_order():
    assert tile_order(np.zeros((500, 5)), 64).tolist() == list(range(500))


def test_tiles_are_compact(rng):
    points = rng.random((4096, 2))
    tiles = points[tile_order(points, 64)].reshape(64, 64, 2)
    sides = tiles.max(axis=1) - tiles.min(axis=1)
    # 64 tiles of a unit square: an eighth of the side each.
    assert sides.mean() < 0.15
    assert sides.max() < 0.3


def test_only_the_last_tile_is_partly_filled(rng):
    """Two far clusters of 64 and 36 points fall into tiles of their own."""
    points = np.concatenate((rng.random((36, 3)) + 9, rng.random((64, 3))))
    ordered = points[tile_order(points, 64)]
    assert np.all(ordered[:64] < 2)
    assert np.all(ordered[64:] > 8)


@pytest.mark.parametrize("n", [16, 100, 4096, 5000])
def test_parts_of_tiles_are_compact(rng, n):
    """Parts change the order inside of tiles alone, where runs of 16 points then are smaller."""
    points = rng.random((n, 2))
    plain, parted = tile_order(points, 64), tile_order(points, 64, part=16)
    for first in range(0, n, 64):
        assert set(plain[first : first + 64]) == set(parted[first : first + 64])
    if n < 4096:
        return
    runs = [points[order[: n // 16 * 16]].reshape(-1, 16, 2) for order in (plain, parted)]
    before, after = ((np.ptp(run, axis=1) ** 2).sum(axis=1).mean() for run in runs)
    # A quarter of a unit square: 1 x 1/4 has the squared diagonal 1.06, 1/2 x 1/2 has 0.5.
    assert after < 0.75 * before


# --- bounds, and lists ---------------------------------------------------------------------------


def in_float64(rows, columns, k):
    """Return B of all pairs of tiles by the formula of `tile_pairs`, and its terms' sizes."""
    p, h, w, r = (np.asarray(values, float)[:, None] for values in rows)
    q, sides, a, level = (np.asarray(values, float)[None] for values in columns)
    between = p - q
    reach = h * np.abs(between + w) + sides * (np.abs(between - a) + h) - 0.5 * between**2
    sizes = h * (np.abs(between) + np.abs(w)) + 0.5 * between**2
    sizes += sides * (np.abs(between) + np.abs(a) + h)
    return r + level + k * reach.sum(axis=2), np.abs(r) + np.abs(level) + k * sizes.sum(axis=2)


def sides_of(operations, pair, epsilon, rng, largest=False):
    """Upload two clouds; return them, the terms of their bounds, k, and the logarithms of shares.

    These are log2 of b_j exp((g_j - C_ij) / epsilon) over the sum of its row, for sorted points.
    """
    clouds = [operations.upload(*each) for each in pair]
    g = 3 * epsilon * rng.normal(size=len(pair[1][0]))
    exact = NumPyOperations()
    softmin = exact.softmin(*(exact.upload(*each) for each in pair), g, epsilon)
    rows, columns = clouds
    k = LOG2_E / epsilon
    values = np.maximum(g[columns.order] * k + columns.log2_weights, SENTINEL)
    guess = -k * softmin[rows.order]
    sides = row_bounds(rows, guess, k), column_bounds(columns, values, k, largest)
    x, y = (points[cloud.order] for (points, _), cloud in zip(pair, clouds, strict=True))
    cost = 0.5 * ((x[:, None] - y) ** 2).sum(axis=2)
    with np.errstate(divide="ignore"):
        shares = values - k * cost - guess[:, None]
    shares[:, values == SENTINEL] = -np.inf
    return clouds, sides, k, shares


def of_tiles(shares, tile, largest):
    """Return the largest logarithm, over the rows of a tile, of a column tile's share."""
    n_rows, n_columns = (-(-n // tile) for n in shares.shape)
    found = np.full((n_rows, n_columns), -np.inf)
    for p in range(n_rows):
        for q in range(n_columns):
            block = shares[p * tile : (p + 1) * tile, q * tile : (q + 1) * tile]
            found[p, q] = (block if largest else np.logaddexp2.reduce(block, axis=1)).max()
    return found


@pytest.mark.parametrize("largest", [False, True], ids=["sums", "largest terms"])
@pytest.mark.parametrize("name", CLOUDS)
def test_bounds_hold_and_are_those_of_the_formula(variant, rng, name, largest):
    make = CLOUDS[name]
    pair = make(rng) if make else [(rng.random((n, name)), np.full(n, 1 / n)) for n in (200, 150)]
    epsilon, dimension = (0.01 if make else 0.05), pair[0][0].shape[1]
    clouds, sides, k, shares = sides_of(variant, pair, epsilon, rng, largest)
    n_tiles = [len(cloud.centers) for cloud in clouds]
    (found,) = bounds_of(variant.row_loop, clouds[0], [sides], k, [all_tiles(*n_tiles)])
    assert found.part == range(n_tiles[0])
    got = found.values.reshape(n_tiles)
    want, sizes = in_float64(*sides, k)
    # Rounded up, by no more than twice the bound of the rounding error.
    assert np.all(got >= want)
    assert np.all(got <= want + 2 * (dimension + 12) / 2**24 * sizes)
    assert np.all(got >= of_tiles(shares, variant.constants.tile, largest))


@pytest.mark.parametrize("wide_from", [1, 1 << 62], ids=["groups first", "tiles alone"])
def test_rows_that_keep_no_pair_list_one_tile(device, rng, monkeypatch, wide_from):
    """Rows without mass have a bound below the limit everywhere; others list what they need."""
    monkeypatch.setattr(candidates, "WIDE_FROM", wide_from)
    points = np.sort(rng.random((64 * 40, 1)), axis=0)
    weights = np.where(np.arange(len(points)) < 64 * 24, 1.0, 0.0)
    rows = device.upload(points, weights)
    columns = device.upload(points, np.ones(len(points)))
    tile, epsilon = device.constants.tile, 1e-4
    k = LOG2_E / epsilon
    threshold = 8.0
    of_rows = np.where(rows.log2_weights > 0.5 * SENTINEL, -threshold, -SENTINEL)
    parts = list(
        candidates.possible_pairs(
            device.row_loop, rows, columns,
            [(of_rows, np.zeros(len(columns)))], k,
        )
    )  # fmt: skip
    assert [row for part, _ in parts for row in part] == list(range(len(rows.centers)))
    x, y = points[rows.order, 0], points[columns.order, 0]
    needed = threshold - 0.5 * k * (x[:, None] - y) ** 2 >= 0
    needed &= (of_rows < 0)[:, None]
    for part, pairs in parts:
        for row_tile in part:
            own = slice(row_tile * tile, (row_tile + 1) * tile)
            listed = pairs.tiles[pairs.starts[row_tile] : pairs.starts[row_tile + 1]]
            wanted = np.unique(np.flatnonzero(needed[own].any(axis=0)) // tile)
            assert np.isin(wanted, listed).all()
            if not len(wanted):
                assert len(listed) == 1


def test_bounds_that_overflow_exclude_nothing(device):
    """Infinite terms make a bound that is no number, and such a tile is kept."""
    points = np.linspace(0, 1, 130)[:, None]
    cloud = device.upload(points, np.ones(130))
    k = LOG2_E / 1e-4
    sides = (
        row_bounds(cloud, np.zeros(130), k), column_bounds(cloud, np.zeros(130), k)
    )  # fmt: skip
    far = sides[1]._replace(centers=sides[1].centers + np.float32(1e30))
    n_tiles = len(cloud.centers)
    (bound,) = bounds_of(
        device.row_loop, cloud, [(sides[0], far)], k, [all_tiles(n_tiles, n_tiles)]
    )
    assert np.isnan(bound.values).all()
    _, tiles, _ = candidates._above(bound, 0.0)
    assert tiles.tolist() == n_tiles * list(range(n_tiles))


def test_lengths_of_launches_change_no_list(device, rng, monkeypatch):
    """Near pairs are the same bit by bit, however many bounds a launch computes."""
    cloud = device.upload(rng.random((64 * 30, 5)), np.full(64 * 30, 1.0))
    g = 0.1 * rng.random(64 * 30)
    softmin = device.softmin(cloud, cloud, g, 0.01)
    found = []
    for most, chunk in ((1 << 21, 1 << 20), (500, 1 << 20), (500, 1)):
        monkeypatch.setattr(tile_bounds, "LAUNCH_BOUNDS", most)
        monkeypatch.setattr(candidates, "CHUNK_PAIRS", chunk)
        found.append(device.near_pairs(cloud, cloud, g, softmin, 0.01, 1e-6))
    for near in found[1:]:
        assert np.array_equal(near.pairs.tiles, found[0].pairs.tiles)
        assert np.array_equal(near.pairs.starts, found[0].pairs.starts)
        assert np.array_equal(near.pairs.distances, found[0].pairs.distances)
        assert np.array_equal(near.softmin, found[0].softmin)
        assert np.array_equal(near.skipped, found[0].skipped)
    assert [len(near.pairs.masks) for near in found[:2]] == [1, 1]
    assert len(found[2].pairs.masks) > 1


@pytest.mark.parametrize("wide_from", [1, 1 << 62], ids=["groups first", "tiles alone"])
@pytest.mark.parametrize("blur", [0.5, 0.1, 0.02])
def test_candidates_leave_out_no_more_than_they_report(device, rng, monkeypatch, wide_from, blur):
    """Over any row, the shares of tiles that are not candidates are within the bound."""
    monkeypatch.setattr(candidates, "WIDE_FROM", wide_from)
    monkeypatch.setattr(tile_bounds, "LAUNCH_BOUNDS", 2000)
    y, x = np.meshgrid(*[np.linspace(0, 1, 70)] * 2, indexing="ij")
    colors = np.stack((x * y, np.sin(5 * x + y), 0.1 * rng.random(x.shape)), axis=2)
    points = np.dstack((x, y, colors)).reshape(-1, 5)
    pair = [(points[: 4900 - drop], np.full(4900 - drop, 1 / 4900)) for drop in (3, 1000)]
    rows, columns = (device.upload(*each) for each in pair)
    k, tile, budget = LOG2_E / blur**2, device.constants.tile, 1e-9
    g = np.zeros(len(columns))
    exact = NumPyOperations()
    softmin = exact.softmin(*(exact.upload(*each) for each in pair), g, blur**2)
    guess, values = -k * softmin[rows.order], columns.log2_weights
    x, y = (each[cloud.order] for (each, _), cloud in zip(pair, (rows, columns), strict=True))
    seen, kept = 0, 0
    for part, pairs, unseen in candidates.candidates(
        device.row_loop, rows, columns, row_bounds(rows, guess, k), guess, values, k, budget
    ):
        assert part.start == seen
        seen = part.stop
        assert unseen.max() <= budget
        for row_tile in part:
            own = slice(row_tile * tile, (row_tile + 1) * tile)
            listed = pairs.tiles[pairs.starts[row_tile] : pairs.starts[row_tile + 1]]
            assert np.all(np.diff(listed.astype(int)) > 0)
            assert listed.size
            kept += listed.size
            left = ~np.isin(np.arange(len(columns)) // tile, listed)
            cost = 0.5 * ((x[own, None] - y[left]) ** 2).sum(axis=2)
            share = np.exp2(values[left] - k * cost - guess[own, None]).sum(axis=1)
            assert share.max() <= unseen[row_tile - part.start]
    assert seen == len(rows.centers)
    if blur == 0.02:
        assert kept < 0.8 * len(rows.centers) * len(columns.centers)


# --- levels: formed on the device where it has float64 -------------------------------------------


@pytest.mark.parametrize("listed", [False, True])
@pytest.mark.parametrize("operation", ["softmin", "precise", "bounded", "maxima", "moments"])
def test_levels_of_the_device_are_the_hosts(device, rng, monkeypatch, operation, listed):
    """In several launches, with points far apart, and tiles without mass; a list comes up once."""
    if not device.has_float64:
        pytest.skip("its levels are the host's")
    n, epsilon = 900, 1e-2
    weights = rng.random(n)
    weights[: 2 * device.constants.tile] = 0
    rows = device.upload(3 * np.sort(rng.random((n, 4)), axis=0), np.full(n, 1 / n))
    columns = device.upload(3 * np.sort(rng.random((n, 4)), axis=0), weights, rng.random(n))
    g = rng.normal(size=n)
    softmin = device.softmin(rows, columns, g, epsilon)

    def run():
        near = device.near_pairs(rows, columns, g, softmin, epsilon, 1e-4) if listed else None
        given = rows, columns, g, epsilon
        found = {
            "softmin": lambda: device.softmin(*given, False, near),
            "precise": lambda: device.softmin(*given, True, near),
            "bounded": lambda: np.hstack(device.bounded_softmin(*given, near, 1e-4)),
            "maxima": lambda: device.row_maxima(*given, near),
            "moments": lambda: np.hstack(
                [
                    x.reshape(n, -1)
                    for x in device.plan_moments(*given[:3], softmin, epsilon, near=near)
                ]
            ),
        }[operation]()
        return near, found

    wanted, on_host = run()
    work, uploaded = device.row_loop.work, []
    upload = work.buffer
    monkeypatch.setattr(work, "buffer", lambda *all: uploaded.append(all[0]) or upload(*all))
    monkeypatch.setattr(device.row_loop, "device_levels", 0)
    if not listed and operation != "moments":
        monkeypatch.setattr(row_loop, "_levels", None)  # the host forms none
    each = columns.stride * device.constants.tile
    monkeypatch.setattr(LaunchBudget, "pairs", lambda budget: each)
    near, found = run()
    assert np.abs(found - on_host).max() <= 1e-6 * epsilon
    if listed:
        assert sum(values is near.pairs.tiles for values in uploaded) == 1
        assert np.array_equal(near.pairs.starts, wanted.pairs.starts)
        assert np.array_equal(near.pairs.tiles, wanted.pairs.tiles)


def test_few_levels_are_the_hosts(device, rng, monkeypatch):
    """A launch takes longer than so few."""
    cloud = device.upload(rng.random((300, 3)), np.full(300, 1 / 300))
    monkeypatch.setattr(device.row_loop, "_levels_on_device", None)
    device.softmin(cloud, cloud, np.zeros(300), 0.1)
    if not device.has_float64:
        monkeypatch.setattr(device.row_loop, "device_levels", 0)
        device.softmin(cloud, cloud, np.zeros(300), 0.1)
