"""Masses on grids: the same problem as points, closed forms, masks, errors, memory."""

import tracemalloc

import numpy as np
import pytest

import clmorph
from clmorph.measures.points import WeightedPoints

#: Shapes, spacings and origins of pairs of grids: anisotropic, descending, with an axis of one.
PAIRS = [
    (((30,), 0.1, 0.0), ((23,), -0.13, 2.5)),
    (((7, 5), (0.1, 0.07), (0.3, -1.0)), ((4, 9), (-0.08, 0.11), (1.0, -1.2))),
    (((5, 1, 4), (0.1, 1.0, 0.2), 0.0), ((3, 6, 2), (0.15, 0.1, 0.1), 0.1)),
]
IDS = ["1D", "2D", "3D"]


def random_grids(pair, equal_masses=False):
    """Two grids with empty and masked cells."""
    rng, made = np.random.default_rng(3), []
    for shape, spacing, origin in pair:
        masses = rng.random(shape) ** 3
        masses[rng.random(shape) < 0.2] = 0.0
        mask = rng.random(shape) < 0.8
        mask.flat[0], masses.flat[0] = True, 0.5
        if equal_masses:
            masses = masses / masses[mask].sum()
        masses[~mask] = np.nan
        made.append(clmorph.grid_measure(masses, spacing, origin, mask))
    return made


def as_points(grid):
    """The cells of positive mass, and their places."""
    there = grid.weights > 0
    return WeightedPoints(grid.points[there], grid.weights[there]), there


@pytest.mark.parametrize("reach", [None, 0.4, (0.3, None), (None, 0.5), (0.2, 0.9)], ids=str)
@pytest.mark.parametrize("pair", PAIRS, ids=IDS)
def test_the_same_problem_as_points(pair, reach, any_backend):
    grids = random_grids(pair, equal_masses=reach is None)
    (x, rows), (y, columns) = map(as_points, grids)
    options = {"blur": 0.12, "reach": reach, "tol": 1e-7}
    found = clmorph.sinkhorn(*grids, backend=any_backend, **options)
    want = clmorph.sinkhorn(x, y, backend="numpy", **options)
    assert found.converged
    change = found.f[rows] - want.f
    shift = change.mean() if reach is None else 0.0
    assert np.abs(change - shift).max() < 1e-5 * found.epsilon
    assert np.abs(found.g[columns] + shift - want.g).max() < 1e-5 * found.epsilon
    assert max(found.dual, want.dual) <= min(found.primal, want.primal)
    assert found.truncation_error < 1e-10
    assert np.abs(found.row_mass[rows] - want.row_mass).max() < 1e-6 * x.mass
    assert not found.row_mass[~rows].any()
    moved = clmorph.displacement_field(*grids, found, backend=any_backend)
    means = clmorph.barycentric_plan(x, y, want, backend="numpy").positions
    field = moved.field.reshape(-1, grids[0].dimension)
    assert np.abs(field[rows] - (means - x.points)).max() < 1e-6
    assert not field[~rows].any()
    assert moved.mean == pytest.approx(np.average(moved.length.ravel(), weights=found.row_mass))
    np.testing.assert_allclose(moved.length.ravel(), np.linalg.norm(field, axis=1))
    plan = clmorph.transport_plan(x, y, want, backend="numpy", relative=1e-12).toarray()
    costs = 0.5 * ((x.points[:, None] - y.points) ** 2).sum(axis=2)
    assert moved.cost == pytest.approx((plan * costs).sum(), rel=1e-6)
    assert moved.transported_mass == pytest.approx(found.transported_mass)
    assert moved.column_mass.sum() == pytest.approx(found.transported_mass, rel=1e-6)


@pytest.mark.parametrize("reach", [None, 0.4], ids=str)
@pytest.mark.parametrize("pair", PAIRS, ids=IDS)
def test_divergences_and_derivatives(pair, reach, any_backend):
    grids = random_grids(pair, equal_masses=reach is None)
    clouds = [(grid.weights, grid.points) for grid in grids]
    options = {"blur": 0.12, "reach": reach, "tol": 1e-7, "gradient": True}
    found = clmorph.sinkhorn_divergence(*grids, backend=any_backend, **options)
    want = clmorph.sinkhorn_divergence(*clouds, backend="numpy", **options)
    assert max(found.interval[0], want.interval[0]) <= min(found.interval[1], want.interval[1])
    for name in ("source_points", "source_weights", "target_points", "target_weights"):
        ours, theirs = (getattr(each.gradient, name) for each in (found, want))
        assert np.abs(ours - theirs).max() < 1e-5 * max(1.0, np.abs(theirs).max()), name
    assert float(clmorph.sinkhorn_divergence(grids[0], grids[0], 0.1, reach, backend="numpy")) == 0


