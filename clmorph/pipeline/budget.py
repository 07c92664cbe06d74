"""Choose the particles of a morph (all kept pairs, draws or means) within a limit of memory."""

import math
import warnings
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.typing import Array
from clmorph.backends.interface import MAX_LIFTED, Operations
from clmorph.backends.records import PlanTerms
from clmorph.backends.select import Backend, get_backend
from clmorph.errors import InputError, MemoryWarning, PruningWarning
from clmorph.images.label_maps import label_text
from clmorph.measures.pixel_blocks import PixelBlocks
from clmorph.measures.points import AnyMeasure, MeasureLike, WeightedPoints, as_pair
from clmorph.pipeline.memory import Memory, estimate, most_particles
from clmorph.pipeline.options import MorphOptions
from clmorph.transport._solver.plan_softmin import RowsOfPlan
from clmorph.transport._solver.problem import uploaded
from clmorph.transport.barycentric import Barycentric, barycentric_plan
from clmorph.transport.options import MAX_DRAWS, PruningOptions
from clmorph.transport.plan import Plan
from clmorph.transport.plan_building import REMEDY, check_reachable, transport_plan
from clmorph.transport.plan_sampling import draw_pairs, n_draws, sample_plan
from clmorph.transport.potentials import Potentials
from clmorph.transport.refine_plan import drawn, refined
from clmorph.transport.subproblems import Subproblem, joined

#: Share of a device's memory that a morph may take, unless the user sets a limit.
MEMORY_SHARE = 0.5
#: Number of draws from a row below which the mean destination gives a better result.
FEWEST_DRAWS = 4
#: Share of a plan's mass; a warning is issued if a threshold drops more than this.
MUCH_DROPPED = 0.25
#: Number of rows, and of columns, from which the number of kept pairs is predicted.
SAMPLED_ROWS = 512


def default_memory(operations: Operations) -> float | None:
    """Return the bytes that a morph may take; None if the backend does not report its memory."""
    memory = operations.memory_bytes
    return None if memory is None else MEMORY_SHARE * float(memory)


def _memory_of(options: MorphOptions, operations: Operations) -> float | None:
    return default_memory(operations) if options.max_memory is None else options.max_memory


def make_plan(
    parts: Sequence[Subproblem],
    solved: Sequence[Potentials],
    operations: Operations,
    options: MorphOptions,
) -> Plan | Barycentric:
    """Return the plan between pixels as requested, or, with a warning, in a form that fits."""
    way: dict[str, Any] = {"sample": options.sample, "barycentric": options.barycentric}
    if options.sample is None and not options.barycentric:
        way = choose_way(parts, solved, operations, options, stacklevel=4)
    sample, log_threshold = way.get("sample"), options.log_threshold

    def made(part: Subproblem, potentials: Potentials) -> Plan | Barycentric:
        if way.get("barycentric"):
            means = barycentric_plan(*part.measures, potentials, backend=operations)
            return refined(part.means_of_blocks(means), *part.blocks)
        if sample is None:
            return pruned(part, potentials, operations, log_threshold)
        return _sampled(part, potentials, operations, sample, options.seed)

    whole = joined(
        parts, [made(part, potentials) for part, potentials in zip(parts, solved, strict=True)]
    )
    if isinstance(whole, Plan) and sample is None and log_threshold is not None:
        warn_if_much_is_dropped(whole, log_threshold, stacklevel=4)
    return whole


def pruned(
    part: Subproblem, potentials: Potentials, operations: Operations, log_threshold: float | None
) -> Plan:
    """Return all pairs of pixels of a part that are not too small."""
    try:
        plan = transport_plan(
            *part.measures, potentials, log_threshold=log_threshold, backend=operations
        )
    except InputError as error:
        if part.label is None:
            raise
        raise InputError(f"label {label_text(part.label)}: {error}") from None
    made = refined(part.between_blocks(plan), *part.blocks)
    assert isinstance(made, Plan)
    return made


