"""Checks of the operations on particles: move, sort, choose widths, splat."""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from clmorph.backends.interface import KERNEL_ERROR, Operations
from clmorph.backends.numpy import NumPyOperations
from clmorph.backends.opencl.build.variants import KERNELS, Variant
from clmorph.backends.opencl.verification.bench import Bench, Findings, check
from clmorph.backends.opencl.verification.findings import UNIT, Finding, count_differences, largest
from clmorph.backends.records import WIDTH_LEVELS, Float32, Float64

#: The radius of a kernel, in kernel widths.
CUT = 4.5
#: Kernels that every operation on splats uses.
SORT = "count_bins", "fill_bins"


@dataclass(frozen=True, eq=False)
class Splats:
    """Splats at rest (`Operations.upload_splats`): on a canvas and around it, a quarter crowded."""

    arrays: tuple[Float32, ...]  #: positions, colors, weights, spacings
    shape: tuple[int, int]

    def on(self, backend: Operations) -> Any:
        """Return the splats on a backend."""
        return backend.upload_splats(*self.arrays)


@dataclass(frozen=True)
class Range:
    """Where sums of a frame may lie, of kernels cut anywhere from a radius to a `sigma` more."""

    near: tuple[Float64, Float64]
    far: tuple[Float64, Float64]
    #: How many kernels reach each pixel.
    kernels: Float64 | float

    @staticmethod
    def of(
        splats: Any, shape: tuple[int, int], sigma: float, radius: float | None = None
    ) -> "Range":
        """Return the range of splats of NumPy, without colors below 0; cut at `CUT` by default."""
        exact, radius = NumPyOperations(), CUT * sigma if radius is None else radius
        near = exact.splat(splats, shape, sigma, radius)
        if sigma == 0:
            return Range(near, near, 0.0)
        far = exact.splat(splats, shape, sigma, radius + sigma)
        flat = exact.splat(splats, shape, 1e6 * (sigma + radius), radius + sigma)
        return Range(near, far, flat[1])

    def excess(self, sums: tuple[Float64, Float64], relative: float) -> float:
        """Return the largest distance of sums from their range, in units of the tolerance."""
        tolerance = relative * self.far[1] + np.finfo(float).tiny + KERNEL_ERROR * self.kernels
        return max(
            largest(np.maximum(0.0, np.maximum(low - got, got - high)) / scale)
            for got, low, high, scale in zip(
                sums, self.near, self.far, (tolerance[..., None], tolerance), strict=True
            )
        )


def splat_tolerance(count: int, chunk: int = 1024) -> float:
    """Return the relative error of float32 sums of splats in chunks, with exponents to 30."""
    return UNIT * (chunk + count / chunk + 4 * 30)


