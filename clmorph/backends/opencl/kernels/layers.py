"""Fields of layers, paths along them, and frames of two layers, by ``cl_kernels/layers.cl``."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clmorph.backends.numpy.layers import LEAST_WEIGHT, mean_radius, nearest_cells, with_steepness
from clmorph.backends.opencl.build.constants import BuildConstants
from clmorph.backends.opencl.build.programs import Programs
from clmorph.backends.opencl.kernels import loop_limits
from clmorph.backends.opencl.kernels.launches import LaunchBudget, Results, Workspace
from clmorph.backends.records import LIKE, TEAR, Affine, Float32, Float64, LayerView

#: Work-items of a group, along a row, where a device takes so many: more than the lanes of any.
GROUP = 64
#: Pairs of a point and a cell of the first launch, steps of all points, points, and pixels.
FIRST_PAIRS, FIRST_STEPS, FIRST_POINTS, FIRST_PIXELS = 1 << 20, 1 << 20, 1 << 18, 1 << 17
#: A pixel beside a tear takes at most as long as so many others: nine colors in place of one.
TORN_PIXELS = 9
#: Farther outside a picture nothing is told apart.
FARTHEST = 1e6


class Spline(NamedTuple):
    """The coefficients of a picture's spline, on the device."""

    shape: tuple[int, int]
    coefficients: cl.Buffer  # (H, W, 4) float32


class Layer(NamedTuple):
    """What moves and recolors a picture, on the device."""

    steps: int
    shape: tuple[int, int]  # of the paths' grid
    paths: cl.Buffer  # (steps + 1, H, W, 2) float32
    field: tuple[int, int]  # shape of the field
    change: cl.Buffer  # (h, w, 2, 4) float32


