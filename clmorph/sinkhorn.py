"""Unbalanced log-domain Sinkhorn (paper, 2.1 and 3.1). Knows no device."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clmorph import defaults
from clmorph.backends import Backend, get_backend
from clmorph.checks import check_blur, check_integer, check_number, check_reach
from clmorph.errors import ConvergenceWarning, InputError
from clmorph.measures import Measure
from clmorph.operations import Operations

Array = NDArray[np.float64]

#: Called with the share of a stage that is done, from 0 to 1.
Progress = Callable[[float], None]

#: Factor between the blurs of the annealing that gives a starting point.
ANNEALING = 0.5
#: Relative difference of masses up to which balanced transport is feasible.
MASS_TOLERANCE = 1e-6


@dataclass(frozen=True, repr=False)
class Potentials:
    """Dual potentials of the raw (not debiased) entropic problem.

    Attributes
    ----------
    f, g : (N,) and (M,) arrays
        Cost units (image sides squared).
    blur : float
        epsilon = blur^2.
    reach : float or None
        rho = reach^2; None is balanced.
    converged : bool
        Whether the residual is at most the tolerance.
    n_iter : int
        Iterations, annealing included; one is both updates.
    residual : float
        max(|f - Delta T(g)|, |g - Delta T(f)|) / epsilon over points of positive mass,
        for these very potentials.
    message : str
        What happened, and what to do about it.
    """

    f: Array
    g: Array
    blur: float
    reach: float | None
    converged: bool
    n_iter: int
    residual: float
    message: str

    def __repr__(self) -> str:
        return f"<Potentials for {len(self.f)} and {len(self.g)} points, {self.message}>"

    @property
    def epsilon(self) -> float:
        """Entropic strength, in cost units."""
        return self.blur**2

    @property
    def rho(self) -> float:
        """Marginal strength, in cost units; infinite if balanced."""
        return np.inf if self.reach is None else self.reach**2


class _Problem:
    """Both half-steps at any epsilon."""

    def __init__(
        self, operations: Operations, source: Measure, target: Measure, rho: float
    ) -> None:
        self._operations = operations
        self._rows = operations.upload(source.points, source.weights)
        self._columns = operations.upload(target.points, target.weights)
        self._rho = rho
        with np.errstate(divide="ignore"):
            self._log_a, self._log_b = np.log(source.weights), np.log(target.weights)

    def damping(self, epsilon: float) -> float:
        """Delta = rho / (rho + epsilon): the proximal step of the KL penalty."""
        return 1.0 if np.isinf(self._rho) else self._rho / (self._rho + epsilon)

    def update_f(self, g: Array, epsilon: float) -> Array:
        """Delta T(g)."""
        softmin = self._operations.softmin(self._rows, self._columns, g, epsilon)
        return self.damping(epsilon) * softmin

    def update_g(self, f: Array, epsilon: float) -> Array:
        """Delta T(f)."""
        softmin = self._operations.softmin(self._columns, self._rows, f, epsilon)
        return self.damping(epsilon) * softmin

    def translate(self, f: Array, g: Array) -> tuple[Array, Array]:
        """Maximize the dual over (f + s, g - s) in closed form.

        Source: Séjourné, Vialard, Peyré, "Faster unbalanced optimal transport:
        translation invariant Sinkhorn and 1-D Frank-Wolfe" (2022).
        """
        if np.isinf(self._rho):
            return f, g
        excess = _log_sum_exp(self._log_a - f / self._rho)
        excess -= _log_sum_exp(self._log_b - g / self._rho)
        s = 0.5 * self._rho * excess
        return f + s, g - s

    def residuals(self, f: Array, g: Array, f_new: Array, g_new: Array | None) -> float:
        """Largest change over points of positive mass, in cost units."""
        change = float(np.max(np.abs(f_new - f)[self._log_a > -np.inf]))
        if g_new is not None:
            change = max(change, float(np.max(np.abs(g_new - g)[self._log_b > -np.inf])))
        return change


def sinkhorn(
    source: Measure,
    target: Measure,
    blur: float = defaults.BLUR,
    reach: float | None = defaults.REACH,
    tol: float = defaults.TOL,
    max_iter: int = defaults.MAX_ITER,
    backend: Backend = "auto",
    *,
    progress: Progress | None = None,
) -> Potentials:
    """Solve unbalanced entropic optimal transport between two measures.

    Minimizes <C, pi> + rho KL(pi 1 | a) + rho KL(pi^T 1 | b) + epsilon KL(pi | a x b) with
    C = |X - Y|^2 / 2, epsilon = blur^2, rho = reach^2, in the log domain.

    Parameters
    ----------
    source, target : Measure
        Of the same color weight and extent.
    blur : float
        Entropic length scale, in image sides.
    reach : float or None
        Length scale beyond which mass is rather created and destroyed, in image sides;
        None is balanced transport.
    tol : float
        Residual at which to stop, in units of epsilon.
    max_iter : int
        Iterations after which to stop all the same.
    backend : str or Operations
        See `clmorph.get_backend`.
    progress : callable, optional
        Called now and then with the share done.

    Returns
    -------
    Potentials

    Raises
    ------
    InputError
        If an argument cannot be used, or the masses differ and `reach` is None.

    Warns
    -----
    ConvergenceWarning
        If `max_iter` comes before `tol`.
    """
    blur, reach = check_blur(blur), check_reach(reach)
    tol = check_number("tol", tol, 0.0, 1e3, open_low=True)
    max_iter = check_integer("max_iter", max_iter, 1, 10**9)
    check_pair(source, target)
    if reach is None and abs(source.mass - target.mass) > MASS_TOLERANCE * source.mass:
        raise InputError(
            f"the masses {source.mass:g} and {target.mass:g} differ, so balanced transport is "
            "impossible: give a reach, or scale the weights to one mass"
        )
    epsilon = blur**2
    rho = np.inf if reach is None else reach**2
    operations = get_backend(backend)
    problem = _Problem(operations, source, target, rho)
    report = progress or (lambda share: None)

    f, g = np.zeros(len(source)), np.zeros(len(target))
    n_iter = 0
    for level in _annealing(source, target, blur)[:max_iter]:
        f, g = problem.translate(problem.update_f(g, level**2), g)
        f, g = problem.translate(f, problem.update_g(f, level**2))
        n_iter += 1

    first_residual = 0.0
    while True:
        f_new = problem.update_f(g, epsilon)
        residual = problem.residuals(f, g, f_new, None) / epsilon
        first_residual = first_residual or residual
        report(_share(first_residual, residual, tol))
        if residual <= tol or n_iter >= max_iter:
            # The cheap half is met, or there is no other turn: take the whole residual.
            g_new = problem.update_g(f, epsilon)
            residual = problem.residuals(f, g, f_new, g_new) / epsilon
            if residual <= tol or n_iter >= max_iter:
                break
        f, g = problem.translate(f_new, g)
        f, g = problem.translate(f, problem.update_g(f, epsilon))
        n_iter += 1
    report(1.0)
    joint = np.concatenate((source.points, target.points))
    largest_cost = 0.5 * float(np.sum((joint.max(axis=0) - joint.min(axis=0)) ** 2))
    noise = operations.unit_roundoff * largest_cost / epsilon
    return _finish(f, g, blur, reach, tol, n_iter, residual, noise)


def check_pair(source: Any, target: Any) -> None:
    """Require two measures that live in one space.

    Raises
    ------
    InputError
        If they do not.
    """
    for name, measure in (("source", source), ("target", target)):
        if not isinstance(measure, Measure):
            raise InputError(
                f"{name} is a {type(measure).__name__}: expected a Measure; "
                "make one with clmorph.lift(image)"
            )
    for name in ("color_weight", "extent"):
        ours, theirs = getattr(source, name), getattr(target, name)
        if ours != theirs:
            raise InputError(
                f"source has {name}={ours!r}, target {theirs!r}: lift both with the same"
            )


def _annealing(source: Measure, target: Measure, blur: float) -> list[float]:
    """Blurs from the diameter of the joint bounding box down to the wanted one."""
    joint = np.concatenate((source.points, target.points))
    level = float(np.linalg.norm(joint.max(axis=0) - joint.min(axis=0)))
    levels = []
    while level > blur:
        levels.append(level)
        level *= ANNEALING
    return [*levels, blur]


def _share(first: float, residual: float, tol: float) -> float:
    """Share done, as residuals fall geometrically."""
    if residual <= tol or first <= tol:
        return 1.0
    return float(np.clip(np.log(first / residual) / np.log(first / tol), 0.0, 1.0))


def _finish(
    f: Array,
    g: Array,
    blur: float,
    reach: float | None,
    tol: float,
    n_iter: int,
    residual: float,
    noise: float,
) -> Potentials:
    """Put the result together; `noise` is the residual that rounding alone can leave."""
    converged = residual <= tol
    if converged:
        message = f"converged in {n_iter} iterations (residual {residual:.1e} epsilon)"
    else:
        remedy = "raise max_iter, or use a larger blur or a smaller reach"
        if noise > tol:
            remedy = (
                f"single precision can leave {noise:.1e} here; use a larger blur, a smaller "
                "color weight, or the backend 'numpy'"
            )
        message = (
            f"not converged after {n_iter} iterations: residual {residual:.1e} epsilon, "
            f"wanted {tol:.1e}; {remedy}"
        )
        warnings.warn(message, ConvergenceWarning, stacklevel=3)
    return Potentials(f, g, blur, reach, converged, n_iter, residual, message)


def _log_sum_exp(values: Array) -> float:
    largest = values.max()
    return float(largest + np.log(np.sum(np.exp(values - largest))))
