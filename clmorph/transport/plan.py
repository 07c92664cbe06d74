"""The sparse transport plan (paper, Eq. 2)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.arrays import as_floats
from clmorph._shared.typing import Array, IntArray
from clmorph._shared.validation import check_choice, check_number, shown
from clmorph.backends.select import Backend, get_backend
from clmorph.errors import InputError, PlanSizeError
from clmorph.measures.points import MeasureLike, as_pair
from clmorph.transport._solver.problem import largest_cost
from clmorph.transport._solver.softmin import plan_softmin
from clmorph.transport.options import RELATIVE_TO, PruningOptions, RelativeTo
from clmorph.transport.potentials import Potentials, check_origin, check_potentials
from clmorph.transport.pruning import (
    check_log_threshold,
    no_pair_kept,
    only,
    strictly_above,
    undecided,
)

if TYPE_CHECKING:
    from scipy.sparse import csr_array


#: What a kept pair takes: its column (4 bytes) and its mass (8).
BYTES_PER_PAIR = 12


@dataclass(frozen=True, repr=False, eq=False)
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
    whole_row_mass, whole_column_mass : (N,) and (M,) arrays
        Marginals of the whole plan: pairs that were dropped, or that draws missed, included.
    """

    indptr: IntArray
    indices: NDArray[np.int32]
    mass: Array
    shape: tuple[int, int]
    whole_row_mass: Array
    whole_column_mass: Array

    def __repr__(self) -> str:
        return (
            f"<Plan {self.shape[0]} x {self.shape[1]}, {len(self)} pairs, "
            f"{self.nbytes / 1e6:.1f} MB, mass {self.total_mass:g}, "
            f"{100 * self.dropped_mass:.2g} % of it dropped>"
        )

    def __len__(self) -> int:
        return len(self.mass)

    @property
    def nbytes(self) -> int:
        """Bytes of the pairs."""
        return self.indptr.nbytes + self.indices.nbytes + self.mass.nbytes

    @property
    def total_mass(self) -> float:
        """Mass of the whole plan, dropped pairs included."""
        return float(self.whole_row_mass.sum())

    @property
    def marginals(self) -> tuple[Array, Array]:
        """(N,) and (M,) masses that leave and arrive in the whole plan, not in the kept pairs."""
        return self.whole_row_mass, self.whole_column_mass

    @cached_property
    def rows(self) -> IntArray:
        """(kept,) source point of each pair."""
        return np.repeat(np.arange(self.shape[0]), np.diff(self.indptr))

    @cached_property
    def row_mass(self) -> Array:
        """(N,) mass of the kept pairs of each source point; see `marginals` for the plan's."""
        return np.asarray(np.bincount(self.rows, self.mass, self.shape[0]), float)

    @cached_property
    def column_mass(self) -> Array:
        """(M,) mass of the kept pairs of each target point; see `marginals` for the plan's."""
        return np.asarray(np.bincount(self.indices, self.mass, self.shape[1]), float)

    @property
    def dropped_mass(self) -> float:
        """Share of the plan's mass in the pairs that were not kept."""
        return float(_share_dropped(self.mass.sum(), self.total_mass))

    @property
    def dropped_row_mass(self) -> Array:
        """(N,) the same for each row; 0 where nothing leaves.

        Of draws: the share by which those of a row fall short of its mass, by chance.
        """
        return _share_dropped(self.row_mass, self.whole_row_mass)

    @property
    def worst_dropped_row_mass(self) -> float:
        """The largest share of its mass that a row lost."""
        return float(self.dropped_row_mass.max())

    def mean_destinations(self, source: Array, target: Array) -> tuple[Array, Array]:
        """Return where each source point goes, and where each target point comes from, on average.

        Parameters
        ----------
        source, target : (N, D) and (M, D) arrays
            Where the points stand.

        Returns
        -------
        (N, D) and (M, D) arrays
            T(x_i) = sum_j pi_ij y_j / sum_j pi_ij, and likewise backwards; a point that no mass
            leaves or reaches stays.

        Raises
        ------
        InputError
            If they are not as many points as the plan's, of one dimension.
        """
        source, target = (
            as_floats(name, points, "an array (N, D) of points")
            for name, points in (("source", source), ("target", target))
        )
        sizes = source.shape[:1], target.shape[:1]
        if (
            not source.ndim == target.ndim == 2
            or sizes != ((self.shape[0],), (self.shape[1],))
            or source.shape[1] != target.shape[1]
            or not (np.all(np.isfinite(source)) and np.all(np.isfinite(target)))
        ):
            raise InputError(
                f"source has shape {source.shape}, target {target.shape}: expected finite points "
                f"({self.shape[0]}, D) and ({self.shape[1]}, D), those of the plan's measures"
            )
        means = []
        for groups, mass, own, ends in (
            (self.rows, self.row_mass, source, target[self.indices]),
            (self.indices, self.column_mass, target, source[self.rows]),
        ):
            sums = [np.bincount(groups, self.mass * axis, len(own)) for axis in ends.T]
            mean = own.copy()
            np.divide(np.column_stack(sums), mass[:, None], out=mean, where=mass[:, None] > 0)
            means.append(mean)
        return means[0], means[1]

    def to_scipy(self) -> csr_array[Any, tuple[int, int]]:
        """Return the plan as a `scipy.sparse.csr_array` of shape (N, M)."""
        from scipy.sparse import csr_array

        return csr_array((self.mass, self.indices, self.indptr), shape=self.shape)


