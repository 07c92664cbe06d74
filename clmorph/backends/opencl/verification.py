"""Check the programs of a device, each by the operations that use it, against NumPy."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Protocol

from clmorph.backends.comparison import SIGNS_OF_WRONG_RESULTS, Finding, words_of
from clmorph.backends.interface import Operations
from clmorph.backends.numpy import NumPyOperations
from clmorph.backends.opencl.build.constants import BuildConstants
from clmorph.backends.opencl.build.variants import KERNELS, Variant
from clmorph.backends.opencl.devices.verdicts import WRONG
from clmorph.backends.opencl.kernels import loop_limits
from clmorph.backends.opencl.kernels.plan_rows import PlanRowReductions
from clmorph.backends.opencl.kernels.sparse_half_steps import StoredSteps
from clmorph.backends.opencl.kernels.splat import Splatting
from clmorph.backends.verification.batches import check_softmin_batch
from clmorph.backends.verification.clouds import LONG_ROW, few_rows, several_tiles, splat_case
from clmorph.backends.verification.iterations import check_iteration
from clmorph.backends.verification.layers import check_layers, check_mean, check_paths
from clmorph.backends.verification.plans import check_plan_rows, check_stored
from clmorph.backends.verification.reductions import (
    ENOUGH,
    check_bounded_softmin,
    check_draws,
    check_near_pairs,
    check_plan_moments,
    check_projection,
    check_row_maxima,
    check_softmin,
)
from clmorph.backends.verification.seeds import check_nearest_seeds
from clmorph.backends.verification.splats import (
    check_advect,
    check_bins,
    check_deposit,
    check_own_widths,
    check_splat,
    thinned,
)
from clmorph.errors import ClmorphError

#: Number of splats and canvas of the checks: bins of more than MOMENT_CHUNK splats, several blocks
#: of pixels of any size, and sides that divide none.
SPLATS, CANVAS = 12_000, (29, 43)
#: Number of splats where more would add nothing.
FEWER = 2000
#: The dimension of the points for the checks of files that are built for all dimensions.
DIMENSION = 5


class Adjustable(Operations, Protocol):
    """Operations of a device whose choices of a method by size can be overruled."""

    constants: BuildConstants
    splatting: Splatting
    plan_row_reductions: PlanRowReductions
    stored_steps: StoredSteps


_Checks = Iterator[Finding]
#: Points of a side whose loops have more work-groups than a group of 64 has items.
LONG_VECTOR = 5003


def check_program(operations: Adjustable, variant: Variant) -> Iterator[Finding]:
    """Compare the operations that use a program with NumPy.

    Nothing else uses these operations: methods are forced here that would be chosen by size.
    """
    yield from _CHECKS[variant.file](operations, variant)


def first_failure(operations: Adjustable, variant: Variant) -> str:
    """Return what is wrong with a program, in words; '' if nothing is."""
    try:
        for finding in check_program(operations, variant):
            if not finding.passed:
                return f"{WRONG}{variant}: {finding}"
    except SIGNS_OF_WRONG_RESULTS as error:
        if isinstance(error, ClmorphError):
            raise
        kernels = ", ".join(KERNELS[variant.file])
        return f"{WRONG}{variant}: {kernels} ended in {words_of(error)}"[:300]
    return ""


def _check_log_sum_exp(operations: Adjustable, variant: Variant) -> _Checks:
    exact = NumPyOperations()
    if variant.listed and not variant.masked:
        # The lists of batches have no masks.
        yield from check_softmin_batch(
            operations, exact, variant.dimension, variant.precise, bool(variant.bounded)
        )
        return
    cases = [several_tiles(operations, exact, variant.dimension)]
    if not variant.listed:
        cases.append(few_rows(operations, exact, variant.dimension))
    for case in cases:
        if variant.bounded:
            # Over near pairs powers are float32 if that is exact enough.
            enough = ENOUGH if variant.bounded == 2 else 0.0
            yield from check_bounded_softmin(case, variant.listed, enough)
            continue
        yield from check_softmin(case, variant.precise, variant.listed)
        if not (variant.precise or variant.listed):
            yield from check_row_maxima(case)


def _check_near_field(operations: Adjustable, variant: Variant) -> _Checks:
    yield from check_near_pairs(several_tiles(operations, NumPyOperations(), variant.dimension))


def _check_plan_rows(operations: Adjustable, variant: Variant) -> _Checks:
    exact = NumPyOperations()
    operations.plan_row_reductions.always_listed = variant.listed
    yield from check_plan_rows(several_tiles(operations, exact, variant.dimension), variant.precise)
    if not variant.listed:
        yield from check_plan_rows(few_rows(operations, exact, variant.dimension), variant.precise)


def _check_barycentric_projection(operations: Adjustable, variant: Variant) -> _Checks:
    exact = NumPyOperations()
    yield from check_projection(
        several_tiles(operations, exact, variant.dimension), variant.precise, variant.listed
    )
    if not variant.listed:
        few = few_rows(operations, exact, variant.dimension)
        yield from check_projection(few, variant.precise)


def _check_plan_shares(operations: Adjustable, variant: Variant) -> _Checks:
    exact = NumPyOperations()
    cases = [several_tiles(operations, exact, variant.dimension)]
    if not variant.listed:
        cases.append(few_rows(operations, exact, variant.dimension))
    for case in cases:
        yield from check_plan_moments(case, variant.precise, variant.listed)
        yield from check_draws(case, variant.precise, variant.listed)


def _check_half_steps(operations: Adjustable, variant: Variant) -> _Checks:
    case = several_tiles(operations, NumPyOperations(), DIMENSION)
    for balanced in range(4):
        findings = list(check_iteration(case, balanced))
        assert findings, "the device does not iterate, so nothing was checked"
        yield from findings


def _check_stored_steps(operations: Adjustable, variant: Variant) -> _Checks:
    exact, most = NumPyOperations(), operations.stored_steps.most_groups
    # Loops of several rounds in two groups, and sums of more groups than a group has items.
    cases = (
        (several_tiles(operations, exact, DIMENSION), 2),
        (few_rows(operations, exact, DIMENSION, LONG_VECTOR), most),
    )
    for case, groups in cases:
        operations.stored_steps.most_groups = groups
        for balanced in (0, 1, 2, 3):
            findings = list(check_iteration(case, balanced, True))
            assert findings, "the device does not iterate, so nothing was checked"
            yield from findings


def _check_sliced_ellpack(operations: Adjustable, variant: Variant) -> _Checks:
    exact = NumPyOperations()
    yield from check_stored(several_tiles(operations, exact, DIMENSION))
    # Where loops end early, the pairs of longer rows are not stored.
    columns = min(LONG_ROW, loop_limits.stored_pairs(operations.constants))
    yield from check_stored(few_rows(operations, exact, DIMENSION, columns))


def _check_particles(operations: Adjustable, variant: Variant) -> _Checks:
    case = splat_case(operations, NumPyOperations(), SPLATS, CANVAS)
    operations.splatting.method = "gather"
    yield from check_bins(case)
    yield from check_deposit(case)
    fewer = thinned(case, FEWER)
    yield from check_advect(fewer)
    yield from check_own_widths(fewer, 0.7)


def _check_splat(operations: Adjustable, variant: Variant, method: str) -> _Checks:
    operations.splatting.method = method
    case = splat_case(operations, NumPyOperations(), SPLATS, CANVAS)
    for sigma in (0.0, 0.6) if method == "gather" else (0.7, 5.0):
        yield from check_splat(case, sigma)
    yield from check_own_widths(thinned(case, FEWER), 1.1)


def _check_layers(operations: Adjustable, variant: Variant) -> _Checks:
    for check in (check_mean, check_paths, check_layers):
        yield from check(operations, NumPyOperations())


def _check_nearest_seeds(operations: Adjustable, variant: Variant) -> _Checks:
    yield from check_nearest_seeds(operations, NumPyOperations())


_CHECKS: dict[str, Callable[[Adjustable, Variant], _Checks]] = {
    "log_sum_exp.cl": _check_log_sum_exp,
    "near_field.cl": _check_near_field,
    "plan_rows.cl": _check_plan_rows,
    "barycentric_projection.cl": _check_barycentric_projection,
    "plan_shares.cl": _check_plan_shares,
    "half_steps.cl": _check_half_steps,
    "sparse_half_steps.cl": _check_stored_steps,
    "sliced_ellpack.cl": _check_sliced_ellpack,
    "particles.cl": _check_particles,
    "splat.cl": partial(_check_splat, method="gather"),
    "layers.cl": _check_layers,
    "nearest_seeds.cl": _check_nearest_seeds,
    "gauss_transform.cl": partial(_check_splat, method="moments"),
}
