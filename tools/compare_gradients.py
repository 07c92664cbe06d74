r"""Measure what gradients cost, and compare them with those of other libraries, in one run.

    pip install -e ".[cpu,bench]"
    python tools/compare_gradients.py

The first table has the time of the derivatives by one side (one pass over all pairs) in softmins of
the same clouds, the best of many turns. The second one has batches of losses with their gradients
beside a loop. The third one compares gradients by points and by weights with central differences
of the value in float64, with those that JAX finds for OTT-JAX and PyTorch for POT, and with
GeomLoss's: the largest difference relative to the largest component, after conventions are
translated, and where that is large the factor between both (least squares). Libraries that are not
installed are left out.
"""

import argparse
import importlib.util
import time
import warnings
from collections.abc import Callable, Iterator

import numpy as np

import clmorph
from clmorph.backends.opencl.devices.find import find_devices
from clmorph.transport._solver.plan_softmin import row_projection, uploaded

BLUR, REACH = 0.1, 0.3
#: Central differences: the step, and the number of components that are compared.
STEP, COMPONENTS = 1e-4, 12
BY = "source_points", "source_weights"


def clouds(n: int, m: int, dimension: int, balanced: bool, seed: int = 0):
    """Return two random clouds with weights of unequal sizes."""
    rng = np.random.default_rng(seed)
    a, b = rng.uniform(0.5, 1.5, n), rng.uniform(0.5, 1.5, m)
    a, b = a / a.sum(), b / b.sum() * (1.0 if balanced else 1.2)
    return (a, rng.random((n, dimension))), (b, 0.2 + rng.random((m, dimension)))


def line(*cells) -> str:
    return "| " + " | ".join(str(cell) for cell in cells) + " |"


def in_turns(functions: list[Callable[[], object]], rounds: int) -> list[float]:
    """Return the least time of each function; they take turns, so that all see the same load."""
    least = [np.inf] * len(functions)
    for _ in range(rounds + 1):
        for number, function in enumerate(functions):
            began = time.perf_counter()
            function()
            least[number] = min(least[number], time.perf_counter() - began)
    return least


# --- what they cost ---------------------------------------------------------------------------


def side_in_softmins(operations, n: int, dimension: int, rounds: int) -> float:
    """Return the time of the derivatives by one side over that of a softmin."""
    pair = tuple(clmorph.WeightedPoints(x, a) for a, x in clouds(n, n, dimension, False))
    both = uploaded(operations, pair[0]), uploaded(operations, pair[1])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", clmorph.ConvergenceWarning)
        solved = clmorph.sinkhorn(*pair, BLUR, REACH, 1e-3, 50, operations)
    given = solved.g, solved.epsilon, solved.precise
    softmin, side = in_turns(
        [
            lambda: operations.softmin(*both, *given),
            lambda: row_projection(operations, both, pair, solved),
        ],
        rounds,
    )
    return side / softmin


def cost_of_a_side(devices: list, points: list[int], dimensions: list[int], rounds: int) -> None:
    """Print the derivatives by one side in softmins."""
    print(f"\nDerivatives by one side, in softmins, blur {BLUR:g}, reach {REACH:g}\n")
    print(line("device", *(f"{n} points in {d}D" for n in points for d in dimensions)))
    print(line(*["---"] * (1 + len(points) * len(dimensions))))
    for device in devices:
        operations = clmorph.get_backend(device.index)
        cells = [
            f"{side_in_softmins(operations, n, dimension, rounds):.2f}"
            for n in points
            for dimension in dimensions
        ]
        print(line(f"{device.name}, {device.platform} {device.driver}", *cells))


def loop_and_batch(operations, count: int, n: int, rounds: int) -> list[float]:
    """Return the times of divergences with gradients, one by one and at once."""
    pairs = [clouds(n, n, 3, False, seed) for seed in range(count)]
    sources, targets = zip(*pairs, strict=True)
    options = {"tol": 1e-6, "gradient": True, "backend": operations}
    given = BLUR, REACH
    return in_turns(
        [
            lambda: [clmorph.sinkhorn_divergence(*pair, *given, **options) for pair in pairs],
            lambda: clmorph.sinkhorn_divergence_batch(sources, targets, *given, **options),
        ],
        rounds,
    )


def batches(devices: list, rounds: int) -> None:
    """Print the time of batches of divergences with gradients beside a loop."""
    print("\nDivergences with gradients, tol 10⁻⁶: ms a problem\n")
    print(line("device", "problems", "loop", "batch", "ratio"))
    print(line(*["---"] * 5))
    for device in devices:
        operations = clmorph.get_backend(device.index)
        for count, n in ((64, 64), (16, 256), (8, 1024)):
            loop, batch = loop_and_batch(operations, count, n, rounds)
            cells = (
                f"{1e3 * loop / count:.3g}",
                f"{1e3 * batch / count:.3g}",
                f"{loop / batch:.1f}×",
            )
            name = f"{device.name}, {device.platform}"
            print(line(name, f"{count} of {n} × {n}", *cells), flush=True)


# --- what they are ----------------------------------------------------------------------------


def value(source, target, reach) -> float:
    """Return the transport value with its constant, of a solve in float64."""
    options = {"tol": 1e-11, "max_iter": 10**5, "backend": "numpy"}
    return clmorph.sinkhorn(source, target, BLUR, reach, **options).dual


