"""The sparse transport plan (paper, Eq. 2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.notebook import table
from clmorph._shared.printable import size_text
from clmorph._shared.typing import AnyArray, Array, IntArray
from clmorph._shared.validation import check_number, shown
from clmorph.backends.arrays import as_floats, pyopencl_needed
from clmorph.errors import InputError

if TYPE_CHECKING:
    from scipy.sparse import csr_array


#: Bytes of a kept pair: 4 for its column and 8 for its mass.
BYTES_PER_PAIR = 12
#: The default limit of a dense plan, in bytes.
MAX_DENSE = 2.0**30


class DevicePlan(NamedTuple):
    """Kept pairs of a plan in the memory of a device, as sparse rows, see `Plan.to_device`."""

    indptr: Any  #: (N + 1,) `pyopencl.array.Array` of int64, as `Plan.indptr`
    indices: Any  #: (kept,) `pyopencl.array.Array` of int32, as `Plan.indices`
    mass: Any  #: (kept,) `pyopencl.array.Array`, as `Plan.mass`


@dataclass(frozen=True, repr=False, eq=False)
class Plan:
    """Kept pairs of a transport plan (paper, Eq. 2), as sparse rows.

    Attributes
    ----------
    indptr : (N + 1,) array of int
        Index of the first pair of each source point.
    indices : (kept,) array of int
        Target point of each pair, ascending inside a row.
    mass : (kept,) array
        Mass pi_ij of each pair.
    shape : (N, M)
    whole_row_mass, whole_column_mass : (N,) and (M,) arrays
        Marginals of the whole plan: they include pairs that were dropped or not drawn.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> source = np.full(3, 1 / 3), np.array([0.0, 0.5, 1.0])
    >>> target = np.full(2, 1 / 2), np.array([0.25, 0.75])
    >>> potentials = clmorph.sinkhorn(source, target, blur=0.1, reach=0.3, backend="numpy")
    >>> plan = clmorph.transport_plan(source, target, potentials, backend="numpy")
    >>> plan.shape, len(plan), round(plan.total_mass, 3), plan.dropped_mass < 1e-6
    ((3, 2), 4, 0.828, True)
    >>> plan.rows.tolist(), plan.indices.tolist(), plan.mass.round(3).tolist()
    ([0, 1, 1, 2], [0, 0, 1, 1], [0.27, 0.144, 0.144, 0.27])
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

    def _repr_html_(self) -> str:
        """Show the masses in a notebook: a row for each source point, or for some neighbors."""
        return table(self.rows, self.indices, self.mass, self.shape, repr(self)[1:-1])

    def __len__(self) -> int:
        return len(self.mass)

    @property
    def nbytes(self) -> int:
        """Size of the pairs in bytes."""
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
        """(kept,) index of the source point of each pair."""
        return np.repeat(np.arange(self.shape[0]), np.diff(self.indptr))

    @cached_property
    def row_mass(self) -> Array:
        """(N,) mass of the kept pairs of each source point; `marginals` is that of the plan."""
        return np.asarray(np.bincount(self.rows, self.mass, self.shape[0]), float)

    @cached_property
    def column_mass(self) -> Array:
        """(M,) mass of the kept pairs of each target point; `marginals` is that of the plan."""
        return np.asarray(np.bincount(self.indices, self.mass, self.shape[1]), float)

    @property
    def dropped_mass(self) -> float:
        """Share of the plan's mass in the pairs that were not kept."""
        return float(_share_dropped(self.mass.sum(), self.total_mass))

    @property
    def dropped_row_mass(self) -> Array:
        """(N,) share of each row's mass in pairs that were not kept; 0 where no mass leaves.

        For a plan of random draws, it is the share by which the draws of a row are below the row's
        mass by chance.
        """
        return _share_dropped(self.row_mass, self.whole_row_mass)

    @property
    def worst_dropped_row_mass(self) -> float:
        """The largest value of `dropped_row_mass`."""
        return float(self.dropped_row_mass.max())

    def mean_destinations(self, source: Array, target: Array) -> tuple[Array, Array]:
        """Return mean destinations of the source points, and mean origins of the target points.

        Parameters
        ----------
        source, target : (N, D) and (M, D) arrays
            Coordinates of the points.

        Returns
        -------
        (N, D) and (M, D) arrays
            T(x_i) = sum_j pi_ij y_j / sum_j pi_ij (paper, 4), and the same backwards. A point that
            no mass leaves or reaches keeps its place.

        Raises
        ------
        InputError
            If the numbers of points are not those of the plan, or their dimensions differ.

        Examples
        --------
        >>> import numpy as np
        >>> import clmorph
        >>> source = np.full(3, 1 / 3), np.array([0.0, 0.5, 1.0])
        >>> target = np.full(2, 1 / 2), np.array([0.25, 0.75])
        >>> potentials = clmorph.sinkhorn(source, target, blur=0.1, reach=0.3, backend="numpy")
        >>> plan = clmorph.transport_plan(source, target, potentials, backend="numpy")
        >>> forth, back = plan.mean_destinations(source[1][:, None], target[1][:, None])
        >>> forth.round(3).tolist(), back.round(3).tolist()
        ([[0.25], [0.5], [0.75]], [[0.174], [0.826]])
        """
        source = as_floats("source", source, "an array (N, D) of points")
        target = as_floats("target", target, "an array (N, D) of points")
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

    def to_device(self, queue: Any, dtype: Any = None) -> DevicePlan:
        """Return the kept pairs as new arrays in the memory of a device.

        Parameters
        ----------
        queue : pyopencl.CommandQueue or Operations
            The queue of the arrays, or the backend whose queue it is.
        dtype : dtype, optional
            The dtype of the masses, float32 or float64; by default float64 where the device has it,
            and float32 elsewhere.

        Returns
        -------
        DevicePlan
            A named tuple of three `pyopencl.array.Array`: the pairs of source point i are those
            from ``indptr[i]`` to ``indptr[i + 1]``. Their ``events`` hold the end of the writing;
            work that is enqueued on `queue` is ordered after it, if the queue is in order.

        Raises
        ------
        InputError
            If `queue` or `dtype` cannot be used.
        DeviceError
            If the arrays cannot be made.

        Examples
        --------
        >>> import numpy as np
        >>> import clmorph
        >>> source = np.full(3, 1 / 3), np.array([0.0, 0.5, 1.0])
        >>> target = np.full(2, 1 / 2), np.array([0.25, 0.75])
        >>> potentials = clmorph.sinkhorn(source, target, blur=0.1, reach=0.3, backend="numpy")
        >>> plan = clmorph.transport_plan(source, target, potentials, backend="numpy")
        >>> try:
        ...     plan.to_device(clmorph.get_backend("numpy"))
        ... except clmorph.InputError:
        ...     print("NumPy has no queue")
        NumPy has no queue
        """
        with pyopencl_needed("queue"):
            from clmorph.backends.opencl.device_arrays import as_queue, real_type, to_device

        queue = as_queue(queue)
        return DevicePlan(
            to_device(queue, self.indptr, np.int64),
            to_device(queue, self.indices, np.int32),
            to_device(queue, self.mass, real_type(queue, dtype)),
        )

    def toarray(self, *, max_bytes: float = MAX_DENSE) -> Array:
        """Return the kept pairs as a dense (N, M) array; `numpy.asarray` of a plan is the same.

        Parameters
        ----------
        max_bytes : float
            The limit of its memory, in bytes.

        Raises
        ------
        InputError
            If the array would take more.

        Examples
        --------
        >>> import numpy as np
        >>> import clmorph
        >>> x, y = np.array([0.0, 0.5, 1.0]), np.array([0.25, 0.75])
        >>> potentials = clmorph.sinkhorn(x, y, blur=0.1, reach=0.3, backend="numpy")
        >>> clmorph.transport_plan(x, y, potentials, backend="numpy").toarray().round(3).tolist()
        [[0.27, 0.0], [0.144, 0.144], [0.0, 0.27]]
        """
        max_bytes = check_number("max_bytes", max_bytes, 1.0, 1e18)
        size = 8 * self.shape[0] * self.shape[1]
        if size > max_bytes:
            raise InputError(
                f"the dense plan of {self.shape[0]} x {self.shape[1]} points takes "
                f"{size_text(size)}: expected at most {size_text(max_bytes)}; use to_scipy(), "
                "or give toarray a larger max_bytes"
            )
        dense = np.zeros(self.shape)
        dense[self.rows, self.indices] = self.mass
        return dense

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> AnyArray:
        """Return the dense array of `toarray`, which is always a copy."""
        if copy is False:
            raise InputError("a dense plan is always a new array: expected copy=None or copy=True")
        return self.toarray().astype(dtype or float, copy=False)

    def to_scipy(self) -> csr_array[Any, tuple[int, int]]:
        """Return the plan as a `scipy.sparse.csr_array` of shape (N, M).

        Examples
        --------
        >>> import numpy as np
        >>> import clmorph
        >>> source = np.full(3, 1 / 3), np.array([0.0, 0.5, 1.0])
        >>> target = np.full(2, 1 / 2), np.array([0.25, 0.75])
        >>> potentials = clmorph.sinkhorn(source, target, blur=0.1, reach=0.3, backend="numpy")
        >>> plan = clmorph.transport_plan(source, target, potentials, backend="numpy")
        >>> plan.to_scipy().toarray().round(3).tolist()
        [[0.27, 0.0], [0.144, 0.144], [0.0, 0.27]]
        """
        from scipy.sparse import csr_array

        return csr_array((self.mass, self.indices, self.indptr), shape=self.shape)


