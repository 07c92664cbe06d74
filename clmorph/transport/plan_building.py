"""Build the sparse transport plan of potentials (paper, Eq. 2) without a dense matrix.

The paper keeps the pairs with log pi_ij > tau = -13. This threshold is absolute: between two images
of N pixels log pi_ij falls as log(1 / N^2), so a tau that drops little of small images drops all of
large ones. The default is therefore relative to the largest pair of a row or a column.
"""

from __future__ import annotations

import numpy as np

from clmorph._shared.typing import Array, BoolArray
from clmorph.backends.records import PlanRows, PlanTerms
from clmorph.backends.select import Backend, get_backend
from clmorph.errors import InputError, PlanSizeError
from clmorph.measures.points import AnyMeasure, MeasureLike, Pair, as_pair
from clmorph.transport._solver.plan_softmin import RowsOfPlan
from clmorph.transport.options import PlanOptions, PruningOptions, RelativeTo
from clmorph.transport.plan import BYTES_PER_PAIR, Plan
from clmorph.transport.potentials import Potentials

#: Pairs within this many rounding errors of the threshold are decided in float64.
ROUNDINGS = 4.0
#: Relative rounding of float32, in which devices store log pi_ij of a pair.
FLOAT32 = float(np.finfo(np.float32).eps)
#: The remedy for a threshold that keeps no pairs or too few, for error messages.
REMEDY = (
    "lower it, or keep pairs relative to the largest ones (None; in the command line "
    "'relative'); the paper's -13 is for images of about 48 pixels"
)


def check_reachable(log_threshold: float, source: AnyMeasure, target: AnyMeasure) -> None:
    """Check before the solve that a pair of the plan can exceed the threshold.

    At the optimum r_i = a_i e^(-f_i / rho_1) and c_j = b_j e^(-g_j / rho_2) are the plan's
    marginals, and pi_ij is at most each of them. If f_i + g_j <= 0, then pi_ij <= a_i b_j by Eq. 2,
    as costs are not negative. Otherwise pi_ij is at most the mean r_i^s c_j^(1 - s) with s = rho_1
    / (rho_1 + rho_2), which is a_i^s b_j^(1 - s) e^(-(f_i + g_j) / (rho_1 + rho_2)), and that is
    less than the larger of a_i and b_j.

    source, target: the measures between which the plan is built.
    """
    log_a, log_b = (float(_log(measure.weights).max()) for measure in (source, target))
    largest = max(log_a, log_b, log_a + log_b)
    if largest <= log_threshold:
        raise InputError(
            f"log_threshold={log_threshold:g}: no pair between {len(source)} and {len(target)} "
            f"points can exceed it, log pi is below {largest:.4g}; {REMEDY}"
        )


def no_pair_kept(log_threshold: float, largest: float) -> InputError:
    """Return the error which reports that a plan has no pair above the threshold."""
    return InputError(
        f"log_threshold={log_threshold:g}: no pair of the plan exceeds it, the largest log pi is "
        f"{largest:.4g}; {REMEDY}"
    )


def strictly_above(
    pairs: PlanRows, pair: Pair, potentials: Potentials, log_threshold: float, margin: float
) -> PlanRows:
    """Drop pairs not above the threshold in float64, so that a device's rounding has no effect.

    `pairs` are all above `log_threshold - margin`, in nats, as a device computed them; those this
    near to the threshold are computed again.
    """
    (source, target), log_mass = pair, _log(pairs.mass)
    keep = log_mass > log_threshold
    near = np.flatnonzero(np.abs(log_mass - log_threshold) <= margin)
    i = np.searchsorted(pairs.indptr, near, side="right") - 1
    j = pairs.indices[near]
    cost = 0.5 * np.sum((source.points[i] - target.points[j]) ** 2, axis=1)
    for measure, index in ((source, i), (target, j)):
        if measure.offsets is not None:
            cost += measure.offsets[index]
    log_plan = (potentials.f[i] + potentials.g[j] - cost) / potentials.epsilon
    log_plan += _log(source.weights[i]) + _log(target.weights[j])
    keep[near] = log_plan > log_threshold
    return only(pairs, keep)


def only(pairs: PlanRows, keep: BoolArray) -> PlanRows:
    """Return some of the pairs."""
    before = np.concatenate(([0], np.cumsum(keep, dtype=np.int64)))
    return PlanRows(before[pairs.indptr], pairs.indices[keep], pairs.mass[keep])


def _log(masses: Array) -> Array:
    with np.errstate(divide="ignore"):
        return np.log(masses)