def _share_dropped(kept: Any, whole: Any) -> Any:
    """Return 1 - kept / whole, within [0, 1], 0 where there is nothing."""
    whole = np.asarray(whole, float)
    share = np.divide(kept, whole, out=np.ones_like(whole), where=whole > 0)
    lost = np.clip(1.0 - share, 0.0, 1.0)
    return np.where(lost > 1e-12, lost, 0.0)  # a sum's rounding is no loss


def check_plan(name: str, value: Any, sizes: tuple[int, int]) -> Plan:
    """Return a plan between measures of so many points.

    Parameters
    ----------
    name : str
        What messages call it.
    value : Plan
    sizes : (N, M)

    Raises
    ------
    InputError
        If it is none, or of other sizes, or its parts do not belong together.
    """
    if not isinstance(value, Plan):
        raise InputError(
            f"{name}={shown(value)}: expected a Plan, as clmorph.transport_plan returns it"
        )
    if type(value.shape) is not tuple or value.shape != sizes:
        of = " and ".join(map(shown, value.shape)) if type(value.shape) is tuple else "?"
        raise InputError(
            f"{name} is for {of} points: expected {sizes[0]} and {sizes[1]}; build it for these "
            "measures"
        )
    n, m = sizes
    kinds = (
        (value.indptr, "i"),
        (value.indices, "i"),
        (value.mass, "f"),
        (value.whole_row_mass, "f"),
        (value.whole_column_mass, "f"),
    )
    usable = all(type(array) is np.ndarray and array.dtype.kind == kind for array, kind in kinds)
    if usable:
        kept = len(value.mass)
        shapes = [array.shape for array, _ in kinds]
        usable = shapes == [(n + 1,), (kept,), (kept,), (n,), (m,)]
        usable = usable and value.indptr[0] == 0 and value.indptr[-1] == kept
        usable = usable and bool(np.all(np.diff(value.indptr) >= 0))
        # NaN is within no range, and no array is made as long as all pairs.
        usable = usable and not (kept and not 0 <= value.indices.min() <= value.indices.max() < m)
        for masses in (value.mass, *value.marginals):
            usable = usable and not (len(masses) and not 0 <= masses.min() <= masses.max() < np.inf)
    if not usable:
        raise InputError(
            f"{name}: its arrays do not belong together, or hold what they cannot; expected a Plan "
            "as clmorph.transport_plan returns it"
        )
    return value


