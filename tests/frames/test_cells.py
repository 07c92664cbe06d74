"""Cells that move between two pictures, and the pairs of their blocks."""

import numpy as np
import pytest

import clmorph
from clmorph.backends.numpy import NumPyOperations
from clmorph.frames.canvas import Canvas, canvas_at
from clmorph.frames.cells import (
    DURATION,
    CellPaths,
    Cells,
    block_grids,
    cells_of_plan,
    mirrored,
    owners_at,
)
from clmorph.measures.lift import pixel_positions

EXACT = NumPyOperations()


def _centers(shape, grid):
    """Centers of the blocks of a grid that divides a picture."""
    rows, columns = (side // count for side, count in zip(shape, grid, strict=True))
    places = pixel_positions(shape).reshape(grid[0], rows, grid[1], columns, 2)
    return places.mean(axis=(1, 3)).reshape(-1, 2)


def _pair(rng, first=(12, 18), second=(12, 18), channels=(3, 3)):
    pictures = [
        rng.random((*shape, count)) for shape, count in zip((first, second), channels, strict=True)
    ]
    return pictures, [canvas_at(float(end), first, second) for end in (0, 1)]


def _shuffled(rng, shape, grid, switching=0.5):
    """The blocks of a grid, moved into one another's places."""
    centers = _centers(shape, grid)
    return CellPaths(centers, rng.permutation(centers), np.full(len(centers), switching))


def test_seeds_of_a_grid_are_its_blocks(any_backend):
    operations = clmorph.get_backend(any_backend)
    shape, grid = (12, 20), (3, 5)
    centers = _centers(shape, grid)
    owners = owners_at(centers, centers, 0.5, canvas_at(0.0, shape, shape), operations)
    np.testing.assert_array_equal(owners, np.kron(np.arange(15).reshape(grid), np.ones((4, 4))))


@pytest.mark.parametrize("channels", [(3, 3), (4, 4), (3, 4)])
@pytest.mark.parametrize("switching", [0.0, 0.5, 1.0])
def test_the_ends_are_the_pictures(any_backend, rng, channels, switching):
    pictures, canvases = _pair(rng, (12, 18), (9, 20), channels)
    paths = _shuffled(rng, (12, 18), (4, 6), switching)
    operations = clmorph.get_backend(any_backend)
    cells = Cells(paths, pictures, canvases, operations)
    for t, picture, canvas in zip((0.0, 1.0), pictures, canvases, strict=True):
        wanted = picture
        if 4 in channels and picture.shape[2] == 3:
            wanted = np.dstack((picture, np.ones(picture.shape[:2])))
        np.testing.assert_array_equal(cells.frame(t, canvas), wanted)
        # The frames beside them are these, but for how far cells have gone.
        beside = cells.frame(abs(t - 1e-9), canvas)
        assert np.abs(beside - wanted).max() < 1e-3


def test_a_block_moves_as_a_whole(rng):
    """Halfway between two blocks of a row, which change places by whole pixels."""
    shape = 4, 12
    pictures, canvases = _pair(rng, shape, shape)
    starts = _centers(shape, (1, 3))
    paths = CellPaths(starts, starts + np.array([[4 / 11, 0], [0, 0], [0, 0]]), np.ones(3))
    frame = Cells(paths, pictures, canvases, EXACT).frame(0.5, canvases[0])
    # The first block has gone two pixels to the right; to its left A goes on, mirrored.
    np.testing.assert_allclose(frame[:, 2:5], pictures[0][:, :3], atol=1e-12)
    np.testing.assert_allclose(frame[:, 0], pictures[0][:, 2], atol=1e-12)
    np.testing.assert_allclose(frame[:, 5:], pictures[0][:, 5:], atol=1e-12)


@pytest.mark.parametrize("switching", [0.3, 0.7])
def test_cells_change_pictures_within_their_time(rng, switching):
    first, second = np.zeros((8, 8, 3)), np.ones((8, 8, 3))
    canvas = canvas_at(0.0, (8, 8), (8, 8))
    paths = _shuffled(rng, (8, 8), (4, 4), switching)
    paths.switching[:5] = 1 - switching
    cells = Cells(paths, (first, second), (canvas, canvas), EXACT)
    for t in np.linspace(0, 1, 21):
        share = np.clip((t - paths.switching) / DURATION + 0.5, 0, 1)
        wanted = share[cells.owners(t, canvas)]
        np.testing.assert_allclose(cells.frame(t, canvas)[..., 0], wanted, atol=1e-12)


def test_strips_are_a_whole(monkeypatch, rng):
    pictures, canvases = _pair(rng, (12, 18), (9, 20), (3, 4))
    paths = _shuffled(rng, (12, 18), (4, 6), 0.42)
    cells = Cells(paths, pictures, canvases, EXACT)
    canvas = canvas_at(0.4, (12, 18), (9, 20))
    whole = cells.frame(0.4, canvas)
    monkeypatch.setattr("clmorph.frames.cells.PIXELS", 40)
    np.testing.assert_array_equal(cells.frame(0.4, canvas), whole)


def test_transparent_colors_are_not_seen(rng):
    first, second = rng.random((2, 6, 6, 4))
    first[..., :3], second[..., :3] = 0.25, 0.25
    clear = rng.random((6, 6)) < 0.5
    for picture in (first, second):
        picture[clear] = (1.0, 0.0, 1.0, 0.0)
        picture[~clear, 3] = 1.0
    canvas = canvas_at(0.0, (6, 6), (6, 6))
    paths = _shuffled(rng, (6, 6), (3, 3))
    cells = Cells(paths, (first, second), (canvas, canvas), EXACT)
    frame = cells.frame(0.37, Canvas((9, 11), (7.0, 7.0)))
    assert np.abs(frame[frame[..., 3] > 0.01, :3] - 0.25).max() < 1e-9


def test_cells_on_another_device_are_the_same(device, rng):
    pictures, canvases = _pair(rng)
    paths = _shuffled(rng, (12, 18), (4, 6))
    cells = Cells(paths, pictures, canvases, EXACT)
    frames = [each.frame(0.4, canvases[0]) for each in (cells, cells.on(device))]
    # Rounding decides to whom a pixel on a border belongs.
    assert np.mean(np.any(frames[0] != frames[1], axis=2)) < 0.02


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (5, 1), (6, 9)])
def test_places_are_mirrored(shape):
    picture = np.arange(shape[0] * shape[1]).reshape(shape)
    around = np.pad(picture, 9, mode="reflect") if min(shape) > 1 else np.pad(picture, 9, "edge")
    places = np.indices(around.shape) - 9
    found = picture[tuple(mirrored(places, shape))]
    if 1 in shape:
        assert found.shape == around.shape
        return
    np.testing.assert_array_equal(found, around)
    np.testing.assert_array_equal(mirrored(places.astype(float), shape), mirrored(places, shape))