def transport_plan(
    source: MeasureLike,
    target: MeasureLike,
    potentials: Potentials,
    *,
    relative: float = PruningOptions.relative,
    relative_to: RelativeTo = PruningOptions.relative_to,
    log_threshold: float | None = None,
    max_bytes: float = PruningOptions.max_bytes,
    backend: Backend = "auto",
) -> Plan:
    """Build the plan of potentials (paper, Eq. 2) as sparse rows, never as a dense matrix.

    log pi_ij = (f_i + g_j - C_ij) / epsilon + log a_i + log b_j. Pairs are counted first and then
    written, each row at its own place. Parts of a large plan that provably hold no pair above the
    threshold are skipped. If the potentials come with a truncation, row masses and largest pairs
    are computed with it too.

    A dropped pair could decide a pixel only where the kernels of all others are nearly zero, and
    wider kernels fill such pixels (see `clmorph.frames.render.render`).

    Parameters
    ----------
    source, target : Measure, WeightedPoints, or (weights, points)
        The measures for which the potentials were computed.
    potentials : Potentials
    relative : float
        A pair is kept if its mass exceeds this share of the largest one.
    relative_to : {"rows", "plan"}
        "rows" compares with the largest pair of the row or of the column, so that points of little
        mass keep their pairs at any resolution. "plan" compares with the largest pair of the whole
        plan, as the paper's code does.
    log_threshold : float, optional
        If given, the pairs with log pi_ij above this are kept instead (paper, 3.1: tau = -13).
        log pi_ij falls as log(1 / N^2), so such a threshold drops all pairs between large images.
        Pairs within rounding of it are decided in float64, so that every device keeps the same
        pairs.
    max_bytes : float
        Largest number of bytes of the pairs, 12 each; it is checked before they are written.
    backend : str, object of pyopencl, or Operations
        See `clmorph.get_backend`.

    Returns
    -------
    Plan

    Raises
    ------
    InputError
        If an argument cannot be used or no pair is kept.
    PlanSizeError
        If the pairs take more than `max_bytes`; its attribute `pairs` is their number.

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
    pair = source, target = as_pair(source, target)
    relative = PruningOptions.checked("relative", relative)
    PruningOptions.checked("relative_to", relative_to)
    max_bytes = PruningOptions.checked("max_bytes", max_bytes)
    log_threshold = PlanOptions.checked("log_threshold", log_threshold)
    operations = get_backend(backend)
    of_rows = RowsOfPlan(operations, pair, potentials).checked()
    rows, columns = of_rows.clouds
    f, g, epsilon = potentials.f, potentials.g, potentials.epsilon
    log_a, log_b = _log(source.weights), _log(target.weights)
    whole = of_rows.mass
    total = float(whole.sum())
    if not total <= 1e3 * max(source.mass, target.mass):
        raise InputError(
            f"the plan of these potentials has mass {total:.2g}: they are too far from a "
            f"solution (residual {potentials.residual:.1e} epsilon); raise max_iter, or use a "
            "larger blur or a smaller color_weight"
        )
    margin = 0.0
    if log_threshold is not None:
        # A bound of the error of a device's log pi_ij near the threshold, in nats.
        margin = ROUNDINGS * (of_rows.rounding + FLOAT32 * max(1.0, abs(log_threshold)))
        row_thresholds = np.full(len(f), log_threshold - margin)
        column_thresholds = np.full(len(g), np.inf)
    else:
        row_maxima = operations.row_maxima(rows, columns, g, epsilon, of_rows.near)
        row_maxima += f / epsilon + log_a
        row_thresholds = row_maxima + np.log(relative)
        if relative_to == "plan":
            row_thresholds[:] = row_thresholds.max()
            column_thresholds = np.full(len(g), np.inf)
        else:
            near = None if potentials.truncation is None else of_rows.swapped().near
            column_maxima = operations.row_maxima(columns, rows, f, epsilon, near)
            column_maxima += g / epsilon + log_b
            column_thresholds = column_maxima + np.log(relative)
    plan = PlanTerms(rows, columns, f, g, epsilon, row_thresholds, column_thresholds)
    counts = operations.count_plan_rows(plan, potentials.precise)
    kept = int(counts.sum())
    if kept * BYTES_PER_PAIR > max_bytes:
        raise PlanSizeError(
            f"the plan would keep {kept} pairs ({kept * BYTES_PER_PAIR / 1e9:.3g} GB), more than "
            f"max_bytes={max_bytes:.3g}: raise max_bytes or relative, use smaller images or a "
            "smaller blur, draw from its rows (sample=8), or take their means (barycentric=True)",
            kept,
        )
    pairs = operations.plan_rows(plan, potentials.precise, counts)
    if log_threshold is not None:
        pairs = strictly_above(pairs, pair, potentials, log_threshold, margin)
        if not len(pairs.mass):
            row_maxima = operations.row_maxima(rows, columns, g, epsilon) + f / epsilon + log_a
            raise no_pair_kept(log_threshold, float(row_maxima.max()))
    # Masses can underflow to 0; at a tiny reach all of them do.
    shape = len(source), len(target)
    # The potentials contain the marginal of the columns; computing it here would take another pass.
    return Plan(*only(pairs, pairs.mass > 0), shape, whole, potentials.column_mass)
