"""Sums over grids, one axis after the other: ``cl_kernels/grid_log_sum_exp.cl``."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clmorph.backends.numpy.fields import grid_log_sum_exp as on_host
from clmorph.backends.opencl.build.constants import SENTINEL, BuildConstants
from clmorph.backends.opencl.build.programs import Programs
from clmorph.backends.opencl.kernels.launches import LaunchBudget, Workspace
from clmorph.backends.opencl.kernels.row_loop import LOG2_E
from clmorph.backends.records import Float64

#: Columns that are handled together in sums of exponents, and in those of products, the same as in
#: the kernel.
CHUNK, UNROLL = 8, 4
#: Powers of two under which a kernel counts as 0.
FAINTEST = -126.0, -1022.0
#: What a pass leaves out is at most 2 to the power of minus this share of a sum: in float32, and in
#: float64.
CUT = 26.0, 52.0


class GridLogSumExp:
    """Sums exponentials over grids."""

    def __init__(self, work: Workspace, constants: BuildConstants, programs: Programs) -> None:
        self._work, self._constants, self._programs = work, constants, programs
        self._budgets = {precise: LaunchBudget() for precise in (False, True)}

    def grid_log_sum_exp(
        self, exponents: Float64, axes: Sequence[tuple[Float64, Float64]], precise: bool = False
    ) -> Float64:
        """Return log sum_j exp(e_j - abs(x_i - y_j)^2), by NumPy if float64 is missing."""
        if precise and not self._constants.float64:
            return on_host(exponents, axes)
        real = np.float64 if precise else np.float32
        largest = float(exponents.max())
        scaled = (exponents - largest) * LOG2_E
        np.maximum(scaled, SENTINEL, out=scaled)
        current = self._work.buffer(scaled, real)
        size, found = scaled.size, scaled
        del scaled
        for number, (x, y) in enumerate(reversed(axes)):
            lines = size // len(y)
            size = lines * len(x)
            following = self._work.empty(size * real().itemsize)
            last = number == len(axes) - 1
            if last:
                found = np.empty([len(each) for each, _ in axes], real)
            results = ((found, following),) if last else ()
            self._pass(current, following, lines, x, y, precise, results)
            current = following
        values = found.astype(np.float64)
        values /= LOG2_E
        values += largest
        return values

    def _pass(
        self,
        exponents: cl.MemoryObject,
        found: cl.MemoryObject,
        lines: int,
        x: Float64,
        y: Float64,
        precise: bool,
        results: tuple,
    ) -> None:
        """Sum along one axis."""
        constants = self._constants
        grid_powers, log_sum_exp = (
            self._programs.kernel("grid_log_sum_exp.cl", name, precise)
            for name in ("grid_powers", "grid_log_sum_exp")
        )
        real = np.float64 if precise else np.float32
        lanes = constants.lanes if precise else constants.width
        axis = _axis_of(x, y, lanes, FAINTEST[precise])
        n, m, stride = len(x), len(y), len(axis.kernels)
        blocks = len(axis.ways)
        cut = real(CUT[precise] + np.log2(m))
        # A CPU's work-item takes a whole line, unless loops must be short.
        span = blocks if constants.group == 1 and not constants.longest_loop else 1
        items = -(-blocks // span)
        group = constants.group
        largest, powers = (
            self._work.empty(size * real().itemsize) for size in (lines, lines * stride)
        )
        buffers = (
            largest, powers, self._work.buffer(axis.kernels, real),
            self._work.buffer(axis.places, real), self._work.buffer(axis.columns, real),
            self._work.buffer(axis.ways, np.uint32),
        )  # fmt: skip
        for first, count, last in self._budgets[precise].rows(lines, n * m):
            self._work.launch(
                grid_powers, (-(-count // group) * group,), (group,), np.uint32(first),
                np.uint32(first + count), np.uint32(m), np.uint32(stride), exponents, largest,
                powers,
            )  # fmt: skip
            self._work.launch(
                log_sum_exp, (-(-items // group) * group, count), (group, 1), np.uint32(first),
                np.uint32(lines), np.uint32(span), np.uint32(n), np.uint32(m), np.uint32(stride),
                cut, exponents, *buffers, found, results=results if last else (),
            )  # fmt: skip


class _Axis(NamedTuple):
    """What the kernel knows of an axis, with coordinates in the root of powers of two."""

    places: Float64  #: (n filled to lanes,)
    columns: Float64  #: (m filled to CHUNK,), ascending
    kernels: Float64  #: (m filled to UNROLL, n filled to lanes): 2^(-(x - y)^2)
    ways: NDArray[np.int64]  #: (blocks, 3): where sums over the columns begin and end


def _axis_of(x: Float64, y: Float64, lanes: int, faintest: float) -> _Axis:
    """Return an axis for blocks of `lanes` places; kernels under 2^faintest are 0."""
    m = len(y)
    if y[-1] < y[0]:
        x, y = -x, -y
    middle = 0.5 * (min(x.min(), y[0]) + max(x.max(), y[-1]))
    x, y = (LOG2_E**0.5 * (each - middle) for each in (x, y))
    x = np.concatenate((x, np.full(-len(x) % lanes, x[-1])))
    # The column that is nearest to the middle of each block.
    middles = 0.5 * (x[::lanes] + x[lanes - 1 :: lanes])
    nearest = np.searchsorted(0.5 * (y[1:] + y[:-1]), middles) // CHUNK
    exponents = np.full((m + -m % UNROLL, len(x)), -np.inf)
    exponents[:m] = -((y[:, None] - x) ** 2)
    exponents[exponents <= faintest] = -np.inf
    parts = np.isfinite(exponents).reshape(-1, UNROLL, len(middles), lanes)
    seen = np.any(parts, axis=(1, 3))
    first, rest = (np.argmax(each, axis=0) for each in (seen, seen[::-1]))
    end = np.where(seen.any(axis=0), len(seen) - rest, first)
    return _Axis(
        x, np.concatenate((y, np.full(-m % CHUNK, y[-1]))), np.exp2(exponents),
        np.stack((nearest, UNROLL * first, UNROLL * end), axis=1),
    )  # fmt: skip