def _sampled(
    part: Subproblem, potentials: Potentials, operations: Operations, sample: int, seed: int
) -> Plan:
    """Return pairs of pixels that are drawn from a part."""
    finest = finest_pixels(*part.blocks)
    if finest == 1:
        drawn_pairs = sample_plan(*part.measures, potentials, sample, seed=seed, backend=operations)
        return part.between_blocks(drawn_pairs)
    # Each pixel of a block has draws of its own.
    by_row, by_column = (count * finest for count in n_draws(sample))
    draws = draw_pairs(
        *part.measures, potentials, (by_row, by_column), seed=seed, backend=operations
    )
    return drawn(draws, *part.blocks, part.points)


def warn_if_much_is_dropped(plan: Plan, log_threshold: float, stacklevel: int = 2) -> None:
    """Warn if the threshold of a plan was too high for the number of points."""
    if plan.dropped_mass > MUCH_DROPPED:
        warnings.warn(
            f"log_threshold={log_threshold:g} drops {100 * plan.dropped_mass:.0f} % of the plan's "
            f"mass between {plan.shape[0]} and {plan.shape[1]} points; {REMEDY}",
            PruningWarning,
            stacklevel=stacklevel + 1,
        )


def finest_pixels(source: PixelBlocks, target: PixelBlocks) -> int:
    """Return the number of pixels in the larger of both images' blocks."""
    return int(max(source.side, target.side) ** 2)


def check_ways(
    source: PixelBlocks, target: PixelBlocks, operations: Operations, options: MorphOptions
) -> None:
    """Check before the solve that particles can be made in the requested form and memory."""
    if options.log_threshold is not None:
        check_reachable(options.log_threshold, *as_pair(source.coarse, target.coarse))
    finest, sample = finest_pixels(source, target), options.sample
    if sample is not None and sample * finest > MAX_DRAWS:
        raise InputError(
            f"sample={sample}: expected at most {MAX_DRAWS // finest} with blocks of {finest} "
            "pixels; lower it, or raise solve_size"
        )
    limit = _memory_of(options, operations)
    asked = sample is not None or options.barycentric
    if limit is None or (asked and options.max_memory is None):
        return
    n, m = len(source.fine), len(target.fine)
    fewest = n if sample is None else int(np.dot(n_draws(sample), (n, m)))
    least = max(_need(source, target, fewest, operations).needs)
    if least > limit:
        raise InputError(
            f"max_memory={limit / 1e9:.3g} GB: expected at least {least / 1e9:.2g} GB for these "
            "images; raise it, or use smaller images"
        )


def _need(
    source: PixelBlocks, target: PixelBlocks, particles: float, operations: Operations
) -> Memory:
    """Return the memory of a morph of this number of particles, drawn as takes the most."""
    n, m, features = len(source.fine), len(target.fine), source.fine.features
    dimension = 5 if features is None else 5 + features.shape[1]
    dimension = MAX_LIFTED if source.fine.has_metric_map else dimension
    return estimate(
        n + m, (len(source.coarse), len(target.coarse)), particles, operations,
        alpha=_has_opacity(source, target), dimension=dimension, frame=max(n, m),
    )  # fmt: skip


def _has_opacity(source: PixelBlocks, target: PixelBlocks) -> bool:
    return any(blocks.fine.alpha is not None for blocks in (source, target))