class Layers:
    """Averages fields, follows paths along them, and draws layers."""

    def __init__(self, work: Workspace, constants: BuildConstants, programs: Programs) -> None:
        self._work, self._constants, self._programs = work, constants, programs
        self._group = min(GROUP, work.device.max_work_group_size)
        self._of_means, self._of_paths = LaunchBudget(FIRST_PAIRS), LaunchBudget(FIRST_STEPS)
        self._of_points, self._of_pixels = LaunchBudget(FIRST_POINTS), LaunchBudget(FIRST_PIXELS)

    def edge_preserving_mean(
        self,
        values: Float32,
        weights: Float32,
        guide: Float32,
        fine_guide: Float32,
        sigma: float,
        tolerance: float,
    ) -> Float64:
        """Average values over like neighbors; see `clmorph.backends.interface.Operations`."""
        make, width = cl.cltypes, self._constants.width
        grid, shape = weights.shape, fine_guide.shape[:2]
        many, of_guide = values.shape[2], guide.shape[2]
        rows, columns = around = [
            _Window(few, many, sigma, lanes)
            for few, many, lanes in zip(grid, shape, (1, width), strict=True)
        ]
        padded = grid[1] + columns.cells
        planes = np.zeros((1 + many + of_guide, grid[0], padded), np.float32)
        inside = planes[:, :, columns.radius : columns.radius + grid[1]]
        inside[0] = weights
        inside[1 : 1 + many] = np.moveaxis(values, -1, 0)
        inside[1 + many :] = np.moveaxis(guide, -1, 0)
        # Cells left of the first one are in the rows, those above it are not.
        firsts = rows.firsts, columns.firsts + columns.radius
        given = (
            *(self._work.buffer(first, np.int32) for first in firsts),
            *(self._work.buffer(window.weights) for window in around),
            self._work.buffer(planes), self._work.buffer(fine_guide),
        )  # fmt: skip
        sums = np.zeros((*shape, 1 + many), np.float32)
        buffer = self._work.buffer(sums)
        sharpness = float(np.sqrt(0.5 * np.log2(np.e))) / tolerance
        at_once = loop_limits.mean_rows(self._constants, columns.cells)
        pairs = rows.cells * columns.cells * shape[1]
        for first, count, last in self._of_means.rows(shape[0], pairs):
            for begin in range(0, rows.cells, at_once):
                end = min(begin + at_once, rows.cells)
                whole = last and end == rows.cells
                self._launch(
                    "edge_preserving_mean", (shape[1], count), np.uint32(first),
                    np.uint32(shape[1]), make.make_uint2(many, of_guide),
                    make.make_int2(grid[0], padded), make.make_int2(rows.cells, columns.cells),
                    make.make_int2(begin, end), np.float32(sharpness), *given, buffer,
                    results=((sums, buffer),) if whole else (),
                )  # fmt: skip
        found = sums.astype(float)
        return found[..., 1:] / np.maximum(found[..., :1], LEAST_WEIGHT)

    def follow_paths(
        self, field: Float32, to_field: Affine, shape: tuple[int, int], steps: int, rounds: int
    ) -> Float32:
        """Follow places backwards along a field; see `clmorph.backends.interface.Operations`."""
        make = cl.cltypes
        places = [self._work.buffer(_apart(place)) for place in to_field.axes(shape)]
        # A kernel reads four numbers at once.
        on_device = self._work.buffer(np.pad(with_steepness(field), ((0, 0), (0, 0), (0, 1))))
        found = np.empty((steps + 1, *shape, 2), np.float32)
        buffer = self._work.empty(found.nbytes)
        samples = shape[1] * (steps * rounds + 1)
        for first, count, last in self._of_paths.rows(shape[0], samples):
            self._launch(
                "follow_paths", (shape[1], count), np.uint32(first), make.make_uint2(*shape),
                make.make_int2(*field.shape[:2]), np.uint32(steps), np.uint32(rounds),
                *places, on_device, buffer, results=((found, buffer),) if last else (),
            )  # fmt: skip
        return found

    def upload_spline(self, coefficients: NDArray[np.float32]) -> Spline:
        """Upload a picture; see `clmorph.backends.interface.Operations`."""
        height, width = coefficients.shape[:2]
        return Spline((height, width), self._work.buffer(coefficients))

    def upload_layer(self, paths: Float32, change: Float32) -> Layer:
        """Upload what moves and recolors; see `clmorph.backends.interface.Operations`."""
        steps, height, width = paths.shape[:3]
        return Layer(
            steps - 1, (height, width), self._work.buffer(paths),
            (change.shape[0], change.shape[1]), self._work.buffer(change),
        )  # fmt: skip

    def draw_layers(
        self,
        views: Sequence[LayerView],
        low: Float32,
        shape: tuple[int, int],
        rows: slice | None = None,
    ) -> Float32:
        """Draw two layers over one another; see `clmorph.backends.interface.Operations`."""
        make = cl.cltypes
        tables = [
            [_between(_over(few, many), few)]
            for few, many in zip(low.shape[:2], shape, strict=True)
        ]  # fmt: skip
        for view in views:
            for table, tables_of_view in zip(tables, _tables(view, shape), strict=True):
                table += tables_of_view
        on_rows, on_columns = (self._work.buffer(np.stack(table)) for table in tables)
        placed = [self._placed(view) for view in views]

        def both(name: str, values: Sequence[Any]) -> Any:
            """Return a vector of what both layers have."""
            return getattr(make, f"make_{name}")(*np.ravel(values))

        layers = [view.layer for view in views]
        given = (
            make.make_int2(*shape), on_rows, on_columns, make.make_int2(*low.shape[:2]),
            self._work.buffer(low), both("int4", [layer.shape for layer in layers]),
            both("int4", [layer.field for layer in layers]),
            both("int4", [view.picture.shape for view in views]),
            both("float4", [view.to_picture.step for view in views]),
            both("float2", [1.0 / (TEAR * _unit(view)) for view in views]),
            both("float2", [view.way for view in views]),
            np.float32(1.0 / LIKE**2),
        )  # fmt: skip
        buffers = [
            buffer
            for view, points in zip(views, placed, strict=True)
            for buffer in (
                points, view.layer.change, view.picture.coefficients,
                self._work.buffer(view.shares),
            )
        ]  # fmt: skip
        start, stop = (0, shape[0]) if rows is None else (rows.start, rows.stop)
        frame = np.empty((stop - start, shape[1], 4), np.float32)
        # Where all pixels are torn, a launch takes as long as the budget allows.
        for first, count, _ in self._of_pixels.rows(stop - start, shape[1], TORN_PIXELS):
            out = frame[first : first + count]
            buffer = self._work.empty(out.nbytes)
            self._launch(
                "draw_layers", (shape[1], count), np.uint32(start + first), *given, *buffers,
                buffer, results=((out, buffer),),
            )  # fmt: skip
        return frame

    def _placed(self, view: LayerView) -> cl.MemoryObject:
        """Return displacements, weights and tears of a layer: (H, W, 4) on the device."""
        make, layer = cl.cltypes, view.layer
        height, width = layer.shape
        step = min(int(view.way * layer.steps), layer.steps - 1)
        weights = self._work.buffer(view.weights)
        buffer = self._work.empty(16 * height * width)
        for first, count, _ in self._of_points.rows(height, width):
            self._launch(
                "place_layer", (width, count), np.uint32(first), make.make_int2(height, width),
                np.float32(view.way * layer.steps - step),
                make.make_float2(*view.to_picture.step), np.float32(_untorn(view)),
                layer.paths, np.uint32(step), weights, buffer,
            )  # fmt: skip
        return buffer

    def _launch(
        self, name: str, size: tuple[int, int], *arguments: Any, results: Results = ()
    ) -> None:
        """Run a kernel for (width, height) points."""
        (width, height), group = size, self._group
        self._work.launch(
            self._programs.kernel("layers.cl", name), (-(-width // group) * group, height),
            (group, 1), *arguments, results=results,
        )  # fmt: skip


class _Window:
    """The `cells` around each point along one axis, `radius` on each side, filled up to lanes."""

    def __init__(self, few: int, many: int, sigma: float, lanes: int) -> None:
        # `firsts`, (points,), may be below 0; `weights`, (points, cells), are Gaussians.
        places, centers = nearest_cells(few, many)
        self.radius = min(mean_radius(sigma), few - 1)
        wanted = 2 * self.radius + 1
        self.cells = -(-wanted // lanes) * lanes
        self.firsts = centers - self.radius
        apart = self.firsts[:, None] + np.arange(wanted) - places[:, None]
        self.weights = np.zeros((many, self.cells), np.float32)
        self.weights[:, :wanted] = np.exp(-0.5 * apart**2 / sigma**2)


def _over(few: int, many: int) -> Float64:
    """Return where many pixels stand on few ones over the same extent."""
    return (np.arange(many, dtype=float) - (many - 1) / 2) * (few / many) + (few - 1) / 2


def _apart(places: Float64) -> Float32:
    """Return places as whole numbers and the parts to be added to them: (2, N) array."""
    places = np.clip(places, -FARTHEST, FARTHEST)
    whole = np.floor(places)
    return np.stack([whole, places - whole]).astype(np.float32)


def _between(places: Float64, side: int) -> Float32:
    """Return the first of the two points around each place, and the other's weight: (2, N)."""
    places = np.clip(places, 0.0, side - 1)
    low = np.minimum(np.floor(places), max(side - 2, 0))
    return np.stack([low, places - low]).astype(np.float32)


def _tables(view: LayerView, shape: tuple[int, int]) -> Iterator[list[Float32]]:
    """Yield where the rows, then the columns, of a canvas stand on the three grids of a layer."""
    axes = zip(
        view.to_paths.axes(shape), view.to_field.axes(shape), view.layer.shape,
        view.to_picture.origin, view.to_picture.step, strict=True,
    )  # fmt: skip
    for on_paths, on_field, side, origin, step in axes:
        yield [_between(on_paths, side), _apart(on_field), _apart(origin + step * on_field)]


def _unit(view: LayerView) -> float:
    """Return the distance in the picture of two neighbors that do not move."""
    steps = zip(view.to_field.step, view.to_picture.step, strict=True)
    return max(1e-6, *(abs(a * b) for a, b in steps))


def _untorn(view: LayerView) -> float:
    """Return up to which distance, squared, two points of the paths tear nothing."""
    step = max(abs(step) for step in view.to_paths.step)
    if step > 1.0:  # many points between neighbors
        return -1.0
    # Less than what is left, for rounding.
    return float((0.999 * (TEAR - 1.0) * _unit(view) / max(step, 1e-6)) ** 2)
