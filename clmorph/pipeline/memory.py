"""What a morph will take before it runs: kept pairs, memory, time."""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.validation import check_integer, check_number
from clmorph.backends.interface import Operations
from clmorph.backends.select import Backend, get_backend
from clmorph.errors import InputError
from clmorph.measures.points import AnyMeasure, MeasureLike, WeightedPoints, as_pair
from clmorph.transport.options import MAX_DRAWS, PruningOptions
from clmorph.transport.plan_sampling import n_draws
from clmorph.transport.potentials import Potentials
from clmorph.transport.pruning import check_log_threshold

Array = NDArray[np.float64]

#: Rows, and as many columns, from which the number of kept pairs is predicted.
SAMPLED_ROWS = 512

#: Draws from a row below which its mean destination serves better.
FEWEST_DRAWS = 4

#: Bytes on the host, at the peak of each stage, as measured: for a point while potentials are
#: sought; for a point and for a pair while a morph is made and drawn; for a source point whose
#: destinations are summed up; and whatever the size.
SOLVER_POINT, MORPH_POINT, MORPH_PAIR, BARYCENTRIC_POINT, BASE = 380, 300, 92, 400, 500_000
#: The same for a pair of images with opacity, whose particles stand there twice.
MATTER_PAIR = 120
#: Points of a tile, and how many levels between tiles are formed at a time, 8 bytes each, thrice.
TILE, LEVELS = 32, 1 << 22

#: Bytes on the device: for a coordinate of a point, for a point besides, and for a particle.
COORDINATE, POINT, PARTICLE = 8, 16, 95
#: Released buffers that a device keeps for the next: for a particle, for a pixel, at most.
HELD_PARTICLE, HELD_PIXEL, MOST_HELD = 40, 5000, 1 << 28

#: Entries of a block of the NumPy backend, and how many such blocks of 8 bytes it holds at a
#: time; bytes that it takes to move a particle.
BLOCK, BLOCKS, NUMPY_PARTICLE = 1 << 24, 4, 280


class Memory(NamedTuple):
    """Memory that a morph takes at its peak, estimated.

    Attributes
    ----------
    host : int
        Bytes of arrays, without Python and its libraries (about 150 MB).
    device : int
        Bytes of buffers.
    shared : bool
        Whether the device's memory is the host's, as it is with CPUs.
    """

    host: int
    device: int
    shared: bool

    @property
    def ram(self) -> int:
        """Bytes of the host's memory, the device's included if that is the same."""
        return self.host + self.device if self.shared else self.host