@cache
def splats_of(many: bool, few: bool = False) -> Splats:
    """Return splats on a canvas that no block divides, a quarter of them in one bin."""
    count, shape = (20_000, (61, 83)) if many else (5000, (29, 43))
    rng = np.random.default_rng(1)
    height, width = shape
    positions = rng.uniform(-2, [width + 1, height + 1], (count, 2))
    positions[: count // 4] = np.array(shape[::-1]) / 2 + rng.uniform(0, 1.3, (count // 4, 2))
    arrays = (
        positions, rng.random((count, 3)), 10 ** rng.uniform(-10, 0, count),
        2 ** rng.uniform(-3, 3, count),
    )  # fmt: skip
    return Splats(tuple(array[:: 5 if few else 1].astype(np.float32) for array in arrays), shape)


@cache
def range_of(many: bool, sigma: float) -> Range:
    """Return the range of a frame of `splats_of`, which is the same for every device."""
    own = splats_of(many)
    return Range.of(own.on(NumPyOperations()), own.shape, sigma)


@check("particles.cl", *SORT)
def bins(bench: Bench, variant: Variant) -> Findings:
    """Compare the sort into bins, which is exact."""
    own = splats_of(bench.pictures is not None)
    got, want = (backend.bin_splats(own.on(backend), own.shape, 2) for backend in bench.both)
    wrong = count_differences(got.starts, want.starts) + count_differences(got.order, want.order)
    yield Finding("bin_splats", wrong, 0.0, "entries")


@check("particles.cl", *SORT, "pack_weights", "splat")
def deposits(bench: Bench, variant: Variant) -> Findings:
    """Compare sums of masses and of their squares."""
    own = splats_of(bench.pictures is not None)
    with bench.forced("splatting", "method", "gather"):
        ours, theirs = (backend.deposit(own.on(backend), own.shape) for backend in bench.both)
    for name, got, want in zip(("masses", "squares"), ours, theirs, strict=True):
        error = largest((got - want) / np.maximum(want, 1e-9))
        allowed = splat_tolerance(len(own.arrays[0]))
        yield Finding(f"deposit, {name}", error, allowed, "of the sum")


@check("particles.cl", *SORT, "advect", "choose_width_levels", "splat")
def moved(bench: Bench, variant: Variant) -> Findings:
    """Compare a frame, and the widths, of particles that have moved."""
    sigma = 1.3
    shape, count = splats_of(bench.pictures is not None).shape, 4000 if bench.pictures else 1000
    rng = np.random.default_rng(4)
    table = rng.random((300, 6))
    links = rng.integers(0, len(table), (count, 2)).astype(np.uint32)
    weights = rng.random((count, 2))
    weights[::9, 0] = weights[::11, 1] = 0.0
    scale, center = (1.1 * shape[1], 0.9 * shape[0]), (0.5 * shape[1], 0.45 * shape[0])
    ours, theirs = (
        backend.advect(backend.upload_particles(table, links, weights), 0.3, scale, center)
        for backend in bench.both
    )
    radius = CUT * sigma
    # What rounding moves a particle by changes its kernel the more, the farther away it is.
    relative = splat_tolerance(count) + 8 * UNIT * max(shape) * (radius + sigma) / sigma**2
    with bench.forced("splatting", "method", "gather"):
        sums = bench.operations.splat(ours, shape, sigma, radius)
    yield Finding("advect", Range.of(theirs, shape, sigma).excess(sums, relative))
    # Where all distances are 0, widths are the spacings'.
    got, want = (
        backend.width_levels(backend.adapt_widths(splats, np.zeros(shape), 0.4))
        for backend, splats in ((bench.operations, ours), (bench.exact, theirs))
    )
    yield Finding("advect, spacings", count_differences(got, want), 1e-3 * count, "levels")


@check("particles.cl", *SORT, "choose_width_levels", "splat")
@check("splat.cl", *SORT, "choose_width_levels", "splat")
@check("gauss_transform.cl", *SORT, "choose_width_levels", *KERNELS["gauss_transform.cl"])
def frames(bench: Bench, variant: Variant) -> Findings:
    """Compare frames of one width, and of a width for each splat, which is chosen."""
    many = bench.pictures is not None
    method = "moments" if variant.file == "gauss_transform.cl" else "gather"
    sigmas = {"splat.cl": (0.0, 0.6), "gauss_transform.cl": (0.7, 5.0)}.get(variant.file, ())
    with bench.forced("splatting", "method", method):
        for sigma in sigmas:
            own = splats_of(many)
            sums = bench.operations.splat(own.on(bench.operations), own.shape, sigma, CUT * sigma)
            error = range_of(many, sigma).excess(sums, splat_tolerance(len(own.arrays[0])))
            yield Finding(f"splat, sigma {sigma:g}", error)
        yield from _own_widths(bench, splats_of(many, few=True), 1.1 if sigmas else 0.7)


def _own_widths(bench: Bench, own: Splats, sigma: float) -> Findings:
    shape, weights = own.shape, own.arrays[2].astype(float)
    distances = 2 ** np.random.default_rng(3).uniform(-3, 6, shape)
    ours, theirs = (
        backend.adapt_widths(own.on(backend), distances, sigma) for backend in bench.both
    )
    levels = bench.operations.width_levels(ours)
    # Rounding decides the level of widths that lie on the border between two levels.
    wrong = count_differences(levels, bench.exact.width_levels(theirs))
    yield Finding("adapt_widths", wrong, 1e-3 * len(weights), "levels")
    # The frame is compared at the widths that the backend has chosen.
    chosen = np.clip(levels, 0, WIDTH_LEVELS.count - 1)
    same = theirs._replace(width_levels=chosen, weights=weights / WIDTH_LEVELS.factor(chosen) ** 2)
    sums = bench.operations.splat(ours, shape, sigma, CUT * sigma)
    error = Range.of(same, shape, sigma).excess(sums, 2 * splat_tolerance(len(weights)))
    yield Finding("splat, own widths", error)
