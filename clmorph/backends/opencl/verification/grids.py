"""The check of sums over grids."""

import numpy as np

from clmorph.backends.opencl.build.variants import Variant
from clmorph.backends.opencl.verification.bench import Bench, Findings, check
from clmorph.backends.opencl.verification.findings import UNIT, Finding, largest
from clmorph.backends.records import Float64

#: Numbers of places and of cells along the axes: fewer and more than lanes and chunks, and one.
SIZES = (((37,), (50,)), ((5, 1), (1, 130)), ((9, 4, 17), (3, 21, 8)))
#: Those of a whole device.
LARGE = (((70, 90),) * 2, ((33, 21, 40),) * 2)
#: Differences of neighboring coordinates in units of the kernel's width: sums over few neighbors,
#: and over all cells.
STEPS = 4.0, 1.1, 0.6, 0.02


def grid_case(
    places: tuple[int, ...], cells: tuple[int, ...], step: float
) -> tuple[Float64, list[tuple[Float64, Float64]]]:
    """Return exponents, many of them tiny or empty, and coordinates, the first axis descending."""
    rng = np.random.default_rng(11)
    exponents = rng.normal(0, 3, cells)
    exponents[rng.random(cells) < 0.2] -= 40.0
    exponents[rng.random(cells) < 0.2] = -np.inf
    exponents[0, ...] = -np.inf
    # A chunk with mass in its first cell alone, and empty ones: sums there go on to the one below.
    exponents[..., 17:36] = -np.inf
    exponents.ravel()[-1] = 1.0
    axes = []
    for number, counts in enumerate(zip(places, cells, strict=True)):
        x, y = (step * np.cumsum(rng.uniform(0.5, 1.5, count)) for count in counts)
        axes.append((x, y[::-1].copy()) if number == 0 else (x, y))
    return exponents, axes


@check("grid_log_sum_exp.cl")
def grids(bench: Bench, variant: Variant) -> Findings:
    """Compare sums over grids."""
    # In each pass exponents, squared distances and sums of m terms are rounded, relative to their
    # size, to the square of the extent, and m times at most.
    unit = 2.0**-50 if variant.precise else 2 * UNIT
    for places, cells in (*SIZES, *(LARGE if bench.pictures else ())):
        for step in STEPS:
            exponents, axes = grid_case(places, cells, step)
            costs = sum(float(np.ptp(np.concatenate(axis))) ** 2 for axis in axes)
            extent = float(np.ptp(exponents[np.isfinite(exponents)]))
            tolerance = unit * len(axes) * (extent + 8 * costs + sum(cells) + 40)
            name = f"grid_log_sum_exp, {' x '.join(map(str, places))}, step {step:g}"
            got, want = (
                backend.grid_log_sum_exp(exponents, axes, variant.precise) for backend in bench.both
            )
            yield Finding(name, largest(got - want) / tolerance)
