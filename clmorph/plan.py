"""The sparse transport plan (paper, Eq. 2)."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clmorph import defaults
from clmorph.backends import Backend, get_backend
from clmorph.checks import check_number
from clmorph.errors import InputError
from clmorph.operations import PlanRows
from clmorph.points import MeasureLike, as_pair
from clmorph.potentials import Potentials

if TYPE_CHECKING:
    from scipy.sparse import csr_array


@dataclass(frozen=True, repr=False)
class Plan:
    """Kept pairs of a transport plan, as sparse rows.

    Attributes
    ----------
    indptr : (N + 1,) array of int
        Where each source point's pairs begin.
    indices : (kept,) array of int
        Target point of each pair, ascending inside a row.
    mass : (kept,) array
        Mass pi_ij of each pair.
    shape : (N, M)
    total_mass : float
        Mass of the whole plan, dropped pairs included.
    """

    indptr: NDArray[np.int64]
    indices: NDArray[np.int32]
    mass: NDArray[np.float64]
    shape: tuple[int, int]
    total_mass: float

    def __repr__(self) -> str:
        return (
            f"<Plan {self.shape[0]} x {self.shape[1]}, {len(self)} pairs, mass {self.total_mass:g}>"
        )

    def __len__(self) -> int:
        return len(self.mass)

    @cached_property
    def rows(self) -> NDArray[np.int64]:
        """(kept,) source point of each pair."""
        return np.repeat(np.arange(self.shape[0]), np.diff(self.indptr))

    @cached_property
    def row_mass(self) -> NDArray[np.float64]:
        """(N,) kept mass that leaves each source point: the first marginal."""
        return np.asarray(np.bincount(self.rows, self.mass, self.shape[0]), float)

    @cached_property
    def column_mass(self) -> NDArray[np.float64]:
        """(M,) kept mass that arrives at each target point: the second marginal."""
        return np.asarray(np.bincount(self.indices, self.mass, self.shape[1]), float)

    @property
    def dropped_mass(self) -> float:
        """Share of the plan's mass in the pairs that were not kept."""
        if self.total_mass == 0:
            return 0.0
        return max(0.0, 1.0 - float(self.mass.sum()) / self.total_mass)

    def to_scipy(self) -> "csr_array[Any, tuple[int, int]]":
        """Return the plan as a `scipy.sparse.csr_array` of shape (N, M)."""
        from scipy.sparse import csr_array

        return csr_array((self.mass, self.indices, self.indptr), shape=self.shape)


def transport_plan(
    source: MeasureLike,
    target: MeasureLike,
    potentials: Potentials,
    *,
    relative: float = defaults.PLAN_RELATIVE,
    log_threshold: float | None = None,
    backend: Backend = "auto",
) -> Plan:
    """Build the plan of potentials, in streaming: never a dense one.

    log pi_ij = (f_i + g_j - C_ij) / epsilon + log a_i + log b_j (Eq. 2).

    Parameters
    ----------
    source, target : Measure, WeightedPoints, or (weights, points)
        Those the potentials were computed for.
    potentials : Potentials
    relative : float
        A pair is kept when its mass exceeds this share of its row's or its column's
        largest one, so that faint points keep their pairs at any resolution.
    log_threshold : float, optional
        Keep the pairs with log pi_ij above this instead (the paper's tau = -13, which
        scales with 1 / N^2 and drops everything for large images).
    backend : str or Operations
        See `clmorph.get_backend`.

    Returns
    -------
    Plan

    Raises
    ------
    InputError
        If an argument cannot be used, or no pair is kept.
    """
    source, target = as_pair(source, target)
    relative = check_number("relative", relative, 0.0, 1.0, open_low=True)
    f, g, epsilon = potentials.f, potentials.g, potentials.epsilon
    if (len(f), len(g)) != (len(source), len(target)):
        raise InputError(
            f"potentials are for {len(f)} and {len(g)} points: expected {len(source)} and "
            f"{len(target)}; compute them for these measures"
        )
    operations = get_backend(backend)
    rows = operations.upload(source.points, source.weights)
    columns = operations.upload(target.points, target.weights)
    with np.errstate(divide="ignore"):
        log_a, log_b = np.log(source.weights), np.log(target.weights)
    if log_threshold is None:
        log_share = np.log(relative)
        row_maxima = operations.row_maxima(rows, columns, g, epsilon) + f / epsilon + log_a
        column_maxima = operations.row_maxima(columns, rows, f, epsilon) + g / epsilon + log_b
        row_thresholds, column_thresholds = row_maxima + log_share, column_maxima + log_share
    else:
        tau = check_number("log_threshold", log_threshold, -1e4, 1e4)
        row_thresholds = np.full(len(source), tau)
        column_thresholds = np.full(len(target), np.inf)
    kept: PlanRows = operations.plan_rows(
        rows, columns, f, g, epsilon, row_thresholds, column_thresholds, potentials.precise
    )
    if log_threshold is not None and not len(kept.mass):
        raise InputError(
            f"log_threshold={log_threshold}: no pair of the plan exceeds it; lower it, or use "
            "the default relative threshold"
        )
    with np.errstate(over="ignore", divide="ignore"):
        softmin = operations.softmin(rows, columns, g, epsilon, potentials.precise)
        total = float(np.exp((f - softmin) / epsilon + log_a).sum())
    if not total <= 1e3 * max(source.mass, target.mass):
        raise InputError(
            f"the plan of these potentials has mass {total:.2g}: they are too far from a "
            f"solution (residual {potentials.residual:.1e} epsilon); raise max_iter, or use a "
            "larger blur or a smaller color_weight"
        )
    return _without_empty_pairs(kept, (len(source), len(target)), total)


def _without_empty_pairs(rows: PlanRows, shape: tuple[int, int], total: float) -> Plan:
    """Drop pairs whose mass is smaller than any number, as all are at a tiny reach."""
    massive = rows.mass > 0
    before = np.concatenate(([0], np.cumsum(massive, dtype=np.int64)))
    return Plan(before[rows.indptr], rows.indices[massive], rows.mass[massive], shape, total)
