"""The comparisons of a device with NumPy: one table, for programs, and for the whole device."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

from clmorph.backends.comparison import SIGNS_OF_WRONG_RESULTS, Finding, words_of
from clmorph.backends.interface import Operations
from clmorph.backends.numpy import NumPyOperations
from clmorph.backends.opencl.build.variants import KERNELS, Variant, all_variants
from clmorph.backends.opencl.devices.verdicts import WRONG
from clmorph.backends.opencl.kernels import loop_limits
from clmorph.backends.verification.batches import check_batch_iteration, check_softmin_batch
from clmorph.backends.verification.clouds import (
    LONG_ROW,
    Cloud,
    CloudCase,
    SplatCase,
    few_rows,
    several_tiles,
    splat_case,
)
from clmorph.backends.verification.grids import check_grids
from clmorph.backends.verification.iterations import check_iteration
from clmorph.backends.verification.layers import check_layers, check_mean, check_paths
from clmorph.backends.verification.plans import check_plan_rows, check_stored
from clmorph.backends.verification.reductions import (
    ENOUGH,
    check_bounded_softmin,
    check_draws,
    check_near_pairs,
    check_offsets,
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
from clmorph.backends.verification.tables import check_tables
from clmorph.errors import ClmorphError

#: The dimension of the points for the checks of files that are built for all dimensions.
DIMENSION = 5
#: Points of a side whose loops have more work-groups than a group of 64 has items.
LONG_VECTOR = 5003
#: Blurs at which a whole device is compared.
BLURS = 1.0, 0.05, 0.003


@dataclass(frozen=True)
class Bench:
    """A backend, and the inputs on which it is compared, which are made when first used.

    The choices of a method by size are overruled, so that a variant is compared alone. A program
    is compared on a few points. With clouds of two `pictures`, which a whole device is compared on,
    there are more of everything.
    """

    operations: Any
    pictures: tuple[Cloud, Cloud] | None = None
    exact: Operations = field(default_factory=NumPyOperations)

    @cached_property
    def lifted(self) -> list[CloudCase]:
        """The pictures' clouds at blurs from large to small."""
        if self.pictures is None:
            return []
        return [
            CloudCase(self.operations, self.exact, *self.pictures, blur**2, f", blur {blur:g}")
            for blur in BLURS
        ]

    def clouds(self, variant: Variant, columns: int = LONG_ROW) -> list[CloudCase]:
        """Return clouds of a few tiles, a few long rows unless they are listed, and pictures."""
        backends, dimension = (self.operations, self.exact), variant.dimension or DIMENSION
        long = [] if variant.listed else [few_rows(*backends, dimension, columns)]
        own = [several_tiles(*backends, dimension), *long]
        return own + (self.lifted if dimension == DIMENSION else [])

    @cached_property
    def splats(self) -> SplatCase:
        """Bins of more than MOMENT_CHUNK splats, and sides that no size of a block divides."""
        count, shape = (20_000, (61, 83)) if self.pictures else (12_000, (29, 43))
        return splat_case(self.operations, self.exact, count, shape)

    @cached_property
    def fewer(self) -> SplatCase:
        """Splats where more would add nothing."""
        return thinned(self.splats, 4000 if self.pictures else 2000)

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


_Findings = Iterator[Finding]
_Run = Callable[[Bench, Variant], _Findings]


class Row(NamedTuple):
    """A comparison for the programs of a file."""

    file: str
    kernels: tuple[str, ...]  #: that it uses; with lists also those of near_field.cl
    run: _Run


def _softmins(bench: Bench, variant: Variant) -> _Findings:
    if variant.listed and not variant.masked:
        # The lists of batches have no masks.
        yield from check_softmin_batch(
            bench.operations, bench.exact, variant.dimension, variant.precise, bool(variant.bounded)
        )
        return
    for case in bench.clouds(variant):
        if variant.bounded:
            # Over near pairs powers are float32 if that is exact enough.
            enough = ENOUGH if variant.bounded == 2 else 0.0
            yield from check_bounded_softmin(case, variant.listed, enough)
            continue
        yield from check_softmin(case, variant.precise, variant.listed)
        if not (variant.precise or variant.listed):
            yield from check_row_maxima(case)
            yield from check_offsets(case)