def estimate(
    source_shape: tuple[int, int],
    target_shape: tuple[int, int],
    pairs: float | None = None,
    *,
    sample: int | None = None,
    barycentric: bool = False,
    alpha: bool = False,
    dimension: int = 5,
    backend: Backend = "auto",
) -> Memory:
    """Estimate the memory that a morph takes, without doing any of it.

    A model of what is held at the peak, O(points + kept pairs), with constants measured on CPU
    runtimes for images from 64 x 64 on; within a factor of two there. Frames are drawn one by
    one: those that are kept come on top. So do, while potentials are sought at blurs of a few
    pixels, the pairs that the solver stores (`_solver.coarse_grid`): up to 128 for each point,
    or 2^24 of few points, 18 bytes each, but never more than a quarter of the device's memory.

    Parameters
    ----------
    source_shape, target_shape : (height, width)
    pairs : float, optional
        Kept pairs of the plan, counted or predicted (`predict_pairs`). None: of the transport
        alone, as if nothing came after the potentials.
    sample : int, optional
        Draws a pixel in place of kept pairs, see `clmorph.sample_plan`; `pairs` may then be None.
    barycentric : bool
        One particle for each source pixel in their place.
    alpha : bool
        Whether one of the images is not opaque.
    dimension : int
        Of the lifted points: 5, or 11 with a color metric for each source pixel.
    backend : str or Operations
        See `clmorph.get_backend`.

    Returns
    -------
    Memory

    Raises
    ------
    InputError
        If an argument cannot be used.
    DeviceError
        If there is no such device.
    """
    n, m = (_points(name, s) for name, s in (("source", source_shape), ("target", target_shape)))
    operations = get_backend(backend)
    drawn: float | None
    if barycentric:
        drawn = n
    elif sample is not None:
        drawn = _n_drawn(check_integer("sample", sample, 1, MAX_DRAWS), n, m)
    else:
        drawn = None if pairs is None else check_number("pairs", pairs, 0.0, 1e18)
    levels = min(LEVELS, (-(-n // TILE)) * (-(-m // TILE)))
    host = BASE + SOLVER_POINT * (n + m) + 24 * levels
    on_device = (COORDINATE * dimension + POINT) * (n + m)
    pixels = max(source_shape[0], target_shape[0]) * max(source_shape[1], target_shape[1])
    if drawn is not None:
        # Unmatched mass rests at points of its own.
        particles = drawn + n + m
        morph = BASE + MORPH_POINT * (n + m) + MORPH_PAIR * drawn + 24 * levels
        morph += MATTER_PAIR * drawn if alpha else 0
        morph += BARYCENTRIC_POINT * n if barycentric else 0
        host = max(host, int(morph))
        held = HELD_PARTICLE * particles + HELD_PIXEL * pixels
        # A second set of particles stays, the rest is used again.
        on_device += int(PARTICLE * particles * (1.2 if alpha else 1.0) + min(held, MOST_HELD))
    if operations.memory_bytes is not None:
        return Memory(host, on_device, operations.shares_host_memory)
    host += BLOCKS * 8 * min(BLOCK, n * m)
    return Memory(int(host + (NUMPY_PARTICLE * particles if drawn is not None else 0)), 0, True)


def affordable(
    max_memory: float,
    source_shape: tuple[int, int],
    target_shape: tuple[int, int],
    pairs: float,
    *,
    alpha: bool = False,
    dimension: int = 5,
    backend: Backend = "auto",
) -> dict[str, Any]:
    """Choose how a morph is made within some memory.

    Parameters
    ----------
    max_memory : float
        For host and device together where they share memory, else for each of them.
    source_shape, target_shape, pairs, alpha, dimension, backend
        As in `estimate`.

    Returns
    -------
    dict
        Options of `clmorph.morph`: none, if the kept pairs fit; ``{"sample": k}`` with as many
        draws as fit, a power of two; ``{"barycentric": True}`` rather than 2 or 1.

    Raises
    ------
    InputError
        If not even that fits.
    """
    limit = check_number("max_memory", max_memory, 1.0, 1e18)
    operations = get_backend(backend)

    def need(**way: Any) -> int:
        memory = estimate(
            source_shape, target_shape, alpha=alpha, dimension=dimension, backend=operations, **way
        )
        return max(memory.ram, memory.device)

    if need(pairs=pairs) <= limit:
        return {}
    n, m = _points("source", source_shape), _points("target", target_shape)
    draws = [k for k in 2 ** np.arange(13) if _n_drawn(int(k), n, m) < pairs]
    ways: list[dict[str, Any]] = [{"sample": int(k)} for k in draws[::-1]]
    # Fewer draws are grainier than means are smooth, but take less.
    ways.insert(sum(int(k) >= FEWEST_DRAWS for k in draws), {"barycentric": True})
    for way in ways:
        if need(**way) <= limit:
            return way
    least = min(need(**way) for way in ways)
    raise InputError(
        f"max_memory={limit / 1e9:.3g} GB: expected at least {least / 1e9:.2g} GB for images of "
        "these sizes; raise it, or use smaller images"
    )


def predict_pairs(
    source: MeasureLike,
    target: MeasureLike,
    potentials: Potentials,
    *,
    relative: float = PruningOptions.relative,
    log_threshold: float | None = None,
    rows: int = SAMPLED_ROWS,
    seed: int = 0,
    backend: Backend = "auto",
) -> int:
    """Predict how many pairs `clmorph.transport_plan` will keep, from a sample, in O(N + M).

    A pair is kept for its row or for its column. What rows keep follows from some rows, what
    columns keep from some columns, and what both keep from where these meet. With `log_threshold`
    some rows are enough. Exact if all rows and columns are in the sample.

    Parameters
    ----------
    source, target : Measure, WeightedPoints, or (weights, points)
    potentials : Potentials
    relative, log_threshold
        As in `clmorph.transport_plan`.
    rows : int
        So many random rows, and so many columns.
    seed : int
    backend : str or Operations
        See `clmorph.get_backend`.

    Returns
    -------
    int

    Raises
    ------
    InputError
        If an argument cannot be used.
    """
    source, target = as_pair(source, target)
    relative = check_number("relative", relative, 0.0, 1.0, open_low=True)
    if log_threshold is not None:
        log_threshold = check_log_threshold(log_threshold)
    rows = check_integer("rows", rows, 1, 1 << 24)
    rng = np.random.default_rng(check_integer("seed", seed, 0, 2**63))
    operations = get_backend(backend)
    sides = [
        _Side(operations, measure, potential, rows, rng)
        for measure, potential in ((source, potentials.f), (target, potentials.g))
    ]
    epsilon, precise = potentials.epsilon, potentials.precise
    if log_threshold is not None:
        source_side, target_side = sides
        kept = operations.count_plan_rows(
            source_side.part, target_side.cloud, source_side.few, target_side.potential, epsilon,
            np.full(len(source_side.few), log_threshold), np.full(target_side.size, np.inf),
            precise,
        )  # fmt: skip
        return round(source_side.scale * float(kept.sum()))
    none = [np.full(len(side.chosen), np.inf) for side in sides]
    thresholds = [
        operations.row_maxima(own.part, other.cloud, other.potential, epsilon)
        + own.few / epsilon
        + own.log_weights
        + np.log(relative)
        for own, other in (sides, sides[::-1])
    ]
    by_side = [
        own.scale
        * operations.count_plan_rows(
            own.part, other.cloud, own.few, other.potential, epsilon,
            threshold, np.full(other.size, np.inf), precise,
        ).sum()
        for own, other, threshold in zip(sides, sides[::-1], thresholds, strict=True)
    ]  # fmt: skip
    both = (thresholds[0], none[1]), (none[0], thresholds[1]), (thresholds[0], thresholds[1])
    few = sides[0].part, sides[1].part, sides[0].few, sides[1].few, epsilon
    in_rows, in_columns, either = (
        int(operations.count_plan_rows(*few, by_row, by_column, precise).sum())
        for by_row, by_column in both
    )
    only_columns = (either - in_rows) / in_columns if in_columns else 1.0
    return round(by_side[0] + by_side[1] * only_columns)


class _Side:
    """One measure on the device, and some of its points that have mass."""

    def __init__(
        self,
        operations: Operations,
        measure: AnyMeasure,
        potential: Array,
        count: int,
        rng: np.random.Generator,
    ) -> None:
        massive = np.flatnonzero(measure.weights > 0)
        self.chosen = np.sort(rng.choice(massive, min(count, len(massive)), replace=False))
        self.scale = len(massive) / len(self.chosen)
        self.size, self.potential, self.few = len(measure), potential, potential[self.chosen]
        self.cloud = operations.upload(measure.points, measure.weights, measure.offsets)
        some = part_of(measure, self.chosen)
        self.part = operations.upload(some.points, some.weights, some.offsets)
        self.log_weights = np.log(some.weights)


def part_of(measure: AnyMeasure, chosen: NDArray[np.intp]) -> WeightedPoints:
    """Return some points of a measure, with their own masses."""
    whole = WeightedPoints(measure.points, measure.weights, measure.offsets)
    return replace(
        whole,
        points=whole.points[chosen],
        weights=whole.weights[chosen],
        offsets=None if whole.offsets is None else whole.offsets[chosen],
    )


def _n_drawn(sample: int, n: int, m: int) -> int:
    """Return how many pairs are drawn between so many pixels."""
    by_row, by_column = n_draws(sample)
    return by_row * n + by_column * m


def _points(name: str, shape: tuple[int, int]) -> int:
    """Return the number of pixels of an image of this shape."""
    if len(shape) != 2:
        raise InputError(f"{name}_shape={shape!r}: expected (height, width)")
    height, width = (check_integer(f"{name}_shape", side, 1, 1 << 24) for side in shape)
    return height * width