def choose_way(
    parts: Sequence[Subproblem],
    solved: Sequence[Potentials],
    operations: Operations,
    options: MorphOptions,
    stacklevel: int = 2,
) -> dict[str, Any]:
    """Return `sample` or `barycentric` within both limits; {} if all pairs may be kept."""
    source, target = parts[0].blocks
    finest, limit = finest_pixels(source, target), _memory_of(options, operations)
    fitting = math.inf
    if limit is not None:
        none = _need(source, target, 0, operations)
        fitting = most_particles(limit, none, _has_opacity(source, target))
    wanted = math.inf if options.max_particles is None else options.max_particles
    if finest * sum(part.pairs for part in parts) <= min(wanted, fitting):
        return {}  # even the dense plan fits
    pairs = finest * sum(
        predict_pairs(*part.measures, each, log_threshold=options.log_threshold, backend=operations)
        for part, each in zip(parts, solved, strict=True)
    )
    points = [len(blocks.coarse) * finest for blocks in (source, target)]
    # One draw of each target pixel is included in the number.
    way: dict[str, Any] = {}
    particles = pairs
    if pairs > wanted:
        way = _drawn(int(max(1, (wanted - points[1]) // points[0] + 1)), finest)
        particles = int(np.dot(n_draws(way.get("sample", 1)), points))
    if particles <= fitting:
        return way
    draws = (fitting - points[1]) // points[0] + 1
    # Fewer draws look worse, by their grain, than means, by their smoothness.
    way = _drawn(int(draws), finest) if draws >= FEWEST_DRAWS else {"barycentric": True}
    chosen = f"sample={way['sample']}" if "sample" in way else "barycentric=True"
    assert limit is not None
    warnings.warn(
        f"{particles:.2g} particles, of the plan's {pairs:.2g} pairs, would not fit into "
        f"max_memory={limit / 1e9:.3g} GB: {chosen} is taken in their place",
        MemoryWarning,
        stacklevel=stacklevel + 1,
    )
    return way


def _drawn(draws: int, finest: int) -> dict[str, Any]:
    """Return options for this many draws a pixel, or for means if blocks are too large."""
    most = MAX_DRAWS // finest
    return {"sample": min(most, draws)} if most else {"barycentric": True}


def predict_pairs(
    source: MeasureLike,
    target: MeasureLike,
    potentials: Potentials,
    *,
    log_threshold: float | None = None,
    rows: int = SAMPLED_ROWS,
    seed: int = 0,
    backend: Backend = "auto",
) -> int:
    """Predict how many pairs `clmorph.transport_plan` keeps, from sampled rows and columns."""
    pair, rng = as_pair(source, target), np.random.default_rng(seed)
    operations = get_backend(backend)
    epsilon, precise = potentials.epsilon, potentials.precise
    sides = []
    clouds = RowsOfPlan(operations, pair, potentials).clouds
    for cloud, measure, potential in zip(clouds, pair, (potentials.f, potentials.g), strict=True):
        chosen, some, scale = sampled_part(measure, rows, rng)
        part, log_weights = uploaded(operations, some), np.log(some.weights)
        sides.append(_Side(cloud, potential, part, potential[chosen], log_weights, scale))

    def kept(own: _Side, other: _Side, by_row: Array | float) -> int:
        """Return the pairs of sampled points of one side that are above their thresholds."""
        lowest, none = np.full(len(own.few), by_row), np.full(len(other.potential), np.inf)
        plan = PlanTerms(own.part, other.cloud, own.few, other.potential, epsilon, lowest, none)
        return int(operations.count_plan_rows(plan, precise).sum())

    if log_threshold is not None:
        return round(sides[0].scale * kept(sides[0], sides[1], log_threshold))
    thresholds = [
        operations.row_maxima(own.part, other.cloud, other.potential, epsilon)
        + own.few / epsilon
        + own.log_weights
        + np.log(PruningOptions.relative)
        for own, other in (sides, sides[::-1])
    ]
    by_side = [
        own.scale * kept(own, other, threshold)
        for own, other, threshold in zip(sides, sides[::-1], thresholds, strict=True)
    ]
    none = [np.full(len(side.few), np.inf) for side in sides]
    both = (thresholds[0], none[1]), (none[0], thresholds[1]), (thresholds[0], thresholds[1])
    few = sides[0].part, sides[1].part, sides[0].few, sides[1].few, epsilon
    in_rows, in_columns, either = (
        int(operations.count_plan_rows(PlanTerms(*few, by_row, by_column), precise).sum())
        for by_row, by_column in both
    )
    only_columns = (either - in_rows) / in_columns if in_columns else 1.0
    return round(by_side[0] + by_side[1] * only_columns)


class _Side(NamedTuple):
    """One measure on the device with its potentials, and a sample of its points."""

    cloud: Any
    potential: Array
    part: Any
    few: Array
    log_weights: Array
    #: Points of positive mass for each of the sample.
    scale: float


def sampled_part(
    measure: AnyMeasure, count: int, rng: np.random.Generator
) -> tuple[NDArray[np.intp], WeightedPoints, float]:
    """Return points of positive mass by their numbers and as a measure, and the share's inverse."""
    massive = np.flatnonzero(measure.weights > 0)
    chosen = np.sort(rng.choice(massive, min(count, len(massive)), replace=False))
    offsets = measure.offsets
    some = WeightedPoints(
        measure.points[chosen],
        measure.weights[chosen],
        None if offsets is None else offsets[chosen],
    )
    return chosen, some, len(massive) / len(chosen)
