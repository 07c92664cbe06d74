"""Checks of what has no clouds: sums over grids, nearest seeds, tables of colors."""

import numpy as np

from clmorph.backends.opencl.build.variants import Variant
from clmorph.backends.opencl.verification.bench import Bench, Findings, check
from clmorph.backends.opencl.verification.findings import UNIT, Finding, count_differences, largest
from clmorph.backends.records import Float32, Float64

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


#: How far a square of a distance may be off, relative to it: four roundings, of each of two seeds.
SEED_TOLERANCE = 10 * UNIT


def seeds_of(shape: tuple[int, int], count: int) -> dict[str, Float32]:
    """Return seeds for a canvas: spread about it, far outside, in few places, and on a lattice."""
    rng = np.random.default_rng(6)
    height, width = shape
    about = rng.uniform(-0.3, 1.3, (count, 2)) * (width, height)
    places = rng.uniform(0.0, 1.0, (5, 2)) * (width, height)
    clusters = places[rng.integers(0, 5, count)] + rng.normal(0.0, 0.1, (count, 2))
    # Ties of any number of seeds, some of them in the same place; all numbers are exact.
    lattice = rng.integers(-2, np.array([width, height]) + 2, (count, 2)) + 0.5
    outside = about + np.array([40.0 * width, -30.0 * height])
    made = {"spread": about, "outside": outside, "in clusters": clusters, "on a lattice": lattice}
    return {name: seeds.astype(np.float32) for name, seeds in made.items()}


@check("nearest_seeds.cl")
def nearest_seeds(bench: Bench, variant: Variant) -> Findings:
    """Compare nearest seeds: by their distances and, where these are exact, by their indices."""
    shape, count = ((120, 160), 20_000) if bench.pictures else ((45, 70), 3000)
    for name, seeds in seeds_of(shape, count).items():
        got, want = (x.nearest_seeds(seeds, shape) for x in bench.both)
        if name == "on a lattice":
            yield Finding(f"nearest_seeds, {name}", count_differences(got, want), 0.0, "indices")
            continue
        error = seed_excess(seeds, got, want)
        yield Finding(f"nearest_seeds, {name}", error, SEED_TOLERANCE, "of a squared distance")


def seed_excess(seeds: Float32, got: np.ndarray, want: np.ndarray) -> float:
    """Return how much farther seeds `got` are than `want`: the largest share of a square."""
    if not (got.min() >= 0 and got.max() < len(seeds)):
        return float("inf")
    y, x = np.mgrid[: want.shape[0], : want.shape[1]]
    ours, best = (
        np.square(np.dstack((x, y)) - seeds[each].astype(float)).sum(axis=-1)
        for each in (got, want)
    )
    return float(np.max((ours - best) / np.maximum(best, np.finfo(float).tiny)))


def table_of(nodes: int) -> Float32:
    """Return a table of random values, which is as steep as any."""
    rng = np.random.default_rng((9, nodes))
    return rng.uniform(-1, 2, (nodes, nodes, nodes, 3)).astype(np.float32)


def colors_of(count: int, nodes: int) -> Float32:
    """Return colors inside and outside of the cube, at nodes, between two, and with equal rests."""
    rng = np.random.default_rng(10)
    inside = rng.uniform(-0.2, 1.2, (count, 3))
    at_nodes = rng.integers(0, nodes, (count // 4, 3)) / (nodes - 1)
    halves = rng.integers(0, 2 * nodes - 1, (count // 4, 3)) / (2 * nodes - 2)
    grays = np.repeat(rng.uniform(0, 1, (count // 4, 1)), 3, axis=1)
    corners = np.stack(np.meshgrid(*[[0.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    return np.concatenate((inside, at_nodes, halves, grays, corners)).astype(np.float32)


@check("color_table.cl")
def tables(bench: Bench, variant: Variant) -> Findings:
    """Compare colors after tables."""
    # A place is rounded twice, relative to the number of nodes; a sum has four terms.
    count, sizes = (300_000, (17, 65)) if bench.pictures else (5003, (2, 3, 33))
    for nodes in sizes:
        table, colors = table_of(nodes), colors_of(count, nodes)
        got, want = (
            backend.apply_table(backend.upload_table(table), colors) for backend in bench.both
        )
        tolerance = UNIT * (6 * nodes + 16) * float(np.abs(table).max())
        yield Finding(f"apply_table, {nodes} nodes", largest(got - want) / tolerance)
