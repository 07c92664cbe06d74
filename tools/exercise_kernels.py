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
from clmorph.backends.opencl.verification.fields import SIZES, colors_of, grid_case, table_of
from clmorph.backends.opencl.verification.layers import mean_cases, path_cases, scenes
from clmorph.backends.records import PlanTerms
from clmorph.measures.points import WeightedPoints
from clmorph.reference import NumPyOperations
from clmorph.transport._solver.batch import problem_of_many
from clmorph.transport._solver.coarse_grid import STORED_CHOICES, stored_grid
from clmorph.transport._solver.problem import Problem
from clmorph.transport._solver.steps import Steps, new_steps

#: All kinds of devices, with float64 and without, and with loops of any length or short ones.
BUILDS = {
    "scalar-16": replace(gpu_constants(16), longest_loop=7000),
    "scalar-64-pairs": replace(gpu_constants(64), precise=1, float64=0),
    "lanes": lanes_constants(64),
    "vector-16-pairs": replace(cpu_constants(16), precise=1, float64=0),
}


def iterated(operations: Operations, rho: tuple[float, float], precise: bool) -> list[np.ndarray]:
    """Run a few steps of the solver, and take one back."""
    rng = np.random.default_rng(2)
    measures = [WeightedPoints(rng.random((n, 5)), np.full(n, 1 / n)) for n in (130, 67)]
    steps = new_steps(Problem.between(operations, *measures, rho))
    return a_few_steps(steps, np.zeros(67), 0.05, precise)


def iterated_together(operations: Operations) -> list[np.ndarray]:
    """Run a few steps of three problems, of which one stops and one takes a step back."""
    rng = np.random.default_rng(4)
    pairs = [
        tuple(WeightedPoints(rng.random((n, 5)), np.full(n, 1 / n)) for n in sizes)
        for sizes in ((60, 1), (1, 40), (69, 26))
    ]
    steps = new_steps(problem_of_many(operations, pairs, (0.3, 0.5)))
    steps.begin(np.zeros(67), 0.05, False)
    for back in (np.zeros(3, bool), np.zeros(3, bool), np.array([True, False, False])):
        steps.update_rows()
        steps.take_back(back)
        steps.update_columns()
        steps.go_on(~back)
    steps.keep(np.array([0, 2]))
    steps.update_rows()
    steps.update_columns()
    return [*steps.potentials()]


