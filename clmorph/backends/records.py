"""The records that operations return in addition to plain arrays, and the types of these arrays."""

import warnings
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from clmorph.errors import ClmorphWarning, DeviceError

Float64 = NDArray[np.float64]
Float32 = NDArray[np.float32]

#: What this process has been told of programs that it does without.
_told: set[str] = set()


class ProgramError(DeviceError):
    """A program cannot be built or is not used; others of the device may work."""

    def tell(self, instead: str) -> None:
        """Warn, once, that work goes on without the program."""
        text = f"{instead}: {self}"
        if text not in _told:
            _told.add(text)
            warnings.warn(text, ClmorphWarning, stacklevel=3)


class PlanTerms(NamedTuple):
    """A plan (Eq. 2), and the thresholds of its pairs, see `Operations.plan_rows`."""

    rows: Any  #: clouds of the backend
    columns: Any
    f: Float64
    g: Float64
    epsilon: float
    row_thresholds: Float64  #: (N,) nats
    column_thresholds: Float64  #: (M,) nats
    looked_at: Any = None  #: what a backend searches, in its own terms; None for everything


class PlanRows(NamedTuple):
    """Kept pairs of a plan, row after row, columns ascending inside a row."""

    indptr: NDArray[np.int64]  #: (N + 1,) where each row begins
    indices: NDArray[np.int32]  #: (kept,) column of each pair
    mass: Float64  #: (kept,) mass of each pair


#: Neighbors that a layer takes from places this many times as far apart as pixels stand beside a
#: tear: from here to twice as far, pixels change to means over 3 x 3 pixels.
TEAR = 3.0
#: The distance of colors that count half as like, where the change of color is sampled. Colors of
#: all spaces are scaled so that two random ones are equally far apart.
LIKE = 0.22


class Affine(NamedTuple):
    """A point (row, column) of one grid stands at origin + step * (row, column) of another one."""

    origin: tuple[float, float]
    step: tuple[float, float]

    def axes(self, shape: tuple[int, int]) -> list[Float64]:
        """Return where the rows, and the columns, of a grid of some shape stand."""
        axes = zip(self.origin, self.step, shape, strict=True)
        return [origin + step * np.arange(side, dtype=float) for origin, step, side in axes]

    def places(self, shape: tuple[int, int]) -> Float64:
        """Return where each point of a grid of some shape stands: (H, W, 2) array."""
        rows, columns = self.axes(shape)
        return np.stack(np.broadcast_arrays(rows[:, None], columns), axis=-1)


class LayerView(NamedTuple):
    """One picture, moved and recolored, as `Operations.draw_layers` draws it.

    A pixel of the canvas stands at `to_paths` on the grid of the paths and at `to_field` on that of
    the field. It shows what is at the place x = `to_field` + path of the field's grid: the picture
    at `to_picture` applied to x, plus `way` times the change of color at x.
    """

    #: What `Operations.upload_spline` has returned.
    picture: Any
    #: What `Operations.upload_layer` has returned.
    layer: Any
    #: Share of its way that the picture has gone, from 0 to 1.
    way: float
    to_paths: Affine
    to_field: Affine
    to_picture: Affine
    #: Weight of the first three channels, on the grid of the paths: (h, w) array.
    weights: Float32
    #: Weight of the fourth channel there: (h, w) array.
    shares: Float32


class Bins(NamedTuple):
    """Particles sorted into square bins of the canvas and its margin."""

    shape: tuple[int, int]  #: bins along y and x, margins included
    starts: NDArray[np.int64]  #: (bins + 1,) where each bin begins in `order`
    order: NDArray[np.int64]  #: (K,) particles by bin; inside a bin in their own order


class NearPairs(NamedTuple):
    """The pairs of two clouds that contribute to sums, as found by `Operations.near_pairs`.

    The share of the pairs that are left out is bounded: a row's sum over all columns is at most
    1 + `skipped` times its sum over these pairs, at the potential and epsilon of the search.
    """

    pairs: Any  #: the backend's own handle
    softmin: Float64  #: (N,) T(g) over these pairs, or over a larger set; cost units
    skipped: Float64  #: (N,) above 0 where a pair is left out
    n_pairs: int  #: number of pairs that are visited
    n_columns: int  #: the largest number of columns of a row
    largest: float  #: the largest cost among the pairs, cost units


class LastPasses(NamedTuple):
    """What the last two softmins of a large solve leave to a plan of the same potentials."""

    operations: Any  #: the backend
    potentials: tuple[Float64, Float64]  #: f and g, for which these results are
    softmins: tuple[Float64, Float64]  #: T(g) and T(f), cost units
    near: tuple[NearPairs, NearPairs]  #: the pairs that these have summed
    clouds: tuple[Any, Any]  #: source and target, which the backend holds

    def swapped(self) -> "LastPasses":
        """Return those of the problem with source and target exchanged."""
        return self._replace(
            potentials=self.potentials[::-1], softmins=self.softmins[::-1], near=self.near[::-1],
            clouds=self.clouds[::-1],
        )  # fmt: skip