def test_a_small_blur_needs_more_than_float32(device):
    """Cells are 10,000 blurs apart, and float32 exponents are off by nats."""
    rng = np.random.default_rng(1)
    masses = [rng.random((8, 9)) for _ in range(2)]
    source, target = (clmorph.grid_measure(each / each.sum(), 5.0) for each in masses)
    options = {"blur": 0.005, "reach": 1.0, "tol": 1e-4}
    found = clmorph.sinkhorn(source, target, backend=device, **options)
    want = clmorph.sinkhorn(source, target, backend="numpy", **options)
    assert (found.converged, found.precise) == (True, True)
    assert abs(found.dual - want.dual) <= found.gap + want.gap


def test_a_barycenter_of_grids_is_on_their_grid():
    even = clmorph.grid_measure(np.ones((3, 4)))
    assert clmorph.barycenter([even] * 2, fixed=True, backend="numpy").grid.shape == (3, 4)
    points = [(even.weights, even.points)] * 2
    assert clmorph.barycenter(points, blur=0.5, backend="numpy").grid is None


def test_other_functions_take_the_cells_as_points():
    source, target = random_grids(PAIRS[1])
    points = target.weights, target.points
    options = {"blur": 0.2, "reach": 0.5, "backend": "numpy"}
    found = clmorph.sinkhorn(source, target, **options)
    mixed = clmorph.sinkhorn(source, points, **options)
    assert np.abs(found.f - mixed.f).max() < 1e-2 * found.epsilon
    plan = clmorph.transport_plan(source, target, found, backend="numpy")
    assert plan.mass.sum() == pytest.approx(found.transported_mass, rel=1e-3)
    means = clmorph.barycentric_plan(source, target, found, backend="numpy").positions
    field = clmorph.displacement_field(source, target, found, backend="numpy").field
    moved = (means - source.points) * (source.weights > 0)[:, None]
    np.testing.assert_allclose(field.reshape(-1, 2), moved, atol=1e-12)
    np.testing.assert_allclose(found.map(source, backend="numpy"), means, atol=1e-12)
    batch = clmorph.sinkhorn_batch([source], [target], **options)
    assert batch[0].dual == pytest.approx(found.dual, rel=1e-6)


class Labelled:
    """What xarray.DataArray has: dims, coords, and an array."""

    def __init__(self, values, dims, **coords):
        self.values, self.dims, self.coords = np.asarray(values), dims, coords

    def __array__(self, dtype=None, copy=None):
        return self.values.astype(dtype or self.values.dtype)


def test_a_labelled_array_brings_its_coordinates():
    depth = np.array([0.0, 10.0, 50.0])
    field = Labelled(np.ones((3, 2)), ("depth", "x"), depth=depth)
    grid = clmorph.grid_measure(field)
    assert [axis.tolist() for axis in grid.axes] == [[0, 10, 50], [0, 1]]
    grid = clmorph.grid_measure(field, spacing=2.0)
    assert [axis.tolist() for axis in grid.axes] == [[0, 2, 4], [0, 2]]
    days = Labelled(np.ones(2), ("time",), time=np.array(["2020-01-01", "2020-01-02"], "M8[D]"))
    with pytest.raises(clmorph.InputError, match="'time' have dtype datetime64"):
        clmorph.grid_measure(days)
    square = Labelled(np.ones((2, 2)), ("y", "x"))
    mask = Labelled(np.eye(2, dtype=bool), ("x", "y"))
    with pytest.raises(clmorph.InputError, match="mask has the dimensions"):
        clmorph.grid_measure(square, mask=mask)


def test_xarray():
    xarray = pytest.importorskip("xarray")
    values = xarray.DataArray(
        [[1.0, np.nan], [2.0, 3.0]], {"lat": [40.0, 30.0], "lon": [0.0, 5.0]}, ("lat", "lon")
    )
    grid = clmorph.grid_measure(values, mask=values.notnull())
    assert grid.points.tolist() == [[40.0, 0.0], [40.0, 5.0], [30.0, 0.0], [30.0, 5.0]]
    assert values.copy(data=grid.array(grid.weights)).equals(values)


