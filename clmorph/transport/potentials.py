"""Dual potentials, which the transport solvers return."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from clmorph._shared.typing import Array, ArrayLike
from clmorph._shared.validation import as_float, check_flag, shown
from clmorph.backends.arrays import pyopencl_needed
from clmorph.backends.records import LastPasses
from clmorph.backends.select import Backend, get_backend
from clmorph.errors import InputError
from clmorph.measures.points import AnyMeasure, MeasureLike, are_equal, as_measure
from clmorph.transport.certificate import Certificate
from clmorph.transport.entropic_map import as_places, entropic_map
from clmorph.transport.options import LENGTH, Reach
from clmorph.transport.regularization import regularization

#: The ways in which a solve can end, with a description of each.
STATUSES = {
    "converged": "the residual is at most the tolerance",
    "max_iter": "the iterations ran out first",
    "precision": "the residual is at the device's rounding, above the tolerance",
    "schedule": "a fixed schedule ended, whatever the residual",
}


class DevicePotentials(NamedTuple):
    """Dual potentials in the memory of a device, see `Potentials.to_device`."""

    f: Any  #: (N,) `pyopencl.array.Array`, cost units
    g: Any  #: (M,) `pyopencl.array.Array`, cost units


@dataclass(frozen=True, repr=False, eq=False)
class Potentials:
    """Dual potentials of the raw (not debiased) entropic problem, with their certificate.

    Attributes
    ----------
    f, g : (N,) and (M,) arrays
        Potentials in cost units (the points' unit squared).
    blur : float
        Length scale in the points' unit; epsilon = blur^2.
    reach : float, None, or a pair of them
        Length scale in the points' unit; rho = reach^2, and None is balanced. It is a pair (source,
        target) if they differ.
    status : {"converged", "max_iter", "precision", "schedule"}
        See `STATUSES`.
    message : str
        One line that reports how the solve ended and, if it did not converge, a remedy.
    n_iter : int
        Number of iterations, those of the annealing included; one iteration updates both
        potentials. Iterations that were taken back count too.
    residual : float
        max(|f - Delta T(g)|, |g - Delta T(f)|) / epsilon over points of positive mass, for these
        potentials (math: residual). It is an upper bound, which includes rounding and truncation.
    residuals : (k,) array
        The residual after each iteration that was not taken back, in units of its own level's
        epsilon. While the blur is annealed, residuals start high at every level.
    certificate : Certificate
        Bounds and marginals that follow from these potentials.
    precise : bool
        Whether the last iterations needed more than float32 exponents.
    truncation : float or None
        Nats up to which pairs could be left out, see `clmorph.sinkhorn`; None if all pairs were
        summed.
    truncation_error : float
        Proven bound, in nats, of the error of the logarithms of `row_mass`, `column_mass` and
        `transported_mass` from pairs left out and from rounding. `residual`, `primal` and `dual`
        include it.
    visited : float
        Share of all pairs of points that the last softmins summed.
    measures : (source, target) or None
        The measures of the problem, for `map`. None if they are not kept: those of batches, of
        files, and of problems with labels or a map of color metrics.
    passes : LastPasses or None
        The near pairs of a large solve, so that a plan of these potentials on the same backend need
        not choose them again: see `clmorph.backends.records.LastPasses`. They are not pickled. At a
        megapixel they take some 300 MB, which `dataclasses.replace(potentials, passes=None)` frees.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> source = np.full(3, 1 / 3), np.array([0.0, 0.5, 1.0])
    >>> target = np.full(2, 1 / 2), np.array([0.25, 0.75])
    >>> potentials = clmorph.sinkhorn(source, target, blur=0.1, reach=0.3, backend="numpy")
    >>> potentials.f.shape, potentials.g.shape, potentials.status
    ((3,), (2,), 'converged')
    >>> potentials.row_mass.round(3).tolist()  # what leaves each source point
    [0.27, 0.289, 0.27]
    >>> repr(potentials).endswith("transported 0.828 of 1>")
    True
    """

    f: Array
    g: Array
    blur: float
    reach: Reach
    status: str
    message: str
    n_iter: int
    residual: float
    residuals: Array
    certificate: Certificate
    precise: bool = False
    truncation: float | None = None
    truncation_error: float = 0.0
    visited: float = 1.0
    measures: tuple[AnyMeasure, AnyMeasure] | None = None
    passes: LastPasses | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Return what is pickled: near pairs belong to a backend of this process."""
        return {**self.__dict__, "passes": None}

    def __repr__(self) -> str:
        source, target = (f"{mass:.4g}" for mass in self.certificate.masses)
        given = source if source == target else f"{source} (source) and {target} (target)"
        return (
            f"<Potentials for {len(self.f)} and {len(self.g)} points, {self.message}, "
            f"transported {self.transported_mass:.3g} of {given}>"
        )

    @property
    def converged(self) -> bool:
        """Whether the residual is at most the tolerance."""
        return self.status == "converged"

    @property
    def epsilon(self) -> float:
        """Entropic regularization epsilon = blur^2, in cost units."""
        return self.blur**2

    @cached_property
    def rho(self) -> Any:
        """Marginal penalty rho = reach^2, cost units; infinite if balanced, a pair like `reach`."""
        if isinstance(self.reach, tuple):
            return tuple(np.inf if reach is None else reach**2 for reach in self.reach)
        return np.inf if self.reach is None else self.reach**2

    def swapped(self) -> Potentials:
        """Return the potentials of the problem with source and target exchanged."""
        reach = self.reach[::-1] if isinstance(self.reach, tuple) else self.reach
        certificate = self.certificate._replace(
            row_mass=self.column_mass,
            column_mass=self.row_mass,
            masses=self.certificate.masses[::-1],
        )
        measures = None if self.measures is None else self.measures[::-1]
        passes = None if self.passes is None else self.passes.swapped()
        return replace(
            self, f=self.g, g=self.f, reach=reach, certificate=certificate, measures=measures,
            passes=passes,
        )  # fmt: skip

    def map(
        self,
        points: ArrayLike | AnyMeasure,
        *,
        target: MeasureLike | None = None,
        own: Potentials | None = None,
        backend: Backend = "auto",
    ) -> Array:
        """Send any points, also new ones, where the plan sends the source around them.

        This is the entropic map T(x) = sum_j w_j(x) y_j with weights w_j(x) proportional to
        b_j exp((g_j - C(x, y_j)) / epsilon) and of sum 1 (Pooladian and Niles-Weed 2021, section
        3). At a point of the source it is the mean destination, as `clmorph.barycentric_plan`
        returns it; between them it is smooth; far from the source it approaches the outermost
        points of the target. With an unbalanced `reach` it says where the mass goes that moves,
        and not how much of it there is.

        ``potentials.swapped().map(points)`` maps points of the target back to the source.

        Parameters
        ----------
        points : (K, D) array, Measure or WeightedPoints
            In the coordinates and the unit of the measures' points; for lifted images those of
            `Measure.points`: x, y, the weighted colors, the weighted features. (K,) will do in one
            dimension. K may be 0.
        target : Measure, WeightedPoints, or (weights, points), optional
            The target of the problem, for potentials whose `measures` is None.
        own : Potentials, optional
            Potentials of the source with itself, with the same blur and reach. The map is then
            the debiased one, x + T(x) - T_own(x): it does not contract to the middle of the target
            as T does, and is the identity between equal measures. It is the step along the gradient
            of the Sinkhorn divergence.
        backend : str, object of pyopencl, or Operations
            See `clmorph.get_backend`.

        Returns
        -------
        (K, D) array
            T is rounded relative to the size of the target, however far away the points are.

        Raises
        ------
        InputError
            If an argument cannot be used, the target is not known, or points are farther from it
            than about 10^9 epsilon / (size of the target), where devices fail and NumPy does not.

        Examples
        --------
        >>> import numpy as np
        >>> import clmorph
        >>> source = np.full(3, 1 / 3), np.array([0.0, 0.5, 1.0])
        >>> target = np.full(3, 1 / 3), np.array([2.0, 2.5, 3.0])
        >>> potentials = clmorph.sinkhorn(source, target, blur=0.1, tol=1e-6, backend="numpy")
        >>> potentials.map([0.0, 0.5, 0.75, 9.0], backend="numpy").round(3).ravel().tolist()
        [2.0, 2.5, 2.75, 3.0]
        >>> potentials.swapped().map([2.5], backend="numpy").round(3).tolist()
        [[0.5]]
        >>> own = clmorph.sinkhorn(source, source, blur=0.1, tol=1e-6, backend="numpy")
        >>> potentials.map([0.0, 0.6], own=own, backend="numpy").round(3).ravel().tolist()
        [2.0, 2.6]
        """
        known = self._measure(1, "target") if target is None else as_measure("target", target)
        check_potentials("potentials", self, (len(self.f), len(known)))
        places = as_places(points, known)
        operations = get_backend(backend)
        mapped = entropic_map(places, known, self.g, self.epsilon, operations, self.precise).means
        if own is None:
            return mapped
        n = len(self.f)
        check_potentials("own", own, (n, n))
        if own.blur != self.blur or own.reach != self.reach:
            raise InputError(
                f"own has blur={own.blur:g} and reach={shown(own.reach)}: expected those of the "
                f"potentials, {self.blur:g} and {shown(self.reach)}"
            )
        source = own._measure(1, "own")
        check_potentials("own", own, (n, len(source)))
        known = source if self.measures is None else self._measure(0, "potentials")
        if not (are_equal(own._measure(0, "own"), source) and are_equal(known, source)):
            raise InputError(
                "own: potentials are of other measures: expected clmorph.sinkhorn of the source "
                "with itself"
            )
        places = as_places(places, source)
        stay = entropic_map(places, source, own.g, own.epsilon, operations, own.precise).means
        return places + (mapped - stay)

    def _measure(self, side: int, name: str) -> AnyMeasure:
        """Return the source (0) or the target (1), which the argument `name` needs."""
        if not isinstance(self.measures, tuple) or len(self.measures) != 2:
            raise InputError(
                f"{name}: these potentials do not hold their measures; expected potentials as "
                "clmorph.sinkhorn returns them, or the measure as the argument target"
            )
        return as_measure(name, self.measures[side])

    def to_device(self, queue: Any, dtype: Any = None) -> DevicePotentials:
        """Return f and g as new arrays in the memory of a device, for kernels of a host program.

        Parameters
        ----------
        queue : pyopencl.CommandQueue or Operations
            The queue of the arrays, or the backend whose queue it is.
        dtype : dtype, optional
            float32 or float64; by default float64 where the device has it, and float32 elsewhere.

        Returns
        -------
        DevicePotentials
            A named tuple of two `pyopencl.array.Array`. Their ``events`` hold the end of the
            writing; work that is enqueued on `queue` is ordered after it, if the queue is in order.

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
        >>> try:
        ...     potentials.to_device(clmorph.get_backend("numpy"))
        ... except clmorph.InputError:
        ...     print("NumPy has no queue")
        NumPy has no queue
        """
        with pyopencl_needed("queue"):
            from clmorph.backends.opencl.device_arrays import as_queue, real_type, to_device

        queue = as_queue(queue)
        chosen = real_type(queue, dtype)
        return DevicePotentials(*(to_device(queue, each, chosen) for each in (self.f, self.g)))

    @property
    def primal(self) -> float:
        """An upper bound of the optimum, rounding included; see `clmorph.transport.certificate`.

        It is <C, pi> + rho KL(pi 1|a) + rho KL(pi^T 1|b) + epsilon KL(pi|a x b) of the plan. With
        one balanced side, the plan's rows or columns are first scaled to the given masses. If both
        sides are balanced, the bound follows from `marginal_error` and requires equal masses.
        """
        return self.certificate.primal

    @property
    def dual(self) -> float:
        """Dual value D(f, g) minus its rounding, a lower bound of the optimum."""
        return self.certificate.dual

    @property
    def gap(self) -> float:
        """Primal - dual, an upper bound of the distance of both values from the optimum."""
        return self.certificate.gap

    @property
    def marginal_error(self) -> float:
        """Upper bound of |pi 1 - a|_1, summed over the balanced sides; 0 without balanced sides."""
        return self.certificate.marginal_error

    @property
    def transported_mass(self) -> float:
        """Mass of the plan."""
        return self.certificate.transported_mass

    @property
    def row_mass(self) -> Array:
        """(N,) first marginal of the plan: mass that leaves each source point."""
        return self.certificate.row_mass

    @property
    def column_mass(self) -> Array:
        """(M,) second marginal of the plan: mass that arrives at each target point."""
        return self.certificate.column_mass