def iterated_over_stored(operations: Operations, rho: tuple[float, float]) -> list[np.ndarray]:
    """Do the same over stored pairs, with corrections."""
    rng, epsilon = np.random.default_rng(3), 0.05
    measures = [WeightedPoints(rng.random((n, 5)), np.full(n, 1 / n)) for n in (130, 67)]
    problem = Problem.between(operations, *measures, rho)
    g = np.zeros(67)
    f, g, t_rows, _ = problem.half_step(0, g, problem.softmin(0, g, epsilon, False), epsilon)
    softmins = t_rows, problem.softmin(1, f, epsilon, False)
    grid = stored_grid(problem, f, g, softmins, epsilon, 130 * 67, STORED_CHOICES)
    assert grid is not None
    grid.problem.center = grid.source.restrict(f, problem.a)
    corrections = [
        side.restrict(0.3 * epsilon * rng.random(size), np.ones(size))
        for side, size in ((grid.source, 130), (grid.target, 67))
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


def exercise(operations: Operations) -> list[np.ndarray]:
    """Every operation once, at sizes that divide nothing."""
    rng = np.random.default_rng(1)
    n, m = 130, 67
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
    results += iterated(operations, (0.3, 0.5), precise=False)
    results += iterated(operations, (np.inf, np.inf), precise=True)
    # Kernels branch on each side by itself, and on whether both sides are balanced.
    for rho in ((0.3, 0.5), (np.inf, np.inf)):
        results += iterated_over_stored(operations, rho)
    # Three problems, then the outer two.
    counts = np.array([60, 1, 69]), np.array([1, 40, 26])
    points = [rng.random((size, 5)) for size in (n, m)]
    batches = [
        operations.upload_batch(own, np.full(len(own), 0.5), count)
        for own, count in zip(points, counts, strict=True)
    ]
    outer = [operations.take_batch(batch, np.array([0, 2])) for batch in batches]
    for own, potential in ((batches, g), (outer, np.delete(g, range(1, 41)))):
        results += [
            operations.softmin_batch(*own, potential, 0.01),
            operations.softmin_batch(*own, potential, 0.01, True),
            operations.bounded_softmin_batch(*own, potential, 0.01)[0],
        ]
    results += iterated_together(operations)
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
    moving = operations.upload_particles(
        rng.random((40, 6)), rng.integers(0, 40, (150, 2)).astype(np.uint32), rng.random((150, 2))
    )
    splats = operations.advect(moving, 0.3, (20.0, 15.0), (10.0, 7.5))
    own = operations.adapt_widths(splats, 4 * rng.random((16, 21)), 1.3)
    results.append(operations.width_levels(own).astype(float))
    results += operations.deposit(splats, (16, 21))
    resting = operations.upload_splats(
        rng.uniform(-9, 30, (90, 2)).astype(np.float32),
        rng.random((90, 3)).astype(np.float32),
        rng.random(90).astype(np.float32),
    )
    results.append(operations.bin_splats(resting, (16, 21), 1).order.astype(float))
    seeds = rng.uniform(-9, 30, (190, 2)).astype(np.float32)
    for count in (1, 190):
        results.append(operations.nearest_seeds(seeds[:count], (16, 21)).astype(float))
    for table in map(table_of, (2, 5)):
        on_device = operations.upload_table(table)
        results.append(operations.apply_table(on_device, colors_of(70, len(table))))
    for sizes, precise in itertools.product(SIZES, (False, True)):
        results.append(operations.grid_log_sum_exp(*grid_case(*sizes, 0.6), precise))
    for method in ("gather", "moments"):
        if isinstance(operations, OpenCLOperations):
            operations.splatting.method = method
        results += operations.splat(splats, (16, 21), 1.3, 7.0)
        results += operations.splat(splats, (16, 21), 0.0, 0.5)
        results += operations.splat(own, (16, 21), 1.3, 7.0)
        results += operations.splat(resting, (16, 21), 0.7, 4.0)
        results += operations.splat(resting, (16, 21), 3.0, 15.0)
    return results


def exercise_many_dimensions(operations: Operations) -> list[np.ndarray]:
    """Run what has programs of its own from 12 coordinates on, at two slices of them."""
    rng, epsilon = np.random.default_rng(5), 0.5
    clouds = [(rng.random((n, 18)), rng.integers(0, 2, n) / n) for n in (90, 67)]
    rows, columns = (operations.upload(*cloud) for cloud in clouds)
    # Moments are many, and a quarter of the simulator's time: of rows there is one tile.
    few = operations.upload(*(values[:50] for values in clouds[0]))
    f, g = 0.1 * rng.random(90), 0.1 * rng.random(67)
    results = [operations.row_maxima(rows, columns, g, epsilon),
               operations.bounded_softmin(rows, columns, g, epsilon)[0]]  # fmt: skip
    for precise in (False, True):
        softmin = operations.softmin(rows, columns, g, epsilon, precise)
        limits = np.full(90, -9.0), np.full(67, np.inf)
        results += [softmin, *operations.barycentric_projection(rows, columns, g, epsilon, precise)]
        results += operations.plan_moments(few, columns, g, softmin[:50], epsilon, precise)
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
    build_constants.MOMENT_CHUNK = 16  # so few particles come in several chunks
    began = time.perf_counter()
    wanted = exercise(NumPyOperations()) + exercise_many_dimensions(NumPyOperations())
    operations = OpenCLOperations(device, BUILDS[build], verify=False)
    operations.row_loop.device_levels = 0
    if not operations.has_float64:
        # Oclgrind 21.10 lacks an intrinsic that inlined functions of structs leave, as pairs are.
        # What these kernels read and write is the same in the build with float64.
        for name in ("start_iteration", "start_stored_iteration"):
            setattr(operations, name, lambda *_: None)
    got = exercise(operations) + exercise_many_dimensions(operations)
    for number, (ours, theirs) in enumerate(zip(got, wanted, strict=True)):
        np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-5, err_msg=str(number))
    print(f"{build}: {len(got)} results agree, {time.perf_counter() - began:.1f} s")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