def _levels(bench: Bench, variant: Variant) -> _Findings:
    with bench.forced("row_loop", "device_levels", 0):
        for case in bench.clouds(variant):
            for precise in (False, True):
                yield from check_softmin(case, precise)


def _near_pairs(bench: Bench, variant: Variant) -> _Findings:
    for case in bench.clouds(variant):
        yield from check_near_pairs(case)


def _plan_rows(bench: Bench, variant: Variant) -> _Findings:
    # At smaller blurs thresholds of columns are rounded by more than precise exponents.
    cases = [case for case in bench.clouds(variant) if not case.name.endswith(str(BLURS[-1]))]
    with bench.forced("plan_row_reductions", "always_listed", variant.listed):
        for case in cases:
            yield from check_plan_rows(case, variant.precise)


def _over_rows(check: Callable[..., _Findings], bench: Bench, variant: Variant) -> _Findings:
    for case in bench.clouds(variant):
        yield from check(case, variant.precise, variant.listed)


def _draws(bench: Bench, variant: Variant) -> _Findings:
    yield from _over_rows(check_draws, replace(bench, pictures=None), variant)
    if bench.pictures is not None:
        # Of a few rows so many draws are compared that a single column's share shows.
        (points, weights), columns = bench.pictures
        few = CloudCase(bench.operations, bench.exact, (points[:4], weights[:4]), columns, 0.0025)
        yield from check_draws(few, variant.precise, variant.listed, 2000)


def _iterations(bench: Bench, variant: Variant) -> _Findings:
    tiles, _, *lifted = bench.clouds(variant)
    for case in (tiles, *lifted[1:2]):
        for balanced in range(4):
            yield from check_iteration(case, balanced)
    yield from check_batch_iteration(bench.operations)


def _stored_iterations(bench: Bench, variant: Variant) -> _Findings:
    most = getattr(getattr(bench.operations, "stored_steps", None), "most_groups", None)
    # Loops of several rounds in two groups, and sums of more groups than a group has items.
    tiles, long, *lifted = bench.clouds(variant, LONG_VECTOR)
    for case, groups in ((tiles, 2), (long, most), *((case, most) for case in lifted[1:2])):
        with bench.forced("stored_steps", "most_groups", groups):
            for balanced in range(4):
                yield from check_iteration(case, balanced, True)


def _stored(bench: Bench, variant: Variant) -> _Findings:
    # Where loops end early, the pairs of longer rows are not stored.
    constants = getattr(bench.operations, "constants", None)
    columns = LONG_ROW
    if constants is not None:
        columns = min(columns, loop_limits.stored_pairs(constants))
    tiles, long, *lifted = bench.clouds(variant, columns)
    for case in (tiles, long, *lifted[1:2]):
        yield from check_stored(case)
    for case in lifted[1:2]:
        yield from check_stored(case, True)


def _splats(bench: Bench, variant: Variant) -> _Findings:
    method = "gather" if variant.file == "splat.cl" else "moments"
    with bench.forced("splatting", "method", method):
        for sigma in (0.0, 0.6) if method == "gather" else (0.7, 5.0):
            yield from check_splat(bench.splats, sigma)
        yield from check_own_widths(bench.fewer, 1.1)


def _gathered(check: Callable[..., _Findings], bench: Bench, variant: Variant) -> _Findings:
    with bench.forced("splatting", "method", "gather"):
        yield from check(bench)


def _drawn(
    check: Callable[..., _Findings], more: tuple[Any, ...], bench: Bench, variant: Variant
) -> _Findings:
    yield from check(bench.operations, bench.exact, *(more if bench.pictures else ()))


def _grids(bench: Bench, variant: Variant) -> _Findings:
    large = ((70, 90), (33, 21, 40)) if bench.pictures else ()
    yield from check_grids(bench.operations, bench.exact, variant.precise, large)


