"""Predict the number of kept pairs of a plan before it is built."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clmorph.backends.interface import Operations
from clmorph.backends.records import PlanTerms
from clmorph.backends.select import Backend, get_backend
from clmorph.measures.points import AnyMeasure, MeasureLike, WeightedPoints, as_pair
from clmorph.transport._solver.plan_softmin import clouds_of
from clmorph.transport._solver.problem import uploaded
from clmorph.transport.options import PruningOptions
from clmorph.transport.potentials import Potentials

Array = NDArray[np.float64]

#: Number of rows, and of columns, from which the number of kept pairs is predicted.
SAMPLED_ROWS = 512


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
    source, target = as_pair(source, target)
    rng = np.random.default_rng(seed)
    operations = get_backend(backend)
    clouds = clouds_of(operations, (source, target), potentials)
    sides = [
        _Side(operations, cloud, measure, potential, rows, rng)
        for cloud, measure, potential in zip(
            clouds, (source, target), (potentials.f, potentials.g), strict=True
        )
    ]
    epsilon, precise = potentials.epsilon, potentials.precise
    if log_threshold is not None:
        source_side, target_side = sides
        plan = PlanTerms(
            source_side.part, target_side.cloud, source_side.few, target_side.potential, epsilon,
            np.full(len(source_side.few), log_threshold), np.full(target_side.size, np.inf),
        )  # fmt: skip
        kept = operations.count_plan_rows(plan, precise)
        return round(source_side.scale * float(kept.sum()))
    none = [np.full(len(side.chosen), np.inf) for side in sides]
    thresholds = [
        operations.row_maxima(own.part, other.cloud, other.potential, epsilon)
        + own.few / epsilon
        + own.log_weights
        + np.log(PruningOptions.relative)
        for own, other in (sides, sides[::-1])
    ]
    by_side = [
        own.scale
        * operations.count_plan_rows(
            PlanTerms(
                own.part, other.cloud, own.few, other.potential, epsilon, threshold,
                np.full(other.size, np.inf),
            ), precise,
        ).sum()
        for own, other, threshold in zip(sides, sides[::-1], thresholds, strict=True)
    ]  # fmt: skip
    both = (thresholds[0], none[1]), (none[0], thresholds[1]), (thresholds[0], thresholds[1])
    few = sides[0].part, sides[1].part, sides[0].few, sides[1].few, epsilon
    in_rows, in_columns, either = (
        int(operations.count_plan_rows(PlanTerms(*few, by_row, by_column), precise).sum())
        for by_row, by_column in both
    )
    only_columns = (either - in_rows) / in_columns if in_columns else 1.0
    return round(by_side[0] + by_side[1] * only_columns)


class _Side:
    """One measure on the device, and a sample of its points of positive mass."""

    def __init__(
        self,
        operations: Operations,
        cloud: Any,
        measure: AnyMeasure,
        potential: Array,
        count: int,
        rng: np.random.Generator,
    ) -> None:
        massive = np.flatnonzero(measure.weights > 0)
        self.chosen = np.sort(rng.choice(massive, min(count, len(massive)), replace=False))
        self.scale = len(massive) / len(self.chosen)
        self.size, self.potential, self.few = len(measure), potential, potential[self.chosen]
        self.cloud, some = cloud, part_of(measure, self.chosen)
        self.part = uploaded(operations, some)
        self.log_weights = np.log(some.weights)


def part_of(measure: AnyMeasure, chosen: NDArray[np.intp]) -> WeightedPoints:
    """Return the chosen points of a measure with their masses."""
    whole = WeightedPoints(measure.points, measure.weights, measure.offsets)
    return replace(
        whole,
        points=whole.points[chosen],
        weights=whole.weights[chosen],
        offsets=None if whole.offsets is None else whole.offsets[chosen],
    )
