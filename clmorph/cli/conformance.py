"""Compare a device with NumPy in every operation and in one whole morph."""

import platform
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clmorph.backends.comparison import SIGNS_OF_WRONG_RESULTS, Finding, words_of
from clmorph.backends.interface import Operations
from clmorph.backends.numpy import NumPyOperations
from clmorph.backends.opencl.build.kernel_files import KERNELS
from clmorph.backends.verification.batches import check_softmin_batch
from clmorph.backends.verification.clouds import CloudCase, splat_case
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
from clmorph.errors import InputError
from clmorph.measures.lift import lift
from clmorph.measures.measure import Measure
from clmorph.pipeline.morph import morph

#: The number of splats and the canvas of the comparisons of splatting.
SPLATS, CANVAS = 20_000, (61, 83)


class Check(NamedTuple):
    """A comparison, and the kernels that it is about."""

    kernels: tuple[str, ...]
    run: Callable[[], Iterator[Finding]]


def _picture(side: int, phase: float) -> NDArray[np.float64]:
    """Draw a smooth test picture."""
    y, x = np.mgrid[:side, :side] / side
    waves = [np.sin(5 * x + k * y + phase) * np.cos(3 * y - k * phase) for k in (1, 3, 6)]
    return 0.5 + 0.5 * np.stack(waves, axis=-1)


def _cloud(measure: Measure) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return measure.points, measure.weights


def check(operations: Operations, kernels: Sequence[str] = ()) -> Iterator[Finding]:
    """Compare a backend with NumPy, one operation after the other.

    If names of kernels, or of kernel files with or without their ending, are given, only the
    operations that use one of them are compared.
    """
    wanted = _wanted(kernels)
    for kernels_of_check, run in _checks(operations):
        if not kernels or wanted & set(kernels_of_check):
            yield from _findings(kernels_of_check, run)


def _findings(kernels: tuple[str, ...], run: Callable[[], Iterator[Finding]]) -> Iterator[Finding]:
    """Yield what a comparison finds; an error to which wrong results lead is a finding, too."""
    try:
        yield from run()
    except SIGNS_OF_WRONG_RESULTS as error:
        # The data of the comparisons are right, so errors of clmorph come from wrong results, too.
        about = "morph" if kernels == _EVERY else ", ".join(kernels)
        yield Finding(f"{about} ended in {words_of(error)}", np.inf, 0.0, "")


def check_kernel_names(kernels: Sequence[str]) -> None:
    """Raise an `InputError` for a name that is neither that of a kernel nor that of a file."""
    _wanted(kernels)


def _wanted(names: Sequence[str]) -> set[str]:
    """Return the kernels that some names stand for."""
    found: set[str] = set()
    for name in names:
        own = [
            kernel
            for file, kernels in KERNELS.items()
            for kernel in kernels
            if name in (kernel, file, file.removesuffix(".cl"))
        ]
        if not own:
            listed = ", ".join(f"{file} ({', '.join(of)})" for file, of in KERNELS.items())
            raise InputError(f"--kernel {name!r}: expected a kernel or a file among {listed}")
        found.update(own)
    return found


_NEAR = KERNELS["near_field.cl"]
_PLAN = KERNELS["plan_rows.cl"]
_SORT = "count_bins", "fill_bins"
_CELLS = KERNELS["gauss_transform.cl"]
_EVERY = tuple(kernel for kernels in KERNELS.values() for kernel in kernels)