def differences(source, target, reach) -> tuple[np.ndarray, np.ndarray]:
    """Return central differences of the value for some components; NaN for the others."""
    found = []
    for number in (1, 0):
        part = source[number]
        result = np.full(part.shape, np.nan)
        flat = list(np.ndindex(part.shape))[:COMPONENTS]
        for place in flat:
            values = []
            for step in (STEP, -STEP):
                moved = part.copy()
                moved[place] += step
                if number == 0 and reach is None:
                    moved[np.arange(len(part)) != place[0]] -= step / (len(part) - 1)
                ends = (source[0], moved) if number else (moved, source[1])
                values.append(value(ends, target, reach))
            result[place] = (values[0] - values[1]) / (2 * STEP)
            if number == 0 and reach is None:
                result[place] *= (len(part) - 1) / len(part)  # of weights with the mean 0
        found.append(result)
    return found[0], found[1]


def ott(source, target, reach):
    """OTT-JAX's value, differentiated by JAX; its cost is twice ours.

    Its unbalanced problem takes the entropy of the plan itself, so that weights to the power of
    1 + epsilon / rho give our plan; its value by weights is then another function.
    """
    import jax

    jax.config.update("jax_enable_x64", True)
    from ott.geometry.pointcloud import PointCloud
    from ott.problems.linear.linear_problem import LinearProblem
    from ott.solvers.linear.sinkhorn import Sinkhorn

    tau = 1.0 if reach is None else reach**2 / (reach**2 + BLUR**2)
    b, y = target

    power = 1.0 if reach is None else 1 + BLUR**2 / reach**2
    b = b**power

    def of(x, a):
        geometry = PointCloud(x, y, epsilon=2 * BLUR**2)
        problem = LinearProblem(geometry, a, b, tau_a=tau, tau_b=tau)
        return Sinkhorn(threshold=1e-9, max_iterations=20_000)(problem).reg_ot_cost

    x, a = (np.asarray(each) / 2 for each in jax.grad(of, (0, 1))(source[1], source[0] ** power))
    return x, a if reach is None else None


def pot(source, target, reach):
    """POT's solve, differentiated by PyTorch through all iterations; its cost is twice ours.

    The value is formed from its plan, because POT 0.9.7 returns 0 as the value of unbalanced
    problems that have converged.
    """
    import ot
    import torch

    a, x, b, y = (torch.tensor(each) for pair in (source, target) for each in pair)
    x.requires_grad_()
    a.requires_grad_()
    options = {} if reach is None else {"unbalanced": 2 * reach**2, "unbalanced_type": "KL"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        solved = ot.solve_sample(
            x, y, a, b, reg=2 * BLUR**2, reg_type="KL", tol=1e-12, max_iter=20_000, **options
        )
    plan = solved.plan

    def divergence(p, q):
        return (p * (p / q).log() - p + q).sum()

    found = (0.5 * torch.cdist(x, y) ** 2 * plan).sum() + BLUR**2 * divergence(plan, a[:, None] * b)
    if reach is not None:
        found = found + reach**2 * (divergence(plan.sum(1), a) + divergence(plan.sum(0), b))
    found.backward()
    return x.grad.numpy(), a.grad.numpy()


def geomloss(source, target, reach):
    """GeomLoss's value without debiasing, with its gradient."""
    import torch
    from geomloss import SamplesLoss

    a, x, b, y = (torch.tensor(each) for pair in (source, target) for each in pair)
    x.requires_grad_()
    a.requires_grad_()
    loss = SamplesLoss(blur=BLUR, reach=reach, scaling=0.999, debias=False, backend="tensorized")
    loss(a, x, b, y).backward()
    return x.grad.numpy(), a.grad.numpy()


CONTESTANTS = {
    "central differences": ("numpy", differences),
    "OTT-JAX": ("ott", ott),
    "POT": ("ot", pot),
    "GeomLoss": ("geomloss", geomloss),
}


def compared(points: int) -> Iterator[tuple[str, str, str, str]]:
    """Yield rows of the table of differences."""
    for reach in (None, REACH):
        source, target = clouds(points, points + 7, 3, reach is None)
        solved = clmorph.sinkhorn(source, target, BLUR, reach, 1e-6, 10**4, "numpy")
        ours = clmorph.gradient(source, target, solved, backend="numpy")
        what = "balanced" if reach is None else f"reach {reach:g}"
        for name, (module, function) in CONTESTANTS.items():
            if importlib.util.find_spec(module) is None:
                continue
            cells = []
            for mine, found in zip(
                (getattr(ours, each) for each in BY), function(source, target, reach), strict=True
            ):
                if found is None:
                    cells.append("–")
                    continue
                there = np.isfinite(found)
                if mine.ndim == 1 and reach is None and name != "central differences":
                    found = found - found.mean()
                elif mine.ndim == 1 and name != "central differences":
                    # Values may differ by what depends on the masses alone.
                    shift = np.mean((mine - found)[there])
                    found = found + (shift if np.ptp((mine - found)[there]) < 1e-6 else 0.0)
                mine, found = mine[there], found[there]
                off = np.abs(mine - found).max() / np.abs(mine).max()
                factor = float(np.vdot(mine, found) / np.vdot(mine, mine))
                cells.append(f"{off:.1e}" + (f" (factor {factor:.4f})" if off > 1e-3 else ""))
            yield what, name, *cells


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, nargs="+", default=[4096, 16384])
    parser.add_argument("--dimensions", type=int, nargs="+", default=[2, 3, 5])
    parser.add_argument("--compared", type=int, default=60, help="points of the third table")
    parser.add_argument("--rounds", type=int, default=9)
    options = parser.parse_args()
    devices = [device for device in find_devices() if device.usable]
    cost_of_a_side(devices, options.points, options.dimensions, options.rounds)
    batches(devices, max(1, options.rounds // 3))
    print("\nGradients of the transport value, relative to the largest component\n")
    print(line("problem", "compared with", "by points", "by weights"))
    print(line(*["---"] * 4))
    for row in compared(options.compared):
        print(line(*row), flush=True)


if __name__ == "__main__":
    main()