_SORT = "count_bins", "fill_bins"
_STORE = (*KERNELS["sliced_ellpack.cl"], *KERNELS["plan_rows.cl"])

#: Every comparison of a device with NumPy, but for the whole morph.
TABLE = (
    Row("log_sum_exp.cl", ("log_sum_exp",), _softmins),
    Row("tile_levels.cl", ("tile_levels", "log_sum_exp"), _levels),
    Row("near_field.cl", ("log_sum_exp",), _near_pairs),
    Row("plan_rows.cl", KERNELS["plan_rows.cl"], _plan_rows),
    Row(
        "barycentric_projection.cl",
        ("barycentric_projection",),
        partial(_over_rows, check_projection),
    ),
    Row("plan_shares.cl", ("plan_moments",), partial(_over_rows, check_plan_moments)),
    Row("plan_shares.cl", ("sample_plan_rows",), _draws),
    Row("half_steps.cl", (*KERNELS["half_steps.cl"], "log_sum_exp"), _iterations),
    Row("sparse_half_steps.cl", (*KERNELS["sparse_half_steps.cl"], *_STORE), _stored_iterations),
    Row("sliced_ellpack.cl", (*_STORE, *KERNELS["near_field.cl"]), _stored),
    Row("particles.cl", _SORT, partial(_gathered, lambda bench: check_bins(bench.splats))),
    Row(
        "particles.cl",
        (*_SORT, "pack_weights", "splat"),
        partial(_gathered, lambda bench: check_deposit(bench.splats)),
    ),
    Row(
        "particles.cl",
        (*_SORT, "advect", "choose_width_levels", "splat"),
        partial(_gathered, lambda bench: check_advect(bench.fewer)),
    ),
    Row(
        "particles.cl",
        (*_SORT, "choose_width_levels", "splat"),
        partial(_gathered, lambda bench: check_own_widths(bench.fewer, 0.7)),
    ),
    Row("splat.cl", (*_SORT, "choose_width_levels", "splat"), _splats),
    Row("layers.cl", ("edge_preserving_mean",), partial(_drawn, check_mean, ((37, 52),))),
    Row("layers.cl", ("follow_paths",), partial(_drawn, check_paths, ((61, 83),))),
    Row("layers.cl", ("place_layer", "draw_layers"), partial(_drawn, check_layers, ((150, 211),))),
    Row(
        "nearest_seeds.cl",
        ("nearest_seeds",),
        partial(_drawn, check_nearest_seeds, ((120, 160), 20_000)),
    ),
    Row("color_table.cl", ("apply_table",), partial(_drawn, check_tables, (300_000, (17, 65)))),
    Row("grid_log_sum_exp.cl", KERNELS["grid_log_sum_exp.cl"], _grids),
    Row(
        "gauss_transform.cl",
        (*_SORT, "choose_width_levels", *KERNELS["gauss_transform.cl"]),
        _splats,
    ),
)


def check_program(operations: Any, variant: Variant) -> Iterator[Finding]:
    """Compare the operations that use a program with NumPy."""
    bench, some = Bench(operations), False
    for row in TABLE:
        if row.file == variant.file:
            for finding in row.run(bench, variant):
                some = True
                yield finding
    assert some, "the device does not iterate, so nothing was checked"


def first_failure(operations: Any, variant: Variant) -> str:
    """Return what is wrong with a program, in words; '' if nothing is."""
    if variant.is_optional:
        operations.programs.kernels(variant)  # else the host iterates, and nothing is checked
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


class Check(NamedTuple):
    """A comparison of a whole device, and the kernels that it is about."""

    kernels: tuple[str, ...]
    run: Callable[[], Iterator[Finding]]


def device_checks(operations: Operations, pictures: tuple[Cloud, Cloud]) -> Iterator[Check]:
    """Yield every comparison in every variant; none computes anything before it is run."""
    bench = Bench(operations, pictures)
    for row in TABLE:
        for variant in all_variants(DIMENSION):
            if variant.file == row.file:
                lists = KERNELS["near_field.cl"] if variant.listed else ()
                yield Check((*row.kernels, *lists), partial(row.run, bench, variant))
