"""Checks of the operations on particles: move, sort, choose widths, splat."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from clmorph.backends.comparison import UNIT, Finding, splat_excess, splat_tolerance
from clmorph.backends.verification.clouds import SplatCase
from clmorph.backends.width_levels import WIDTH_LEVELS

#: The radius of a kernel, in kernel widths.
CUT = 4.5


def check_bins(case: SplatCase) -> Iterator[Finding]:
    """Compare the sort into bins, which is exact."""
    got = case.operations.bin_splats(case.ours, case.shape, 2)
    want = case.exact.bin_splats(case.theirs, case.shape, 2)
    wrong = np.count_nonzero(got.starts != want.starts) + np.count_nonzero(got.order != want.order)
    yield Finding("bin_splats", float(wrong), 0.0, "entries")


def check_splat(case: SplatCase, sigma: float) -> Iterator[Finding]:
    """Compare the two sums of a frame."""
    radius = CUT * sigma
    sums = case.operations.splat(case.ours, case.shape, sigma, radius)
    relative = splat_tolerance(len(case.weights))
    error = splat_excess(sums, case.exact, case.theirs, case.shape, sigma, radius, relative)
    yield Finding(f"splat, sigma {sigma:g}", error, 1.0, "of the tolerance")


def check_deposit(case: SplatCase) -> Iterator[Finding]:
    """Compare sums of masses and of their squares."""
    ours = case.operations.deposit(case.ours, case.shape)
    theirs = case.exact.deposit(case.theirs, case.shape)
    tolerance = splat_tolerance(len(case.weights))
    for name, got, want in zip(("masses", "squares"), ours, theirs, strict=True):
        error = float(np.max(np.abs(got - want) / np.maximum(want, 1e-9)))
        yield Finding(f"deposit, {name}", error, tolerance, "of the sum")


def check_own_widths(case: SplatCase, sigma: float) -> Iterator[Finding]:
    """Compare the choice of a width for each splat, and a frame with these widths."""
    count, shape = len(case.weights), case.shape
    distances = 2 ** np.random.default_rng(3).uniform(-3, 6, shape)
    ours = case.operations.adapt_widths(case.ours, distances, sigma)
    theirs = case.exact.adapt_widths(case.theirs, distances, sigma)
    levels = case.operations.width_levels(ours)
    # Rounding decides the level of widths that lie on the border between two levels.
    wrong = np.count_nonzero(levels != case.exact.width_levels(theirs))
    yield Finding("adapt_widths", float(wrong), 1e-3 * count, "levels")
    # The frame is compared at the widths that the backend has chosen.
    chosen = np.clip(levels, 0, WIDTH_LEVELS.count - 1)
    scaled = case.weights.astype(float) / WIDTH_LEVELS.factor(chosen) ** 2
    same = theirs._replace(width_levels=chosen, weights=scaled)
    sums = case.operations.splat(ours, shape, sigma, CUT * sigma)
    relative = 2 * splat_tolerance(count)
    error = splat_excess(sums, case.exact, same, shape, sigma, CUT * sigma, relative)
    yield Finding("splat, own widths", error, 1.0, "of the tolerance")


def check_advect(case: SplatCase, sigma: float = 1.3) -> Iterator[Finding]:
    """Compare a frame, and the widths, of particles that have moved."""
    rng = np.random.default_rng(4)
    count, shape = len(case.weights), case.shape
    table = rng.random((300, 6))
    links = rng.integers(0, len(table), (count, 2)).astype(np.uint32)
    weights = rng.random((count, 2))
    weights[::9, 0] = weights[::11, 1] = 0.0
    scale, center = (1.1 * shape[1], 0.9 * shape[0]), (0.5 * shape[1], 0.45 * shape[0])
    backends = case.operations, case.exact
    ours, theirs = (
        backend.advect(backend.upload_particles(table, links, weights), 0.3, scale, center)
        for backend in backends
    )
    radius = CUT * sigma
    sums = case.operations.splat(ours, shape, sigma, radius)
    # What rounding moves a particle by changes its kernel the more, the farther away it is.
    moved = 8 * UNIT * max(shape)
    relative = splat_tolerance(count) + moved * (radius + sigma) / sigma**2
    error = splat_excess(sums, case.exact, theirs, shape, sigma, radius, relative)
    yield Finding("advect", error, 1.0, "of the tolerance")
    # Where all distances are 0, widths are the spacings'.
    levels = [
        backend.width_levels(backend.adapt_widths(splats, np.zeros(shape), 0.4))
        for backend, splats in zip(backends, (ours, theirs), strict=True)
    ]
    wrong = np.count_nonzero(levels[0] != levels[1])
    yield Finding("advect, spacings", float(wrong), 1e-3 * count, "levels")


def thinned(case: SplatCase, count: int) -> SplatCase:
    """Return a case of every n-th splat, `count` of them or a few more."""
    step = max(1, len(case.weights) // count)
    names = ("positions", "colors", "weights", "spacings")
    return replace(case, **{name: getattr(case, name)[::step] for name in names})
