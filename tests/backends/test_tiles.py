import numpy as np
import pytest

from clmorph.backends.opencl.kernels.clouds import tile_order


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