def check_potentials(name: str, value: Any, sizes: tuple[int, int]) -> Potentials:
    """Return potentials after checking that they are usable for measures of these sizes."""
    if not isinstance(value, Potentials):
        raise InputError(
            f"{name}={shown(value)}: expected Potentials, as clmorph.sinkhorn returns them"
        )
    expected = "expected Potentials as clmorph.sinkhorn returns them"
    arrays = value.f, value.g
    if not all(type(array) is np.ndarray and array.dtype == np.float64 for array in arrays):
        raise InputError(f"{name}: f and g are not float64 arrays; {expected}")
    shapes = value.f.shape, value.g.shape
    if shapes != ((sizes[0],), (sizes[1],)):
        points = " and ".join(str(shape[0] if len(shape) == 1 else shape) for shape in shapes)
        raise InputError(
            f"{name}: f and g are for {points} points; expected {sizes[0]} and {sizes[1]}: compute "
            "them for these measures"
        )
    if not (np.all(np.isfinite(value.f)) and np.all(np.isfinite(value.g))):
        raise InputError(f"{name}: f or g holds NaN or infinity; {expected}")
    LENGTH.check("blur", value.blur)
    lengths = value.reach if isinstance(value.reach, tuple) else (value.reach,)
    numbers = [value.residual, value.truncation_error, value.visited, value.n_iter]
    numbers += [each for each in (*lengths, value.truncation) if each is not None]
    floats = [as_float(each) for each in numbers]
    # The comparison number >= 0 also refuses NaN.
    usable = all(number is not None and number >= 0 for number in floats)
    usable = usable and isinstance(value.status, str) and isinstance(value.message, str)
    usable = usable and isinstance(value.residuals, np.ndarray) and value.residuals.dtype == float
    usable = usable and isinstance(value.passes, LastPasses | None)
    if not usable or np.isnan(value.residuals).any():
        raise InputError(f"{name}: parts of it are not what they should be; {expected}")
    regularization(value.blur, value.reach)
    check_flag(f"{name}: precise", value.precise)
    of = value.certificate
    if not isinstance(of, Certificate) or shapes != (
        np.shape(of.row_mass),
        np.shape(of.column_mass),
    ):
        raise InputError(f"{name}: the certificate is not of these potentials; {expected}")
    return value
