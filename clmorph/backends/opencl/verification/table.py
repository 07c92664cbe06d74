"""Run the table of checks: for one program, and for a whole device."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from clmorph.backends.interface import Operations
from clmorph.backends.opencl.build.variants import KERNELS, Variant, all_variants
from clmorph.backends.opencl.devices.verdicts import WRONG

# Each adds its rows to the table.
from clmorph.backends.opencl.verification import fields, iterations, layers, plans, splats, sums  # noqa: F401
from clmorph.backends.opencl.verification.bench import DIMENSION, TABLE, Bench, Cloud
from clmorph.backends.opencl.verification.findings import SIGNS_OF_WRONG_RESULTS, Finding, words_of
from clmorph.errors import ClmorphError


def check_program(bench: Bench, variant: Variant) -> Iterator[Finding]:
    """Compare the operations that use a program with NumPy."""
    some = False
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
        for finding in check_program(Bench(operations), variant):
            if not finding.passed:
                return f"{WRONG}{variant}: {finding}"
    except SIGNS_OF_WRONG_RESULTS as error:
        if isinstance(error, ClmorphError):
            raise
        kernels = ", ".join(KERNELS[variant.file])
        return f"{WRONG}{variant}: {kernels} ended in {words_of(error)}"[:300]
    return ""


def device_checks(
    operations: Operations, pictures: tuple[Cloud, Cloud]
) -> Iterator[tuple[tuple[str, ...], Callable[[], Iterator[Finding]]]]:
    """Yield every comparison in every variant, after the kernels that it is about."""
    bench = Bench(operations, pictures)
    for row in TABLE:
        for variant in all_variants(DIMENSION):
            if variant.file == row.file:
                lists = KERNELS["near_field.cl"] if variant.listed else ()
                yield (*row.kernels, *lists), partial(row.run, bench, variant)