@pytest.mark.parametrize(
    ("values", "options", "words"),
    [
        ([[np.nan, 1.0]], {}, "hold NaN: expected masses; give a mask"),
        ([[np.inf, 1.0]], {}, "expected masses of at least 0"),
        ([[-1.0, 2.0]], {}, "expected masses of at least 0"),
        (np.zeros((2, 2)), {}, "expected masses of at least 0"),
        (3.0, {}, "with 1 to 11 axes"),
        (np.ones((1, 0)), {}, "with 1 to 11 axes"),
        ("volume", {}, "values is a str"),
        (np.ones((2, 3)), {"spacing": 0.0}, "other than 0"),
        (np.ones((2, 3)), {"spacing": (1, 2, 3)}, "one for each of 2 axes"),
        (np.ones((2, 3)), {"origin": np.nan}, "expected a finite number"),
        (np.ones((2, 3)), {"mask": np.ones((3, 2), bool)}, "expected (2, 3) and bool"),
        (np.ones((2, 3)), {"mask": np.ones((2, 3))}, "and bool, as of a comparison"),
        (np.ones((2, 3)), {"mask": np.zeros((2, 3), bool)}, "selects no cell"),
        (np.ones((2, 3)), {"axes": [[0, 0], [0, 1, 2]]}, "must ascend, or descend"),
        (np.ones((2, 3)), {"axes": [[0, np.nan], [0, 1, 2]]}, "axis 0 are not all within"),
        (np.ones((2, 3)), {"axes": [[0, 1]]}, "expected a coordinate for each place"),
        (np.ones((2, 3)), {"axes": 5}, "expected a list of arrays"),
        (np.ones((2, 3)), {"axes": [[0, 1], [0, 1, 2]], "spacing": 1}, "either of them"),
        (np.ones((2, 3)), {"spacing": 1e9}, "choose another unit"),
        (np.ones((5000, 1)), {}, "4096 along an axis"),
    ],
)  # fmt: skip
def test_unusable_grids(values, options, words):
    with pytest.raises(clmorph.InputError) as raised:
        clmorph.grid_measure(values, **options)
    assert words in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda a, b: clmorph.sinkhorn(a, clmorph.grid_measure([1.0])), "target in 1: expected"),
        (lambda a, b: clmorph.sinkhorn(a, b, truncation=1e-5), "as they are by default"),
        (lambda a, b: clmorph.sinkhorn(a, b, multiscale=True), "as they are by default"),
        (lambda a, b: clmorph.sinkhorn(a, a.with_masses(2 * a.masses)), "is impossible"),
        (lambda a, b: clmorph.sinkhorn(clmorph.Grid(a.masses, (1, 2)), b), "not a usable Grid"),
        (lambda a, b: clmorph.sinkhorn(clmorph.Grid(-a.masses, a.axes), b), "masses of at least 0"),
        (lambda a, b: clmorph.sinkhorn(clmorph.Grid(a.masses, a.axes, 1), b), "not a usable Grid"),
        (lambda a, b: a.with_masses([1.0]), "expected (2, 3)"),
        (lambda a, b: a.array([1.0]), "expected (6,)"),
        (lambda a, b: clmorph.displacement_field(a, (b.weights, b.points), None), "two grids"),
        (lambda a, b: clmorph.displacement_field(a, b, None), "expected Potentials"),
        (lambda a, b: clmorph.displacement_field(
            a, a, clmorph.sinkhorn(a, b, 0.5, 2.0, backend="numpy"), backend="numpy"
        ), "of other measures"),
        (lambda a, b: clmorph.barycenter(
            [a, a], support=clmorph.grid_measure([1.0]), fixed=True
        ), "support has points in 1 dimensions"),
    ],
)  # fmt: skip
def test_mistakes(call, words):
    a = clmorph.grid_measure(np.arange(6.0).reshape(2, 3))
    b = a.with_masses(a.masses[::-1, ::-1])
    with pytest.raises(clmorph.InputError) as raised:
        call(a, b)
    assert words in str(raised.value)


def test_memory_is_proportional_to_the_number_of_cells(device):
    """A dense row of pairs for each cell would be thousands of vectors."""
    rng = np.random.default_rng(0)
    source, target = (clmorph.grid_measure(rng.random((40, 40, 40)), 1 / 40) for _ in range(2))
    clmorph.sinkhorn(source, target, 0.1, 0.3, max_iter=1, tol=1000, backend=device)
    tracemalloc.start()
    solved = clmorph.sinkhorn(source, target, 0.1, 0.3, backend=device)
    clmorph.displacement_field(source, target, solved, backend=device)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert solved.converged
    assert most < 90 * source.weights.nbytes
    assert "points" not in source.__dict__, "the coordinates of all cells are needless"