def _share_dropped(kept: Any, whole: Any) -> Any:
    """Return 1 - kept / whole, within [0, 1]; 0 where the whole is 0."""
    whole = np.asarray(whole, float)
    share = np.divide(kept, whole, out=np.ones_like(whole), where=whole > 0)
    lost = np.clip(1.0 - share, 0.0, 1.0)
    return np.where(lost > 1e-12, lost, 0.0)  # smaller values are rounding of the sums


def check_plan(name: str, value: Any, sizes: tuple[int, int]) -> Plan:
    """Return a plan after checking that its measures have these sizes."""
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
    arrays = value.indptr, value.indices, value.mass, *value.marginals
    usable = all(
        type(array) is np.ndarray and array.dtype.kind == kind
        for array, kind in zip(arrays, "iifff", strict=True)
    )
    if usable:
        kept = len(value.mass)
        shapes = [array.shape for array in arrays]
        usable = shapes == [(n + 1,), (kept,), (kept,), (n,), (m,)]
        usable = usable and value.indptr[0] == 0 and value.indptr[-1] == kept
        usable = usable and bool(np.all(np.diff(value.indptr) >= 0))
        # Minima and maxima also detect NaN, without temporary arrays of the length of all pairs.
        usable = usable and not (kept and not 0 <= value.indices.min() <= value.indices.max() < m)
        for masses in (value.mass, *value.marginals):
            usable = usable and not (len(masses) and not 0 <= masses.min() <= masses.max() < np.inf)
    if not usable:
        raise InputError(
            f"{name}: its arrays do not belong together, or hold what they cannot; expected a Plan "
            "as clmorph.transport_plan returns it"
        )
    return value


def plan_of_pairs(
    pairs: tuple[AnyArray, AnyArray], mass: Array, shape: tuple[int, int],
    marginals: Sequence[Array], keep_zeros: bool = False,
) -> Plan:  # fmt: skip
    """Return the plan of pairs (rows, columns) in any order; masses of repeated ones add up."""
    from scipy.sparse import coo_array

    found = coo_array((mass, pairs), shape=shape).tocsr()
    found.sort_indices()
    if not keep_zeros:
        found.eliminate_zeros()
    return Plan(
        found.indptr.astype(np.int64), found.indices.astype(np.int32),
        np.asarray(found.data, float), shape, *marginals,
    )  # fmt: skip