def _checks(operations: Operations) -> Iterator[Check]:
    """Yield all comparisons, which compute nothing before they are run."""
    exact = NumPyOperations()
    pair = _cloud(lift(_picture(37, 0.2))), _cloud(lift(_picture(31, 1.7)))
    for blur in (1.0, 0.05, 0.003):
        case = CloudCase(operations, exact, *pair, blur**2, f", blur {blur:g}")
        yield Check(("log_sum_exp",), partial(check_softmin, case))
        yield Check(("log_sum_exp",), partial(check_softmin, case, True))
        yield Check(("log_sum_exp",), partial(check_row_maxima, case))
        yield Check(("log_sum_exp",), partial(check_bounded_softmin, case))
        yield Check(("log_sum_exp", *_NEAR), partial(check_near_pairs, case))
        yield Check(("log_sum_exp", *_NEAR), partial(check_bounded_softmin, case, True, ENOUGH))
    case = CloudCase(operations, exact, *pair, 0.0025)
    for precise in (False, True):
        yield Check(_PLAN, partial(check_plan_rows, case, precise))
    for listed in (False, True):
        kernels = (*KERNELS["sliced_ellpack.cl"], *_PLAN, *_NEAR * listed)
        yield Check(kernels, partial(check_stored, case, listed))
    yield Check(("log_sum_exp",), partial(check_offsets, case))
    for balanced in (0, 3):
        kernels = (*KERNELS["half_steps.cl"], "log_sum_exp")
        yield Check(kernels, partial(check_iteration, case, balanced))
        kernels = (*KERNELS["sparse_half_steps.cl"], *KERNELS["sliced_ellpack.cl"], *_PLAN)
        yield Check(kernels, partial(check_iteration, case, balanced, True))
    for kind in ((False, False), (True, False), (True, True)):
        yield Check(("log_sum_exp",), partial(check_softmin_batch, operations, exact, 5, *kind))
    # Of a few rows so many draws are compared that a single column's share shows.
    few = CloudCase(operations, exact, (pair[0][0][:4], pair[0][1][:4]), pair[1], 0.0025)
    for precise in (False, True):
        for listed in (False, True):
            near = _NEAR * listed
            yield Check(
                ("barycentric_projection", *near),
                partial(check_projection, case, precise, listed),
            )
            yield Check(("plan_moments", *near), partial(check_plan_moments, case, precise, listed))
            yield Check(
                ("sample_plan_rows", *near), partial(check_draws, few, precise, listed, 2000)
            )
    splats = splat_case(operations, exact, SPLATS, CANVAS)
    fewer = thinned(splats, 4000)
    yield Check(_SORT, partial(check_bins, splats))
    for sigma, kernels in ((0.0, ("splat",)), (0.6, ("splat", *_CELLS)), (5.0, _CELLS)):
        yield Check((*_SORT, *kernels), partial(check_splat, splats, sigma))
    yield Check((*_SORT, "pack_weights", "splat"), partial(check_deposit, fewer))
    yield Check(
        (*_SORT, "choose_width_levels", "splat", *_CELLS), partial(check_own_widths, fewer, 0.7)
    )
    yield Check((*_SORT, "advect", "choose_width_levels", "splat"), partial(check_advect, fewer))
    for kernels, run in (
        (("edge_preserving_mean",), partial(check_mean, operations, exact, (37, 52))),
        (("follow_paths",), partial(check_paths, operations, exact, (61, 83))),
        (("place_layer", "draw_layers"), partial(check_layers, operations, exact, (150, 211))),
    ):
        yield Check(kernels, run)
    yield Check(
        ("nearest_seeds",), partial(check_nearest_seeds, operations, exact, (120, 160), 20_000)
    )
    yield Check(_EVERY, partial(_check_morph, operations))


def _check_morph(operations: Operations) -> Iterator[Finding]:
    images = _picture(20, 0.4), _picture(24, 2.9)
    ours, theirs = (
        morph(*images, n_frames=3, backend=backend) for backend in (operations, NumPyOperations())
    )
    error = max(float(np.abs(a - b).max()) for a, b in zip(ours.frames, theirs.frames, strict=True))
    yield Finding("morph", 255 * error, 1.0, "of 255")


def nearest(findings: Sequence[Finding]) -> Finding | None:
    """Return the finding whose error is the largest share of its tolerance; None if none is."""
    return max(findings, key=lambda finding: finding.share, default=None)


def report(device: Any, findings: list[Finding], pairs_per_second: float) -> dict[str, Any]:
    """Collect the data about a device for a report in JSON, without personal data."""
    from clmorph._shared.version import __version__

    close = nearest(findings)
    return {
        "clmorph": __version__,
        "system": f"{platform.system()} {platform.machine()}",
        "device": device.record(),
        "pairs_per_second": pairs_per_second,
        "findings": [_record(finding) for finding in findings],
        "nearest": None if close is None else close.name,
    }


def _record(finding: Finding) -> dict[str, Any]:
    # JSON has no infinity.
    numbers = {
        name: value if np.isfinite(value) else None
        for name, value in (("error", finding.error), ("share", finding.share))
    }
    return asdict(finding) | numbers | {"passed": finding.passed}