class StoredPairs(NamedTuple):
    """Pairs of a plan that a backend holds, see `Operations.store_pairs`."""

    pairs: Any  #: the backend's own handle
    n_pairs: int  #: number of pairs
    #: The order in which the backend keeps the rows and the columns: indices of the points.
    orders: tuple[NDArray[np.intp], NDArray[np.intp]]


class StoredVectors(NamedTuple):
    """One side of a problem over stored pairs, in the order of `StoredPairs.orders`, (N,) each."""

    masses: Float64
    #: The softmin plus epsilon times the logarithm of the sum over stored pairs, cost units.
    base: Float64
    alone: Float64  #: the softmin of points without a stored pair, cost units
    origin: Float64  #: the potential for which the pairs were stored, cost units


class IterationNumbers(NamedTuple):
    """What the host reads after an iteration on the device; see `Iteration`."""

    mass: Any  #: of the plan, after the half-step of f
    row_dual: Any  #: the dual then, without its constant
    residual: Any  #: after the softmin of f, units of epsilon
    column_dual: Any  #: the dual after the half-step of g, without its constant
    extrapolated: Any  #: whether there is a guess for the next potential
    cut: Any  #: whether the trust region has limited it
    finite: Any  #: whether both softmins are finite
    #: The farthest move of f from the center of the trust region, cost units; 0 without a region.
    moved: Any = 0.0


def bin_grid(shape: tuple[int, int], margin: int, size: float) -> tuple[int, int]:
    """Return the number of bins along y and x for a canvas and its margin."""
    height, width = (int(-(-side // size)) + 2 * margin for side in shape)
    return height, width


#: The potential at which an iteration begins: the host's, or what the last one has found.
START, IMAGE, GUESS = range(3)
#: The bits of a control that have one of these, and a parity: which one of two places the
#: iteration writes. The other place has what the last one has found.
SOURCE, PARITY = 0b111, 0b100


def control_of(source: Any, begun: Any, place: Any, count: Any) -> Any:
    """Return in one number what an iteration has to know; see `ResidentIteration`."""
    return source | begun << 3 | place << 4 | count << 8


def next_source(control: Any, guessed: Any) -> Any:
    """Return the source of the next iteration, which begins at this one's guess or image."""
    return IMAGE + guessed | control & PARITY ^ PARITY


class ResidentIteration(Protocol):
    """Sinkhorn's iteration between two clouds, or over stored pairs, with vectors on the device.

    An iteration is a half-step of f and one of g, each with its shift, and an extrapolation of g:
    the formulas of `clmorph.transport._solver.steps`. The host reads a few numbers and decides
    which potential is the next. In iterations of many problems, each number and truth value is an
    array with one for each problem.
    """

    def set_potential(self, g: Float64, epsilon: float, precise: bool) -> None:
        """Set the potentials g, (M,), of all problems, at which iterations begin; cost units."""

    def iterate(self, control: Any, radius: Any) -> IterationNumbers:
        """Run one iteration, with one wait; it writes an image and a guess of the next g.

        The control, by `control_of`, tells the `source` of g: START, or the IMAGE or GUESS of the
        iteration before. `begun` tells whether an iterate is stored, with which this one makes a
        difference; the difference goes to `place` (0 to 15), and `count` of them (at most 16) are
        then stored. An iteration is dropped by another one of the same parity. `radius` is that of
        the trust region, see `clmorph.transport._solver.anderson`.
        """

    def keep(self, problems: NDArray[np.intp]) -> None:
        """Go on with some of all problems until the next potential is set, for all of them."""

    def potentials(self) -> tuple[Float64, Float64, Float64]:
        """Return f, (N,), images of g, (2, M), the last one at its parity, and T(f), (M,).

        Those of all problems, and perhaps further numbers; no longer kept ones stay as they were.
        """


@dataclass(frozen=True)
class WidthLevels:
    """Widths in a geometric sequence around a base width sigma."""

    #: Number of levels, at most 256: devices keep a level in a byte.
    count: int
    #: The level whose width is sigma.
    base: int
    #: Number of levels from a width to its double.
    per_octave: int

    def factor(self, level: NDArray[np.integer] | int) -> NDArray[np.float64]:
        """Return the width of a level, from 0 to `count` - 1, in units of sigma."""
        return np.asarray(2.0 ** ((np.asarray(level) - self.base) / self.per_octave))


#: The levels for widths from sigma / 4 to 45 sigma.
WIDTH_LEVELS = WidthLevels(count=16, base=4, per_octave=2)
