"""Means over like neighbors, paths and drawn layers: devices against NumPy, and closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import convolve, map_coordinates, spline_filter

from clmorph.backends.numpy import NumPyOperations
from clmorph.backends.numpy.layers import mean_radius
from clmorph.backends.opencl.kernels.launches import LaunchBudget
from clmorph.backends.opencl.kernels.layers import Layers
from clmorph.backends.opencl.verification.findings import UNIT, largest
from clmorph.backends.opencl.verification.layers import (
    LayerCase,
    Scene,
    mean_cases,
    path_cases,
    scenes,
)
from clmorph.backends.records import LIKE, TEAR, Affine
from clmorph.backends.select import get_backend

REFERENCE = NumPyOperations()
SHAPES = [(1, 1), (1, 9), (6, 1), (2, 3), (45, 70), (130, 33)]
SAME = Affine((0.0, 0.0), (1.0, 1.0))


@pytest.fixture
def any_backend_operations(any_backend):
    return get_backend(any_backend)


def coefficients(picture):
    return np.stack(
        [spline_filter(picture[..., c], order=3, mode="mirror") for c in range(4)], axis=-1
    ).astype(np.float32)


def still(picture, way=0.0, weight=1.0, share=1.0, moved=(0.0, 0.0)):
    """A layer whose pixels are those of its picture, and all move alike."""
    shape = picture.shape[:2]
    paths = np.zeros((3, *shape, 2), np.float32)
    paths[1:] = np.multiply.outer([0.5, 1.0], np.asarray(moved))[:, None, None]
    return LayerCase(
        coefficients(picture), paths, np.zeros((*shape, 8), np.float32), way, SAME, SAME, SAME,
        np.full(shape, weight, np.float32), np.full(shape, share, np.float32),
    )  # fmt: skip


def absent(shape):
    return still(np.ones((*shape, 4)), weight=0.0, share=0.0)


def drawn(operations, layer, low=0.0):
    shape = layer.paths.shape[1:3]
    return Scene(
        (layer, absent(shape)), np.full((1, 1, 4), low, np.float32), shape
    ).draw(operations)  # fmt: skip


#: The cases of each operation, how it is called, the result's shape, and its dtype.
OPERATIONS = {
    "edge_preserving_mean": (
        mean_cases, lambda backend, case: backend.edge_preserving_mean(*case),
        lambda case: (*case.fine_guide.shape[:2], case.values.shape[2]), np.float64,
    ),
    "follow_paths": (
        path_cases, lambda backend, case: backend.follow_paths(*case),
        lambda case: (case.steps + 1, *case.shape, 2), np.float32,
    ),
    "draw_layers": (
        scenes, lambda backend, case: case.draw(backend), lambda case: (*case.shape, 4), np.float32,
    ),
}  # fmt: skip


@pytest.mark.small
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("operation", OPERATIONS)
def test_devices_agree_with_numpy(each_device, operation, shape):
    cases, run, shape_of, dtype = OPERATIONS[operation]
    for name, case in cases(shape).items():
        got, want = (run(backend, case) for backend in (each_device, REFERENCE))
        assert got.shape == want.shape == shape_of(case)
        assert got.dtype == want.dtype == dtype
        assert np.all(np.isfinite(got))
        assert largest(got - want) <= case.rounding(), name
        if operation == "follow_paths":
            assert np.abs(got).max() <= (1 + 1e-5) * np.abs(case.field).max()


@pytest.mark.parametrize("operation", OPERATIONS)
def test_launches_are_cut_without_changing_a_bit(each_device, operation):
    cases, run, *_ = OPERATIONS[operation]
    layers = Layers(each_device.work, each_device.constants, each_device.programs)
    layers._of_means = layers._of_paths = layers._of_points = layers._of_pixels = LaunchBudget()
    layers._of_means.pairs = lambda: 1  # a row a launch
    for case in cases((19, 26)).values():
        assert np.array_equal(run(layers, case), run(each_device, case))


@pytest.mark.parametrize("backend", ["device", "numpy"])
def test_rows_of_a_frame_are_those_of_the_whole(each_device, backend):
    """Also beside tears, where a pixel needs the rows above and below."""
    operations = REFERENCE if backend == "numpy" else each_device
    for name, scene in scenes((19, 26)).items():
        whole = scene.draw(operations)
        parts = [scene.draw(operations, slice(*rows)) for rows in ((0, 1), (1, 12), (12, 19))]
        assert np.array_equal(np.concatenate(parts), whole), name


def test_rows_of_cells_in_several_launches(each_device):
    """As where loops must be short."""
    constants = replace(each_device.constants, longest_loop=600)
    layers = Layers(each_device.work, constants, each_device.programs)
    for name, case in mean_cases((19, 26)).items():
        want = REFERENCE.edge_preserving_mean(*case)
        assert largest(layers.edge_preserving_mean(*case) - want) <= case.rounding(), name


@pytest.mark.parametrize("sigma", [0.4, 3.3])
def test_equal_colors_and_weights_give_a_gaussian_mean(any_backend_operations, rng, sigma):
    values = rng.normal(size=(21, 34, 2)).astype(np.float32)
    same = np.full((21, 34, 3), 0.3, np.float32)
    got = any_backend_operations.edge_preserving_mean(
        values, np.full((21, 34), 0.7, np.float32), same, same, sigma, 0.1
    )
    apart = np.arange(-mean_radius(sigma), mean_radius(sigma) + 1)
    kernel = np.exp(-0.5 * (apart[:, None] ** 2 + apart**2) / sigma**2)[..., None]
    total, count = (
        convolve(x.astype(float), kernel, mode="constant") for x in (values, same[..., :1] ** 0)
    )
    assert np.abs(got - total / count).max() < 2e-6


def test_unlike_colors_are_not_mixed(any_backend_operations):
    """Two halves of different colors keep their own values."""
    guide = np.zeros((20, 30, 1), np.float32)
    guide[:, 15:] = 1.0
    found = any_backend_operations.edge_preserving_mean(
        10 * guide, np.ones((20, 30), np.float32), guide, guide, 4.0, 0.1
    )
    assert np.abs(found - 10 * guide).max() < 1e-5


def test_a_hole_takes_its_value_from_like_neighbors(any_backend_operations):
    values = np.full((15, 15, 1), 3.0, np.float32)
    weights = np.full((15, 15), 1e-6, np.float32)
    weights[7, 7] = 0.0
    values[7, 7] = 1e9
    guide = np.zeros((15, 15, 1), np.float32)
    guide[7, 7] = 1.0  # all unlike
    found = any_backend_operations.edge_preserving_mean(values, weights, guide, guide, 2.0, 0.05)
    assert np.abs(found - 3.0).max() < 1e-5


def test_without_weights_the_mean_is_0(any_backend_operations, rng):
    values, guide = rng.normal(size=(2, 7, 11, 3)).astype(np.float32)
    for fine in (guide, guide[:1, :2]):
        found = any_backend_operations.edge_preserving_mean(
            values, np.zeros((7, 11), np.float32), guide, fine, 1.5, 0.1
        )
        assert np.array_equal(found, np.zeros((*fine.shape[:2], 3)))


def test_means_of_huge_values_and_colors(each_device, rng):
    values, guide = rng.normal(size=(2, 9, 12, 2)).astype(np.float32)
    weights = rng.random((9, 12)).astype(np.float32)
    huge = values * np.float32(1e30), weights, guide * np.float32(1e30), guide * np.float32(1e30)
    got, want = (
        backend.edge_preserving_mean(*huge, 2.0, 0.5) for backend in (each_device, REFERENCE)
    )
    assert np.abs(got - want).max() <= 1e-5 * 1e30


@pytest.mark.parametrize("rounds", [1, 4])
def test_paths_along_a_constant_field(any_backend_operations, rounds):
    """One round is exact."""
    field = np.broadcast_to(np.array([2.0, -3.0], np.float32), (5, 8, 2))
    found = any_backend_operations.follow_paths(field, SAME, (4, 70), 3, rounds)
    for step in range(4):
        assert np.abs(found[step] + step / 3 * np.array([2.0, -3.0])).max() < 1e-6


def test_paths_along_a_linear_field_end_where_it_says(any_backend_operations):
    """In x + t s x = z, so x = z / (1 + t s)."""
    rows, columns = np.mgrid[:40, :50]
    field = (0.25 * np.stack([rows, columns], axis=-1)).astype(np.float32)
    found = any_backend_operations.follow_paths(field, SAME, (40, 50), 5, 40)
    for step, at in enumerate(found):
        places = np.stack([rows, columns], axis=-1)
        assert np.abs(places / (1 + step / 5 * 0.25) - places - at).max() < 1e-5


def test_paths_through_a_strong_expansion_are_smooth(any_backend_operations):
    """A motion that magnifies thirtyfold has one path through each point, and no noise."""
    columns = np.arange(200.0)
    field = np.zeros((8, 200, 2), np.float32)
    field[..., 1] = 30 * np.clip(columns - 98, 0, 2) - 30
    found = any_backend_operations.follow_paths(field, SAME, (8, 200), 48, 8)
    shown = columns + found[-1, ..., 1]
    assert np.diff(shown, axis=1).min() >= -1e-3
    moved = shown + field[0, :, 1][np.clip(np.rint(shown), 0, 199).astype(int)]
    assert np.abs(found[-1, ..., 0]).max() == 0
    far = (shown < 97) | (shown > 101)
    assert np.abs(moved - columns)[far].max() < 1e-3


@pytest.mark.parametrize("size", [1e3, 1e30])
def test_paths_along_huge_fields_are_finite(each_device, rng, size):
    field = (size * rng.normal(size=(6, 7, 2))).astype(np.float32)
    found = each_device.follow_paths(field, Affine((-1e9, 1e9), (1e3, -1e7)), (5, 70), 4, 3)
    assert np.all(np.isfinite(found))


def test_a_constant_motion_shifts_by_whole_pixels(each_device, rng):
    picture = rng.random((30, 75, 4))
    rest = drawn(each_device, still(picture))
    moved = drawn(each_device, still(picture, way=1.0, moved=(4.0, -6.0)))
    halfway = drawn(each_device, still(picture, way=0.5, moved=(4.0, -6.0)))
    assert np.array_equal(moved[:-4, 6:], rest[4:, :-6])
    assert np.array_equal(halfway[:-2, 3:], rest[2:, :-3])


@pytest.mark.parametrize("shape", SHAPES)
def test_at_the_start_a_layer_is_its_picture(any_backend_operations, rng, shape):
    picture = rng.random((*shape, 4))
    layer = still(picture, moved=(7.0, 9.0))._replace(
        change=rng.normal(size=(*shape, 8)).astype(np.float32)
    )
    assert np.abs(drawn(any_backend_operations, layer) - picture).max() < 1e-5
    assert np.abs(drawn(any_backend_operations, layer, 0.5) - picture - 0.5).max() < 1e-5


def test_at_the_end_the_color_has_changed(any_backend_operations, rng):
    picture, change = rng.random((2, 20, 31, 4))
    layer = still(picture, way=1.0)._replace(change=np.dstack((change, picture)).astype(np.float32))
    assert np.abs(drawn(any_backend_operations, layer) - picture - change).max() < 1e-5


def test_weights_select_a_layer(each_device, rng):
    one, other = rng.random((2, 14, 80, 4))
    low = np.zeros((1, 1, 4), np.float32)
    alone = drawn(each_device, still(one)), drawn(each_device, still(other))
    chosen = (rng.random((14, 80)) < 0.5).astype(np.float32)
    layers = (
        still(one)._replace(weights=chosen, shares=1 - chosen),
        still(other)._replace(weights=1 - chosen, shares=chosen),
    )
    found = Scene(layers, low, (14, 80)).draw(each_device)
    colors = np.where(chosen[..., None] == 1, alone[0], alone[1])[..., :3]
    assert np.array_equal(found[..., :3], colors)
    assert np.array_equal(found[..., 3], np.where(chosen == 1, alone[1][..., 3], alone[0][..., 3]))


def test_a_pixel_takes_the_change_of_the_points_that_are_like_it(any_backend_operations):
    """Halfway between two points the likeness of their guides alone decides."""
    guides, changes = np.array([0.0, 1.0]), np.array([0.5, -0.25])
    field = np.zeros((1, 2, 8), np.float32)
    field[0, :, :3], field[0, :, 4:7] = changes[:, None], guides[:, None]
    for color in (0.0, 0.05, 0.5, 1.0, 3.0):
        layer = still(np.full((1, 2, 4), color), way=1.0, moved=(0.0, 0.5))._replace(change=field)
        alike = 1 / (1 + 3 * (guides - color) ** 2 / LIKE**2)
        wanted = color + alike @ changes / alike.sum()
        assert abs(drawn(any_backend_operations, layer)[0, 0, 0] - wanted) < 1e-5


def test_canvas_and_picture_of_other_sizes(any_backend_operations, rng):
    """A picture of 4000 pixels a row, a canvas of a few of them, to 1e-4 pixels."""
    picture = np.cumsum(rng.normal(size=(3, 4001, 4)), axis=1)
    layer = LayerCase(
        coefficients(picture), np.zeros((2, 1, 1, 2), np.float32), np.zeros((1, 1, 8), np.float32),
        0.3, Affine((0.0, 0.0), (1.0, 1.0)), Affine((0.1, 0.3), (0.01, 0.7 / 96)),
        Affine((0.3, 0.4), (1.0, 4000.0)), *2 * [np.ones((1, 1), np.float32)],
    )  # fmt: skip
    found = Scene(
        (layer, absent((1, 1))), np.zeros((1, 1, 4), np.float32), (5, 96)
    ).draw(any_backend_operations)  # fmt: skip
    rows, columns = np.mgrid[:5, :96]
    at = 0.3 + 0.1 + 0.01 * rows, 0.4 + 4000 * (0.3 + 0.7 / 96 * columns)
    for c in range(4):
        want = map_coordinates(picture[..., c], at, order=3, mode="mirror")
        slope = np.abs(np.diff(picture[..., c], axis=1)).max()
        assert np.abs(found[..., c] - want).max() < 1e-4 * slope + 8 * UNIT * np.abs(picture).max()


def test_a_tear_has_no_steps(any_backend_operations):
    """Black moves left and white right: beside the tear pixels are means, and only there."""
    picture = np.zeros((12, 200, 4))
    picture[:, 100:] = 1.0
    layer = still(picture, way=1.0)
    layer.paths[1:, :, :66, 1], layer.paths[1:, :, 66:, 1] = -40.0, 60.0
    found = drawn(any_backend_operations, layer)
    assert np.abs(found[:, :65]).max() < 1e-6
    assert np.abs(found[:, 67:] - 1).max() < 1e-6
    assert np.abs(found[:, 65] - 0.25).max() < 1e-6
    assert np.abs(found[:, 66] - 0.75).max() < 1e-6


@pytest.mark.parametrize("jump", [0.5, 1.0, 1.25, 1.75, 2.0, 3.0])
def test_tears_begin_by_and_by(any_backend_operations, jump):
    layer = still(np.zeros((9, 90, 4)), way=1.0)
    layer.paths[1:, :, :30, 1], layer.paths[1:, :, 30:, 1] = -20.0, -21.0 + jump * TEAR
    layer.coefficients[:] = np.arange(90)[:, None]
    found = drawn(any_backend_operations, layer)[4, 28:32, 0]
    rest = np.array([8.0, 9.0, 9.0 + jump * TEAR, 10.0 + jump * TEAR])
    torn = np.clip(jump - 1, 0, 1)
    mean = rest[1] + torn * ((rest[0] + 2 * rest[1] + rest[2]) / 4 - rest[1])
    assert found[1] == pytest.approx(mean, abs=2e-4)
    assert found[0] == pytest.approx(rest[0], abs=2e-4)


@pytest.mark.parametrize("canvas", [(48, 75), (8, 15), (5, 4)])
@pytest.mark.parametrize("moved", [1.0, 2.5, 12.0, 60.0])
def test_tears_around_a_point_of_the_paths(each_device, rng, canvas, moved):
    """On canvases with many pixels, one, and less than one for each point."""
    grid = 8, 15
    to_grid, to_picture = (
        Affine((0.5 * steps[0] - 0.5, 0.5 * steps[1] - 0.5), steps)
        for steps in (
            tuple(a / b for a, b in zip(grid, canvas, strict=True)),
            tuple(b / a for a, b in zip(grid, (48, 75), strict=True)),
        )
    )
    paths = np.zeros((2, *grid, 2), np.float32)
    paths[1, 3, 6] = moved / 6, -moved / 5
    paths[1, 7, 14, 0] = moved / 6
    layer = LayerCase(
        coefficients(rng.random((48, 75, 4))), paths, np.zeros((*grid, 8), np.float32), 1.0,
        to_grid, to_grid, to_picture, *2 * [np.ones(grid, np.float32)],
    )  # fmt: skip
    scene = Scene((layer, absent(grid)), np.zeros((1, 1, 4), np.float32), canvas)
    got, want = (scene.draw(backend) for backend in (each_device, REFERENCE))
    assert largest(got - want) <= scene.rounding()


def test_pictures_are_constant_beyond_their_borders(any_backend_operations, rng):
    picture = rng.random((12, 30, 4))
    layer = still(picture, way=1.0)
    layer.paths[1:, ..., 0], layer.paths[1:, ..., 1] = -500.0, 7.0
    found = drawn(any_backend_operations, layer)
    columns = np.minimum(np.arange(30) + 7, 29)
    assert np.abs(found - picture[0, columns]).max() < 1e-5


@pytest.mark.parametrize("size", [1e3, 1e30])
def test_places_far_outside_are_finite(each_device, rng, size):
    layer = still(rng.random((10, 70, 4)), way=0.7)
    paths = (size * rng.normal(size=layer.paths.shape)).astype(np.float32)
    away = layer._replace(paths=paths, to_field=Affine((-1e9, 1e9), (1e3, -1e7)))
    assert np.all(np.isfinite(drawn(each_device, away)))
    assert np.abs(drawn(each_device, away)).max() < 2.0


def test_huge_colors(each_device, rng):
    scene = scenes((13, 21))["near"]
    huge = [layer._replace(coefficients=layer.coefficients * 1e30) for layer in scene.layers]
    scene = scene._replace(layers=tuple(huge))
    got, want = (scene.draw(backend) for backend in (each_device, REFERENCE))
    assert largest(got - want) <= scene.rounding()