def transport_plan(
    source: MeasureLike,
    target: MeasureLike,
    potentials: Potentials,
    *,
    relative: float = PruningOptions.relative,
    relative_to: RelativeTo = "rows",
    log_threshold: float | None = None,
    max_bytes: float = PruningOptions.max_bytes,
    backend: Backend = "auto",
) -> Plan:
    """Build the plan of potentials, in streaming: never a dense one.

    log pi_ij = (f_i + g_j - C_ij) / epsilon + log a_i + log b_j (Eq. 2). Pairs are counted
    first and then written, each row at its own place. Where many pairs are to be sought, parts
    of the plan that provably hold none above its threshold are not looked at; where potentials
    come with a truncation, largest pairs are sought, and row masses summed, with that as well.

    By default frames of the kept pairs are, to about 0.01/255, those of all pairs: what is
    dropped could decide a pixel only where kernels hardly reach, and there wider ones fill it (see
    `clmorph.frames.render.render`; measured by ``tools/measure_pruning.py``).

    Parameters
    ----------
    source, target : Measure, WeightedPoints, or (weights, points)
        Those the potentials were computed for.
    potentials : Potentials
    relative : float
        A pair is kept when its mass exceeds this share of the largest one.
    relative_to : {"rows", "plan"}
        The largest of its row or of its column, so that faint points keep their pairs at any
        resolution; or the largest of the whole plan (the paper's code).
    log_threshold : float, optional
        Keep the pairs with log pi_ij above this instead (the paper's tau = -13; log pi_ij falls
        with 1 / N^2, so it drops everything between large images). Pairs within rounding of it
        are decided in float64, so that every device keeps the same ones.
    max_bytes : float
        The most that the pairs may take, 12 bytes each; checked before they are written.
    backend : str or Operations
        See `clmorph.get_backend`.

    Returns
    -------
    Plan

    Raises
    ------
    InputError
        If an argument cannot be used or no pair is kept.
    PlanSizeError
        If the pairs take more than `max_bytes`; it says how many there are.
    """
    source, target = as_pair(source, target)
    relative = check_number("relative", relative, 0.0, 1.0, open_low=True)
    check_choice("relative_to", relative_to, RELATIVE_TO)
    max_bytes = check_number("max_bytes", max_bytes, 1.0, 1e18)
    if log_threshold is not None:
        log_threshold = check_log_threshold(log_threshold)
    check_potentials("potentials", potentials, (len(source), len(target)))
    f, g, epsilon = potentials.f, potentials.g, potentials.epsilon
    operations = get_backend(backend)
    rows = operations.upload(source.points, source.weights, source.offsets)
    columns = operations.upload(target.points, target.weights, target.offsets)
    with np.errstate(divide="ignore"):
        log_a, log_b = np.log(source.weights), np.log(target.weights)
    with np.errstate(over="ignore"):
        to_rows = plan_softmin(operations, (rows, columns), (source, target), potentials)
        softmin = to_rows(g, epsilon, potentials.precise)
        whole = np.exp((f - softmin) / epsilon + log_a)
    largest = largest_cost(source.points, target.points)
    rounding = to_rows.rounding(len(g), largest, epsilon, potentials.precise)
    check_origin(potentials, whole, rounding)
    total = float(whole.sum())
    if not total <= 1e3 * max(source.mass, target.mass):
        raise InputError(
            f"the plan of these potentials has mass {total:.2g}: they are too far from a "
            f"solution (residual {potentials.residual:.1e} epsilon); raise max_iter, or use a "
            "larger blur or a smaller color_weight"
        )
    margin = 0.0
    if log_threshold is not None:
        margin = undecided(log_threshold, rounding)
        row_thresholds = np.full(len(f), log_threshold - margin)
        column_thresholds = np.full(len(g), np.inf)
    else:
        row_maxima = operations.row_maxima(rows, columns, g, epsilon, to_rows.near)
        row_maxima += f / epsilon + log_a
        row_thresholds = row_maxima + np.log(relative)
        if relative_to == "plan":
            row_thresholds[:] = row_thresholds.max()
            column_thresholds = np.full(len(g), np.inf)
        else:
            near = None
            if potentials.truncation is not None:
                to_columns = plan_softmin(
                    operations, (columns, rows), (target, source), potentials.swapped()
                )
                to_columns(f, epsilon)
                near = to_columns.near
            column_maxima = operations.row_maxima(columns, rows, f, epsilon, near)
            column_maxima += g / epsilon + log_b
            column_thresholds = column_maxima + np.log(relative)
    arguments = rows, columns, f, g, epsilon, row_thresholds, column_thresholds, potentials.precise
    counts = operations.count_plan_rows(*arguments)
    kept = int(counts.sum())
    if kept * BYTES_PER_PAIR > max_bytes:
        raise PlanSizeError(
            f"the plan would keep {kept} pairs ({kept * BYTES_PER_PAIR / 1e9:.3g} GB), more than "
            f"max_bytes={max_bytes:.3g}: raise max_bytes or relative, use smaller images or a "
            "smaller blur, draw from its rows (sample=8), or take their means (barycentric=True)",
            kept,
        )
    pairs = operations.plan_rows(*arguments, counts)
    if log_threshold is not None:
        pairs = strictly_above(pairs, source, target, potentials, log_threshold, margin)
        if not len(pairs.mass):
            row_maxima = operations.row_maxima(rows, columns, g, epsilon) + f / epsilon + log_a
            raise no_pair_kept(log_threshold, float(row_maxima.max()))
    # The mass of a pair can be smaller than any number, as all are at a tiny reach.
    shape = len(source), len(target)
    # The columns' marginal is the one that came with the potentials: another pass for it.
    return Plan(*only(pairs, pairs.mass > 0), shape, whole, potentials.column_mass)
