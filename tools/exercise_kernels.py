r"""Run every kernel at small sizes on one device, in one kind of build.

Meant for a simulator that watches memory, races and uninitialized reads:

    PYOPENCL_NO_CACHE=1 oclgrind --log LOG --data-races --uninitialized \
        python tools/exercise_kernels.py Oclgrind BUILD

for each BUILD that the tool lists when called without one. The simulator exits 0 whatever
it finds: LOG must be empty; and it begins LOG anew with each context, hence one build a
run. Results are compared with NumPy.
"""

import itertools
import sys
import time
from dataclasses import replace
from typing import Any

import numpy as np
import pyopencl as cl

from clmorph.backends.interface import Operations
from clmorph.backends.opencl.backend import OpenCLOperations
from clmorph.backends.opencl.build import constants as build_constants
from clmorph.backends.opencl.build.constants import cpu_constants, gpu_constants, lanes_constants
from clmorph.backends.opencl.devices.find import raw_devices
from clmorph.backends.opencl.kernels.launches import Workspace
from clmorph.backends.opencl.verification.bench import Bench
from clmorph.backends.opencl.verification.fields import SIZES, colors_of, grid_case, table_of
from clmorph.backends.opencl.verification.layers import mean_cases, path_cases, scenes
from clmorph.backends.records import PlanTerms
from clmorph.measures.points import WeightedPoints
from clmorph.reference import NumPyOperations
from clmorph.transport._solver.batch import problem_of_many
from clmorph.transport._solver.coarse_grid import STORED_CHOICES, stored_grid
from clmorph.transport._solver.problem import Problem, State
from clmorph.transport._solver.steps import Steps, new_steps

#: Points of a tile on the simulator: of smaller ones few points fill several.
TILE = 32
#: All kinds of devices, with float64 and without, and with loops of any length or short ones.
BUILDS = {
    "scalar-16": replace(gpu_constants(16), tile=TILE, longest_loop=5000),
    "scalar-64-pairs": replace(gpu_constants(64), tile=TILE, group=32, precise=1, float64=0),
    "lanes": replace(lanes_constants(64), tile=TILE, group=8),
    "vector-16-pairs": replace(cpu_constants(16), tile=TILE, precise=1, float64=0),
}
#: Pixels of a picture, in two directions more than a bin and more than a work-item of a CPU takes.
CANVAS = 9, 18


