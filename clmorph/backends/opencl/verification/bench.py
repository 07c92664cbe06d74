"""The table of checks, and the clouds and the backend that they compare."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from clmorph.backends.interface import Operations
from clmorph.backends.numpy import NumPyOperations
from clmorph.backends.opencl.build.constants import SLICED_FROM
from clmorph.backends.opencl.build.variants import KERNELS, Variant
from clmorph.backends.opencl.verification.findings import Finding, largest
from clmorph.backends.records import Float64, PlanTerms
from clmorph.backends.rounding import rounding_error

Cloud = tuple[Float64, Float64]
Findings = Iterator[Finding]
Run = Callable[["Bench", Variant], Findings]

#: The dimension of the points for the checks of files that are built for all dimensions.
DIMENSION = 5
#: Dimensions for the checks of programs that serve many, beside the least one: some slices of
#: coordinates and a part of one, and more than a run of slices (``cl_kernels/row_loop.cl``).
SLICES = 37, 150
#: The share of a row's sum that lists of near pairs may leave out, and what may come of it.
BUDGET = 1e-5
LEFT_OUT = 1.5 * BUDGET
#: The number of columns of long rows.
LONG_ROW = 20_011
#: Blurs at which a whole device is compared.
BLURS = 1.0, 0.05, 0.003


class Check(NamedTuple):
    """A row of the table: comparisons for the programs of a file."""

    file: str
    kernels: tuple[str, ...]  #: that it uses; with lists also those of near_field.cl
    run: Run


#: Every comparison of a device with NumPy, but for the whole morph.
TABLE: list[Check] = []


def check(file: str, *kernels: str) -> Callable[[Run], Run]:
    """Add a function to the table: of a file, and the kernels that it uses (default: all)."""

    def add(run: Run) -> Run:
        TABLE.append(Check(file, kernels or KERNELS[file], run))
        return run

    return add


@dataclass(frozen=True)
class Bench:
    """A backend, and its inputs: a few points, or clouds of two `pictures` for a whole device."""

    operations: Any
    pictures: tuple[Cloud, Cloud] | None = None
    exact: Operations = field(default_factory=NumPyOperations)

    @cached_property
    def lifted(self) -> list["Clouds"]:
        """The pictures' clouds at blurs from large to small."""
        if self.pictures is None:
            return []
        return [Clouds(*self.both, *self.pictures, blur**2, f", blur {blur:g}") for blur in BLURS]

    def clouds(
        self, dimension: int = 0, listed: bool = False, columns: int = LONG_ROW
    ) -> list["Clouds"]:
        """Return clouds of a few tiles, a few rows of over 2^16 rounds, and pictures."""
        dimension = dimension or DIMENSION
        columns = max(331, min(columns, columns * SLICED_FROM // dimension))
        sizes = [(dimension, 150, 331, ""), (dimension, 5, columns, ", long rows")]
        if dimension == SLICED_FROM:
            sizes[:1] = [(SLICES[0], 150, 331, ""), (SLICES[1], 70, 133, "")]
        own = [
            Clouds(*self.both, clustered(d, n, 2 * k + 1), clustered(d, m, 2 * k + 2),
                   0.004, f", {d}D{name}")
            for k, (d, n, m, name) in enumerate(sizes[:-1] if listed else sizes)
        ]  # fmt: skip
        return own + (self.lifted if dimension == DIMENSION else [])

    @property
    def both(self) -> tuple[Any, Operations]:
        """The backend, and NumPy's."""
        return self.operations, self.exact

    @contextmanager
    def forced(self, part: str, name: str, value: Any) -> Iterator[None]:
        """Overrule a device's choice of a method; other backends choose none."""
        own = getattr(self.operations, part, None)
        before = getattr(own, name, None)
        if own is not None:
            setattr(own, name, value)
        try:
            yield
        finally:
            if own is not None:
                setattr(own, name, before)


def clustered(dimension: int, count: int, seed: int) -> Cloud:
    """Return points in four clusters with masses of many sizes; a cluster and others have none."""
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


@dataclass(frozen=True)
class Clouds:
    """Two clouds on a backend and in NumPy, with potentials."""

    operations: Any
    #: NumPy's backend, with which `operations` are compared.
    exact: Operations
    rows: Cloud
    columns: Cloud
    epsilon: float
    #: Empty, or with a comma before it.
    name: str = ""

    @cached_property
    def ours(self) -> tuple[Any, Any]:
        """The clouds on the backend."""
        return self.operations.upload(*self.rows), self.operations.upload(*self.columns)

    @cached_property
    def theirs(self) -> tuple[Any, Any]:
        """The clouds in NumPy."""
        return self.exact.upload(*self.rows), self.exact.upload(*self.columns)

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of rows and of columns."""
        return len(self.rows[1]), len(self.columns[1])

    @cached_property
    def size(self) -> float:
        """The largest extent of both clouds together; 1 if all points are equal."""
        return float(np.ptp(np.concatenate((self.rows[0], self.columns[0])), axis=0).max()) or 1.0

    @cached_property
    def g(self) -> Float64:
        """Potential of the columns."""
        return self.epsilon * np.random.default_rng(0).normal(size=self.shape[1])

    @cached_property
    def softmin(self) -> Float64:
        """T(g) by NumPy: also the potential at which each row of the plan sums to its mass."""
        return self.exact.softmin(*self.theirs, self.g, self.epsilon)

    @cached_property
    def log_plan(self) -> Float64:
        """Logarithms of pi_ij by NumPy, (N, M); -inf where there is no mass."""
        with np.errstate(divide="ignore"):
            return np.log(self._plan(self.theirs[0]))

    @cached_property
    def shares(self) -> Float64:
        """The share that each column has of a row by NumPy, (N, M), also in rows without mass."""
        return self._plan(self.exact.upload(self.rows[0], np.ones(self.shape[0])))

    def _plan(self, rows: Any) -> Float64:
        n, m = self.shape
        limits = np.full(n, -np.inf), np.full(m, np.inf)
        plan = self.exact.plan_rows(
            PlanTerms(rows, self.theirs[1], self.softmin, self.g, self.epsilon, *limits)
        )
        dense = np.zeros((n, m))
        dense[np.repeat(np.arange(n), np.diff(plan.indptr)), plan.indices] = plan.mass
        return dense

    @cached_property
    def moments(self) -> tuple[Float64, Float64]:
        """Mean and covariance of each row's destinations, by NumPy."""
        return self.exact.plan_moments(*self.theirs, self.g, self.softmin, self.epsilon)

    @cached_property
    def near(self) -> Any:
        """Near pairs of the rows, by the backend."""
        return self.operations.near_pairs(*self.ours, self.g, self.softmin, self.epsilon, BUDGET)

    @cached_property
    def mean(self) -> Float64:
        """Mean of each row's destinations, by NumPy."""
        return self.exact.barycentric_projection(*self.theirs, self.g, self.epsilon)[1]

    def tolerance(self, precise: bool = False) -> float:
        """Return the tolerated error of a log-sum-exp, in nats."""
        return log_sum_exp_tolerance(
            self.operations, self.rows, self.columns, self.epsilon, precise
        )

    def off(self, softmin: Float64, near: Any = None) -> float:
        """Return the largest error of soft minima, in nats, beyond what near pairs leave out."""
        missing = (softmin - self.softmin) / self.epsilon
        if near is None:
            return largest(missing)
        return largest(np.maximum(0.0, np.maximum(missing - near.skipped, -missing)))

    def finding(
        self, operation: str, error: float, tolerance: float, unit: str = "nats", *,
        precise: bool = False, listed: bool = False, detail: str = "",
    ) -> Finding:  # fmt: skip
        """Return a finding whose name tells the operation and the clouds."""
        name = f"{'precise ' * precise}{operation}{' over near pairs' * listed}{self.name}{detail}"
        return Finding(name, error, tolerance, unit)


def log_sum_exp_tolerance(
    operations: Operations, rows: Cloud, columns: Cloud, epsilon: float, precise: bool = False
) -> float:
    """Return the tolerated error, in nats, of a log-sum-exp of `operations`."""
    points = np.concatenate((rows[0], columns[0]))
    highest = 0.5 * float(np.sum(np.ptp(points, axis=0) ** 2))
    return rounding_error(operations, len(columns[1]), highest / epsilon, precise)
