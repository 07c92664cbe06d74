"""The clouds and splats on which the operations of a backend are compared with NumPy."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clmorph.backends.interface import Operations
from clmorph.backends.records import Float32, Float64
from clmorph.backends.rounding import rounding_error

Cloud = tuple[NDArray[np.float64], NDArray[np.float64]]

#: The share of a row's sum that lists of near pairs may leave out.
BUDGET = 1e-5
#: The number of columns of long rows.
LONG_ROW = 20_011


def log_sum_exp_tolerance(
    operations: Operations, rows: Cloud, columns: Cloud, epsilon: float, precise: bool = False
) -> float:
    """Return the tolerated error, in nats, of a log-sum-exp of `operations`."""
    points = np.concatenate((rows[0], columns[0]))
    largest = 0.5 * float(np.sum(np.ptp(points, axis=0) ** 2))
    return rounding_error(operations, len(columns[1]), largest / epsilon, precise)


@dataclass(frozen=True)
class CloudCase:
    """Two clouds, on a backend and in NumPy (`exact`), with potentials."""

    operations: Operations
    exact: Operations
    rows: Cloud
    columns: Cloud
    epsilon: float
    #: Name of the case; empty, or with a comma before it.
    name: str = ""

    @cached_property
    def ours(self) -> tuple[Any, Any]:
        """The clouds on the backend."""
        return self.operations.upload(*self.rows), self.operations.upload(*self.columns)

    @cached_property
    def theirs(self) -> tuple[Any, Any]:
        """The clouds in NumPy."""
        return self.exact.upload(*self.rows), self.exact.upload(*self.columns)

    @cached_property
    def g(self) -> Float64:
        """Potential of the columns."""
        return self.epsilon * np.random.default_rng(0).normal(size=len(self.columns[1]))

    @cached_property
    def softmin(self) -> Float64:
        """T(g), by NumPy."""
        return self.exact.softmin(*self.theirs, self.g, self.epsilon)

    @cached_property
    def f(self) -> Float64:
        """Potential of the rows: the one at which each row of the plan sums to its mass."""
        return self.softmin

    @cached_property
    def log_plan(self) -> Float64:
        """Logarithms of pi_ij by NumPy, (N, M); -inf where there is no mass."""
        n, m = len(self.rows[1]), len(self.columns[1])
        plan = self.exact.plan_rows(
            *self.theirs, self.f, self.g, self.epsilon, np.full(n, -np.inf), np.full(m, np.inf)
        )
        log_plan = np.full((n, m), -np.inf)
        row = np.repeat(np.arange(n), np.diff(plan.indptr))
        with np.errstate(divide="ignore"):
            log_plan[row, plan.indices] = np.log(plan.mass)
        return log_plan

    @cached_property
    def moments(self) -> tuple[Float64, Float64]:
        """Mean and covariance of each row's destinations, by NumPy."""
        return self.exact.plan_moments(*self.theirs, self.g, self.softmin, self.epsilon)

    def tolerance(self, precise: bool = False) -> float:
        """Return the tolerated error of a log-sum-exp, in nats."""
        return log_sum_exp_tolerance(
            self.operations, self.rows, self.columns, self.epsilon, precise
        )

    @cached_property
    def near(self) -> Any:
        """Near pairs of the rows, by the backend."""
        return self.operations.near_pairs(*self.ours, self.g, self.softmin, self.epsilon, BUDGET)


def clustered(dimension: int, count: int, seed: int) -> Cloud:
    """Return points in four clusters, with masses of many sizes, and none in one of them.

    Some masses elsewhere are 0 too, so that whole tiles and single columns are without mass.
    """
    rng = np.random.default_rng((dimension, seed))
    # The same centers for all clouds of a dimension.
    centers = np.random.default_rng(dimension).random((4, dimension))
    cluster = np.arange(count) % 4
    points = centers[cluster] + 0.08 * rng.random((count, dimension))
    weights = 10.0 ** rng.uniform(-6, 0, count)
    weights[::7] = 0.0
    if count > 16:
        weights[cluster == 3] = 0.0
    weights[min(1, count - 1)] = 1.0
    return points, weights / weights.sum()


def several_tiles(operations: Operations, exact: Operations, dimension: int) -> CloudCase:
    """Return clouds of a few tiles each, which divide no number of points."""
    pair = clustered(dimension, 150, 1), clustered(dimension, 331, 2)
    return CloudCase(operations, exact, *pair, 0.004, f", {dimension}D")


def few_rows(
    operations: Operations, exact: Operations, dimension: int, columns: int = LONG_ROW
) -> CloudCase:
    """Return a few rows and many columns, in loops of more than 2^16 rounds for one row.

    Some drivers end longer loops early. Devices of many cores share the columns of few rows.
    """
    pair = clustered(dimension, 5, 3), clustered(dimension, columns, 4)
    return CloudCase(operations, exact, *pair, 0.004, f", {dimension}D, long rows")


@dataclass(frozen=True)
class SplatCase:
    """Splats at rest (`Operations.upload_splats`), on a backend and in NumPy (`exact`)."""

    operations: Operations
    exact: Operations
    positions: Float32
    colors: Float32
    weights: Float32
    spacings: Float32
    shape: tuple[int, int]

    @cached_property
    def ours(self) -> Any:
        """The splats on the backend."""
        return self._upload(self.operations)

    @cached_property
    def theirs(self) -> Any:
        """The splats in NumPy."""
        return self._upload(self.exact)

    def _upload(self, backend: Operations) -> Any:
        return backend.upload_splats(self.positions, self.colors, self.weights, self.spacings)


def splat_case(
    operations: Operations, exact: Operations, count: int, shape: tuple[int, int]
) -> SplatCase:
    """Return splats on a canvas and around it, a quarter of them within a few pixels."""
    rng = np.random.default_rng(1)
    height, width = shape
    positions = rng.uniform(-2, [width + 1, height + 1], (count, 2))
    crowd = count // 4
    positions[:crowd] = rng.uniform([width / 2, height / 2], [width / 2 + 3, height / 2 + 3],
                                    (crowd, 2))  # fmt: skip
    return SplatCase(
        operations,
        exact,
        positions.astype(np.float32),
        rng.random((count, 3)).astype(np.float32),
        (10 ** rng.uniform(-10, 0, count)).astype(np.float32),
        (2 ** rng.uniform(-3, 3, count)).astype(np.float32),
        shape,
    )