def counts_of(tile: int) -> tuple[list[int], list[int]]:
    """Return the points of three problems, together two tiles, one tile, and a part of one each."""
    return [tile - 2, 1, tile + 7], [1, tile // 2 + 4, tile // 2 - 2]


def measures_of(tile: int, rng: np.random.Generator) -> list[WeightedPoints]:
    """Return two random measures of as many points as these problems."""
    sizes = map(sum, counts_of(tile))
    return [WeightedPoints(rng.random((n, 5)), np.full(n, 1 / n)) for n in sizes]


def iterated(
    operations: Operations, rho: tuple[float, float], precise: bool, tile: int
) -> list[np.ndarray]:
    """Run a few steps of the solver, and take one back."""
    measures = measures_of(tile, np.random.default_rng(2))
    steps = new_steps(Problem.between(operations, *measures, rho))
    return a_few_steps(steps, np.zeros(len(measures[1])), 0.05, precise)


def iterated_together(operations: Operations, tile: int) -> list[np.ndarray]:
    """Run a few steps of three problems, of which one stops and one takes a step back."""
    rng = np.random.default_rng(4)
    pairs = [
        tuple(WeightedPoints(rng.random((n, 5)), np.full(n, 1 / n)) for n in sizes)
        for sizes in zip(*counts_of(tile), strict=True)
    ]
    steps = new_steps(problem_of_many(operations, pairs, (0.3, 0.5)))
    steps.begin(np.zeros(sum(counts_of(tile)[1])), 0.05, False)
    for back in (np.zeros(3, bool), np.zeros(3, bool), np.array([True, False, False])):
        steps.update_rows()
        steps.take_back(back)
        steps.update_columns()
        steps.go_on(~back)
    steps.keep(np.array([0, 2]))
    steps.update_rows()
    steps.update_columns()
    return [*steps.potentials()]


def iterated_over_stored(
    operations: Operations, rho: tuple[float, float], tile: int
) -> list[np.ndarray]:
    """Do the same over stored pairs, with corrections."""
    rng, epsilon = np.random.default_rng(3), 0.05
    measures = measures_of(tile, rng)
    n, m = map(len, measures)
    problem = Problem.between(operations, *measures, rho)
    g = np.zeros(m)
    f, g, t_rows, _ = problem.half_step(0, g, problem.softmin(0, g, epsilon, False), epsilon)
    softmins = t_rows, problem.softmin(1, f, epsilon, False)
    grid = stored_grid(problem, State(f, g, *softmins, np.inf), epsilon, n * m, STORED_CHOICES)
    assert grid is not None
    grid.problem.center = grid.source.restrict(f, problem.a)
    corrections = [
        side.restrict(0.3 * epsilon * rng.random(size), np.ones(size))
        for side, size in ((grid.source, n), (grid.target, m))
    ]
    grid.problem.correct(*corrections, epsilon)
    own = grid.target.restrict(g, problem.b)
    *found, duals = a_few_steps(new_steps(grid.problem), own, epsilon, False)
    sides = grid.source, grid.target, grid.target
    return [*(of.points_of(x) for of, x in zip(sides, found, strict=True)), duals]


def a_few_steps(steps: Steps, g: np.ndarray, epsilon: float, precise: bool) -> list[np.ndarray]:
    """Iterate from g until products take more than one block, and take one extrapolation back."""
    steps.begin(g, epsilon, precise)
    for _ in range(7):
        steps.update_rows()
        steps.update_columns()
        steps.go_on(True)
    steps.update_rows()
    steps.take_back()
    _, dual = steps.update_rows()
    _, column_dual, _ = steps.update_columns()
    return [*steps.potentials(), np.array([dual, column_dual])]


def exercise(operations: Operations, tile: int = 64) -> list[np.ndarray]:
    """Every operation once, at sizes that divide nothing."""
    rng = np.random.default_rng(1)
    counts = tuple(map(np.array, counts_of(tile)))
    n, m = map(int, map(sum, counts))
    weights = rng.random(n)
    weights[::5] = 0
    rows = operations.upload(rng.random((n, 5)), weights)
    columns = operations.upload(rng.random((m, 5)), np.full(m, 1 / m))
    f, g = 0.1 * rng.random(n), 0.1 * rng.random(m)
    both = ((rows, columns), f, g), ((columns, rows), g, f)
    guesses = [operations.softmin(*clouds, potential, 0.01) for clouds, _, potential in both]
    exact = [operations.softmin(*clouds, potential, 0.01, True) for clouds, _, potential in both]
    results = [
        *guesses,
        *exact,
        operations.row_maxima(rows, columns, g, 0.01),
        operations.bounded_softmin(rows, columns, g, 0.01)[0],
        operations.bounded_softmin(columns, rows, f, 0.01)[0],
    ]
    results += iterated(operations, (0.3, 0.5), False, tile)
    results += iterated(operations, (np.inf, np.inf), True, tile)
    # Kernels branch on each side by itself, and on whether both sides are balanced.
    for rho in ((0.3, 0.5), (np.inf, np.inf)):
        results += iterated_over_stored(operations, rho, tile)
    # Three problems, then the outer two.
    points = [rng.random((size, 5)) for size in (n, m)]
    batches = [
        operations.upload_batch(own, np.full(len(own), 0.5), count)
        for own, count in zip(points, counts, strict=True)
    ]
    outer = [operations.take_batch(batch, np.array([0, 2])) for batch in batches]
    for own, potential in ((batches, g), (outer, np.delete(g, 1 + np.arange(counts[1][1])))):
        results += [
            operations.softmin(*own, potential, 0.01),
            operations.softmin(*own, potential, 0.01, True),
            operations.bounded_softmin(*own, potential, 0.01)[0],
        ]
    results += iterated_together(operations, tile)
    for (clouds, own, potential), guess in zip(both, guesses, strict=True):
        near = operations.near_pairs(*clouds, potential, guess, 0.01, 1e-7)
        results.append(np.array([float(near.skipped.max() <= 2e-7)]))
        for precise in (False, True):
            over_near = operations.softmin(*clouds, potential, 0.01, precise, near)
            results.append(np.round((over_near - guess) / 0.01, 2) + 0.0)
            results += operations.barycentric_projection(*clouds, potential, 0.01, precise, near)
            results += operations.plan_moments(*clouds, potential, guess, 0.01, precise, near)
        over_near, _ = operations.bounded_softmin(*clouds, potential, 0.01, near)
        results.append(np.round((over_near - guess) / 0.01, 2) + 0.0)
        thresholds = np.tile([0.1, 0.4, 0.9], (len(own), 1))
        draws = operations.sample_plan_rows(
            *clouds, potential, guess, 0.01, thresholds, False, near
        )
        results.append(np.array([float(draws.min() >= 0 and draws.max() < len(potential))]))
    for precise, (softmin, _) in ((False, guesses), (True, exact)):
        plan = PlanTerms(rows, columns, f, g, 0.01, np.full(n, -9.0), np.full(m, np.inf))
        kept = operations.plan_rows(plan, precise)
        results.append(kept.mass)
        results += operations.barycentric_projection(rows, columns, g, 0.01, precise)
        results += operations.plan_moments(rows, columns, g, softmin, 0.01, precise)
    for thresholds, near in (((-9.0, np.inf), None), ((-12.0, -14.0), 1e-9)):
        lists: list[Any] = [None, None]
        if near is not None:
            lists = [
                operations.near_pairs(*clouds, potential, guess, 0.01, near)
                for (clouds, _, potential), guess in zip(both, guesses, strict=True)
            ]
        limits = [np.full(size, x) for size, x in zip((n, m), thresholds, strict=True)]
        stored = operations.store_pairs(
            PlanTerms(rows, columns, f, g, 0.01, *limits), n * m, tuple(lists)
        )
        for change, by_column in ((g, False), (f, True)):
            sums = operations.sum_stored(stored, 10 * change, by_column)
            results.append(np.maximum(np.round(sums, 2), -99.0) + 0.0)
    thresholds = np.tile([0.1, 0.4, 0.9], (n, 1))
    draws = operations.sample_plan_rows(rows, columns, g, softmin, 0.01, thresholds)
    results.append(np.array([float(draws.max() < m)]))
    # Sums far above 1 make no draw beyond those of their row.
    draws = operations.sample_plan_rows(rows, columns, g, softmin + 0.1, 0.01, thresholds)
    results.append(np.array([float(draws.max() < m)]))
    results += [operations.edge_preserving_mean(*case) for case in mean_cases((7, 9)).values()]
    for name, case in path_cases((5, 6)).items():
        paths = operations.follow_paths(*case)
        # Where a field folds, rounding decides which way a path goes.
        results.append(np.isfinite(paths).astype(float) if name == "folding" else paths)
    results += [scene.draw(operations) for scene in scenes((11, 9)).values()]
    # Spacings, in the last column, are such that some widths are the base's, some less, some more.
    table = rng.random((40, 6)) * [1, 1, 1, 1, 1, 0.06] + [0, 0, 0, 0, 0, 0.05]
    links = rng.integers(0, 40, (60, 2)).astype(np.uint32)
    moving = operations.upload_particles(table, links, rng.random((60, 2)))
    splats = operations.advect(moving, 0.3, (18.0, 9.0), (9.0, 4.5))
    own = operations.adapt_widths(splats, 0.5 + rng.random(CANVAS), 0.7)
    results.append(operations.width_levels(own).astype(float))
    results += operations.deposit(splats, CANVAS)
    resting = operations.upload_splats(
        rng.uniform(-9, 25, (90, 2)).astype(np.float32),
        rng.random((90, 3)).astype(np.float32),
        rng.random(90).astype(np.float32),
    )
    results.append(operations.bin_splats(resting, CANVAS, 1).order.astype(float))
    # Trees of no and of three levels.
    seeds = rng.uniform(-9, 25, (140, 2)).astype(np.float32)
    for count in (1, 140):
        results.append(operations.nearest_seeds(seeds[:count], CANVAS).astype(float))
    for table in map(table_of, (2, 5)):
        on_device = operations.upload_table(table)
        results.append(operations.apply_table(on_device, colors_of(70, len(table))))
    for sizes, precise in itertools.product(SIZES, (False, True)):
        results.append(operations.grid_log_sum_exp(*grid_case(*sizes, 0.6), precise))
    for method in ("gather", "moments"):
        with Bench(operations).forced("splatting", "method", method):
            # Cells of half a pixel, and where widths differ, of one; of two pixels.
            results += operations.splat(own, CANVAS, 0.7, 3.8)
            results += operations.splat(resting, CANVAS, 2.7, 14.0)
    return [*results, *operations.splat(splats, CANVAS, 0.0, 0.5)]


def exercise_many_dimensions(operations: Operations) -> list[np.ndarray]:
    """Run what has programs of its own from 12 coordinates on, at two slices of them."""
    rng, epsilon = np.random.default_rng(5), 0.5
    clouds = [(rng.random((n, 18)), rng.integers(0, 2, n) / n) for n in (40, 35)]
    rows, columns = (operations.upload(*cloud) for cloud in clouds)
    # Moments are many: of rows there is a part of a tile.
    few = operations.upload(*(values[:20] for values in clouds[0]))
    f, g = 0.1 * rng.random(40), 0.1 * rng.random(35)
    results = [operations.row_maxima(rows, columns, g, epsilon),
               operations.bounded_softmin(rows, columns, g, epsilon)[0]]  # fmt: skip
    for precise in (False, True):
        softmin = operations.softmin(rows, columns, g, epsilon, precise)
        limits = np.full(40, -9.0), np.full(35, np.inf)
        results += [softmin, *operations.barycentric_projection(rows, columns, g, epsilon, precise)]
        results += operations.plan_moments(few, columns, g, softmin[:20], epsilon, precise)
        results.append(
            operations.plan_rows(PlanTerms(rows, columns, f, g, epsilon, *limits), precise).mass
        )
    return results


def keep_buffers() -> None:
    """Never release a buffer, nor use one again.

    Oclgrind 21.10 gives a released buffer's place to the next one, with the old one's size
    in its record of what is initialized, and then calls the rest uninitialized, as in
    barycentric_projection.cl, which with many coordinates reads what it has written.
    """
    kept, create = [], cl.Buffer

    def create_and_keep(*arguments: Any, **options: Any) -> cl.Buffer:
        kept.append(create(*arguments, **options))
        return kept[-1]

    cl.Buffer = create_and_keep
    Workspace.empty = lambda work, n_bytes: cl.Buffer(
        work.context, cl.mem_flags.READ_WRITE, max(4, n_bytes)
    )


def main(arguments: list[str]) -> int:
    if len(arguments) != 2 or arguments[1] not in BUILDS:
        print("\n".join(BUILDS))
        return 0 if not arguments else 2
    platform, build = arguments
    device = next((d for _, d in raw_devices() if platform in d.platform.name), None)
    if device is None:
        print(f"no OpenCL platform is called {platform!r}", file=sys.stderr)
        return 2
    keep_buffers()
    build_constants.MOMENT_CHUNK = 8  # so few particles come in several chunks
    began = time.perf_counter()
    wanted = exercise(NumPyOperations(), TILE) + exercise_many_dimensions(NumPyOperations())
    operations = OpenCLOperations(device, BUILDS[build], verify=False)
    operations.row_loop.device_levels = 0
    if not operations.has_float64:
        # Oclgrind 21.10 lacks an intrinsic that inlined functions of structs leave, as pairs are.
        # What these kernels read and write is the same in the build with float64.
        for name in ("start_iteration", "start_stored_iteration"):
            setattr(operations, name, lambda *_: None)
    got = exercise(operations, TILE) + exercise_many_dimensions(operations)
    for number, (ours, theirs) in enumerate(zip(got, wanted, strict=True)):
        np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-5, err_msg=str(number))
    print(f"{build}: {len(got)} results agree, {time.perf_counter() - began:.1f} s")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