@pytest.mark.parametrize("side", [1, 5, 24, 100])
@pytest.mark.parametrize(
    "shapes", [((30, 40), (30, 40)), ((64, 64), (20, 100)), ((1, 50), (40, 30)), ((1, 1), (9, 9))]
)
def test_grids_have_about_as_many_blocks(shapes, side):
    grids = block_grids(shapes, side)
    for (height, width), (rows, columns) in zip(shapes, grids, strict=True):
        assert 1 <= rows <= height
        assert 1 <= columns <= width
    first, second = (rows * columns for rows, columns in grids)
    if min(map(min, shapes)) > side > 1:
        assert 0.8 <= first / second <= 1.25


def _solved(first, second, **options):
    source, target = clmorph.lift(first), clmorph.lift(second)
    potentials = clmorph.sinkhorn(source, target, blur=0.05, backend="numpy", **options)
    return source, target, clmorph.transport_plan(source, target, potentials, backend="numpy")


def _drawings(first, second):
    made = []
    for (height, width), phase in ((first, 0.0), (second, 1.3)):
        y, x = np.mgrid[:height, :width] / max(height, width)
        made.append(np.stack([x, 0.5 + 0.5 * np.sin(7 * y + phase), (x + y > 0.9) * 0.8], axis=-1))
    return made


@pytest.mark.parametrize("shapes", [((24, 24), (24, 24)), ((24, 24), (12, 30)), ((9, 30), (20, 8))])
def test_blocks_are_paired_one_to_one(shapes):
    paths = cells_of_plan(*_solved(*_drawings(*shapes)), 8)
    grids = block_grids(shapes, 8)
    counts = [rows * columns for rows, columns in grids]
    assert len(paths.starts) == len(paths.ends) == len(paths.switching) == max(counts)
    for own, count in zip((paths.starts, paths.ends), counts, strict=True):
        _, times = np.unique(own.round(9), axis=0, return_counts=True)
        assert len(times) == count
        assert times.max() <= -(-max(counts) // count)
    assert paths.switching.min() > 0.2
    assert paths.switching.max() < 0.8


def test_a_picture_stays_in_place():
    picture = _drawings((24, 30), (24, 30))[0]
    paths = cells_of_plan(*_solved(picture, picture), 10)
    np.testing.assert_array_equal(paths.starts, paths.ends)
    canvas = canvas_at(0.5, (24, 30), (24, 30))
    cells = Cells(paths, (picture, picture), (canvas, canvas), EXACT)
    np.testing.assert_allclose(cells.frame(0.5, canvas), picture, atol=1e-9)


def test_blocks_go_where_their_colors_are():
    """Two halves that have changed places."""
    first = np.zeros((16, 16, 3))
    first[:, :8] = 1.0
    paths = cells_of_plan(*_solved(first, first[:, ::-1]), 8)
    assert np.all((paths.starts[:, 0] < 0.5) == (paths.ends[:, 0] > 0.5))


def test_barycentric_plans_opacity_and_maps_of_metrics(rng):
    first, second = _drawings((16, 16), (16, 16))
    opacity = np.ones((16, 16, 1))
    opacity[:, :5] = 0.0
    clear = np.dstack((first, opacity))
    source, target, plan = _solved(clear, second)
    potentials = clmorph.sinkhorn(source, target, blur=0.05, backend="numpy")
    mean = clmorph.barycentric_plan(source, target, potentials, backend="numpy")
    metric = np.tile(np.eye(3), (16, 16, 1, 1)) * rng.uniform(1, 2, (16, 16, 1, 1))
    mapped = clmorph.lift(first, color_metric=metric)
    for first, given in ((source, plan), (source, mean), (mapped, plan)):
        paths = cells_of_plan(first, target, given, 8)
        assert len(np.unique(paths.ends.round(9), axis=0)) == 64
