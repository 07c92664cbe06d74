"""Hold assignments, grids, barycenters and second derivatives to independent truths.

    python tools/random_problems.py --device intel [--count 200] [--seed 0] [--only assignments]

Each kind of problem is drawn at random, with ties, far groups, points in one place, masks, uneven
steps and reaches. What is found is compared with SciPy's exact solver, with the same problem over
points (NumPy, float64), with dense minimizations by L-BFGS, and with finite differences of
gradients. The worst errors are printed, as shares of what is allowed: above 1 the status is 1.
"""

import argparse
import time
import warnings
from collections.abc import Callable

import numpy as np
from scipy.optimize import linear_sum_assignment, minimize
from scipy.spatial.distance import cdist

import clmorph

FIELDS = ("source_points", "source_weights", "target_points", "target_weights")
#: Errors, as shares of what is allowed.
Errors = dict[str, float]


def clouds(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return two clouds of some kind, of some sizes, dimensions and scales."""
    n, d = int(rng.integers(1, 260)), int(rng.integers(1, 7))
    m = n + int(rng.integers(0, 120)) * (rng.random() < 0.4)
    kind = rng.integers(6)
    if kind == 0:
        x, y = rng.random((n, d)), rng.random((m, d)) ** 2
    elif kind == 1:  # few places, as of pictures with flat colors
        x, y = rng.integers(0, 4, (n, d)) * 1.0, rng.integers(0, 4, (m, d)) * 1.0
    elif kind == 2:  # far groups of other sizes
        centers = rng.random((4, d)) * 10
        x, y = (centers[rng.integers(0, 4, k)] + 0.01 * rng.random((k, d)) for k in (n, m))
    elif kind == 3:
        x = rng.random((n, d))
        y = np.vstack((x, rng.random((m - n, d))))[rng.permutation(m)]
    elif kind == 4:  # heavy tails, far apart
        x, y = rng.standard_normal((n, d)), rng.standard_normal((m, d)) ** 3 + 100
    else:  # pixels of two colors
        side = int(rng.integers(2, 15))
        places = np.stack(np.indices((side, side)), -1).reshape(-1, 2) / side
        x, y = (np.column_stack((places, rng.random(side**2) < rng.random())) for _ in range(2))
    scale = 10.0 ** rng.integers(-3, 4)
    return x * scale, y * scale


def assignments(rng: np.random.Generator, device: str) -> Errors:
    """Compare cost, bound and prices with SciPy's; 1e-12 of the mean cost is allowed."""
    x, y = clouds(rng)
    weights = rng.random(len(x)) + 1e-3 if len(x) <= len(y) and rng.random() < 0.2 else None
    gap = float(rng.choice([0.0, 0.0, 0.01]))
    if weights is None and rng.random() < 0.3:
        x, y = y, x
    found = clmorph.assignment(x, y, weights=weights, gap=gap, backend=device)
    costs = cdist(x, y, "sqeuclidean") / 2
    costs = costs / min(costs.shape) if weights is None else costs * weights[:, None]
    best = costs[linear_sum_assignment(costs)].sum()
    allowed = 1e-12 * (costs.mean() * min(costs.shape) + best) + 1e-300
    f, g = found.prices
    distinct = len(set(found.rows)) == len(set(found.columns)) == min(costs.shape)
    own = costs[found.rows, found.columns].sum()
    return {
        "cost above the cheapest": (own - (1 + gap) * best) / allowed,
        "cost as reported": abs(found.cost - own) / allowed,
        "bound above the cheapest": (found.bound - best) / allowed,
        "prices above a pair's cost": float((f[:, None] + g - costs).max()) / allowed,
        "one to one": 0.0 if distinct else np.inf,
    }


def grids(rng: np.random.Generator) -> tuple[clmorph.Grid, clmorph.Grid]:
    """Return two grids of 1 to 3 axes, with empty and masked cells and steps of their own."""
    made, dimension = [], int(rng.integers(1, 4))
    most = (0, 40, 9, 5)[dimension]
    for _ in range(2):
        shape = rng.integers(1, most + 1, dimension)
        masses = rng.random(shape) ** 3 * (rng.random(shape) < 0.8)
        mask = rng.random(shape) < 0.8
        mask.flat[0], masses.flat[0] = True, 0.5
        masses = masses / masses[mask].sum()
        masses[~mask] = np.nan
        axes = [np.cumsum(rng.random(k) + 0.1) / most * rng.choice([-1, 1]) for k in shape]
        made.append(clmorph.grid_measure(masses, axes=axes, mask=mask))
    return made[0], made[1]


def fields(rng: np.random.Generator, device: str) -> Errors:
    """Compare a transport between grids with that between their cells as points."""
    pair = grids(rng)
    blur, reach = float(rng.uniform(0.1, 0.4)), (None, 0.3, 1.5)[rng.integers(3)]
    options = {"blur": blur, "reach": reach, "tol": 1e-7}
    there = [grid.weights > 0 for grid in pair]
    points = [(g.weights[kept], g.points[kept]) for g, kept in zip(pair, there, strict=True)]
    found = clmorph.sinkhorn(*pair, backend=device, **options)
    want = clmorph.sinkhorn(*points, backend="numpy", **options)
    moved = clmorph.displacement_field(*pair, found, backend=device)
    plan = clmorph.transport_plan(*points, want, backend="numpy", relative=1e-13).toarray()
    x, y = (each[1] for each in points)
    means = plan @ y / np.maximum(plan.sum(axis=1), 1e-300)[:, None] - x
    field = moved.field.reshape(-1, x.shape[1])
    size = np.ptp(np.vstack((x, y))) + blur
    sides = (found.row_mass[there[0]], found.column_mass[there[1]]), (plan.sum(1), plan.sum(0))
    one, other = (clmorph.sinkhorn_divergence(*each, backend=name, **options)
                  for each, name in ((pair, device), (points, "numpy")))  # fmt: skip
    apart = max(one.interval[0] - other.interval[1], other.interval[0] - one.interval[1])
    rounding = 1e-12 * (abs(float(other)) + blur**2)
    massive = plan.sum(axis=1) > 1e-9 * plan.sum()
    return {
        "masses": max(np.abs(u - v).sum() for u, v in zip(*sides, strict=True)) / 1e-5,
        "displacements": np.abs(field[there[0]] - means)[massive].max(initial=0.0) / size / 1e-5,
        "field of empty cells": 0.0 if not field[~there[0]].any() else np.inf,
        "cost": abs(moved.cost - (plan * cdist(x, y, "sqeuclidean") / 2).sum()) / size**2 / 1e-5,
        "bounds of the value apart": max(found.dual - want.primal, want.dual - found.primal)
        / (1e-12 * (abs(want.dual) + blur**2)),
        "intervals of divergences apart": apart / rounding,
    }


def means(rng: np.random.Generator, device: str) -> Errors:
    """Compare the barycenter of two grids with that of their cells as points."""
    pair = grids(rng)
    debias = bool(rng.integers(2))
    share = float(rng.uniform(0.1, 0.9))
    options = {"weights": [share, 1 - share], "fixed": True, "blur": 0.3, "tol": 1e-3,
               "debias": debias, "max_iter": 50, "reach": (None, 0.5)[rng.integers(2)]}  # fmt: skip
    support = pair[0].points[(kept := pair[0].mask.ravel() if pair[0].mask is not None else ...)]
    points = [(grid.weights, grid.points) for grid in pair]
    found = clmorph.barycenter(pair, support=pair[0], backend=device, **options)
    want = clmorph.barycenter(points, support=support, backend="numpy", **options)
    error = np.abs(found.weights[kept] - want.weights).sum() / want.weights.sum()
    outside = found.weights.sum() - found.weights[kept].sum()
    return {"weights": error / 1e-4, "mass outside of the mask": outside / 1e-15}


def dense_transport(
    log_a: np.ndarray, log_b: np.ndarray, costs: np.ndarray, epsilon: float, rho: float,
    log_u: np.ndarray,
) -> tuple[float, np.ndarray]:  # fmt: skip
    """Return the value of transport with the entropy relative to u x b, and exp(-f / rho)."""
    a, b, kernel = np.exp(log_a), np.exp(log_b), np.exp(-costs / epsilon)
    q, rest, scale = rho / (rho + epsilon), np.exp(log_u - log_a), np.ones(len(a))
    for _ in range(50_000):
        other = (kernel.T @ (a * rest * scale)) ** -q
        last, scale = scale, (rest * (kernel @ (b * other))) ** -q
        ratio = (a @ scale ** (-epsilon / rho)) / (b @ other ** (-epsilon / rho))
        scale = scale * ratio ** (rho / epsilon / 2)
        other = other / ratio ** (rho / epsilon / 2)
        if np.abs(scale / last - 1).max() < 1e-13:
            break
    mass = (a * rest * scale) @ kernel @ (b * other)
    f, g = epsilon * np.log(scale), epsilon * np.log(other)
    penalties = -rho * (a @ np.expm1(-f / rho) + b @ np.expm1(-g / rho))
    return penalties - epsilon * (mass - np.exp(log_u).sum() * b.sum()), np.exp(-f / rho)


def masses(rng: np.random.Generator, device: str) -> Errors:
    """Compare a barycenter with a reach on a fixed support with a dense minimization by L-BFGS."""
    n, count, d = (int(each) for each in rng.integers((1, 1, 1), (10, 4, 4)))
    x = rng.random((n, d))
    points = [rng.random((rng.integers(1, 12), d)) for _ in range(count)]
    weights = [(rng.random(len(y)) + 0.05) * 10 ** rng.uniform(-1, 1) for y in points]
    shares = rng.dirichlet(np.ones(count))
    epsilon = rng.uniform(0.2, 0.4) ** 2
    # Below the blur a debiased one converges slowly, as the page of the solver says.
    rho = max(float(rng.choice([0.1, 0.3, 1.0])) ** 2, epsilon)
    debias = bool(rng.integers(2))
    costs = [cdist(x, y, "sqeuclidean") / 2 for y in (*points, x)]
    log_u = np.full(n, np.log(shares @ [each.sum() for each in weights] / n))

    def aim(log_a: np.ndarray) -> tuple[float, np.ndarray]:
        """Return what is minimized, and its derivatives by the logarithms of the masses."""
        a, value, slope = np.exp(log_a), 0.0, np.zeros(n)
        for share, b, cost in zip(shares, weights, costs, strict=False):
            reference = log_a if debias else log_u
            transport, left = dense_transport(log_a, np.log(b), cost, epsilon, rho, reference)
            value += share * (transport + debias * epsilon / 2 * (a.sum() - b.sum()) ** 2)
            slope += share * (rho + debias * epsilon) * (1 - left)
        if debias:
            transport, left = dense_transport(log_a, log_a, costs[-1], epsilon, rho, log_a)
            value -= transport / 2
            slope -= (rho + epsilon) * (1 - left)
        return value, slope * a

    found = clmorph.barycenter(
        list(zip(weights, points, strict=True)), shares, x, epsilon=epsilon, rho=rho, fixed=True,
        debias=debias, tol=1e-6, max_iter=20_000, backend=device,
    )  # fmt: skip
    # From even masses a search may stop at a point with almost no mass, which could grow again.
    starts = log_u, np.log(found.weights)
    # Steps of a search farther away would overflow.
    searches = [
        minimize(aim, start, jac=True, method="L-BFGS-B", bounds=log_u[:, None] + (-30, 8),
                 options={"maxiter": 300, "ftol": 1e-15, "gtol": 1e-10})
        for start in starts
    ]  # fmt: skip
    best = min(searches, key=lambda each: each.fun)
    own, mass = aim(np.log(found.weights))[0], np.exp(best.x).sum()
    return {
        "aim above the least": (own - best.fun) / ((rho + epsilon) * mass) / 1e-5,
        "mass": abs(found.mass / mass - 1) / 1e-3,
    }


def seconds(rng: np.random.Generator, device: str) -> Errors:
    """Compare Hessian-vector products with differences of gradients: 1e-6, 1e-3 on devices."""
    n, m, d = (int(each) for each in rng.integers((2, 2, 1), (8, 8, 4)))
    balanced, divergence = rng.random() < 0.5, rng.random() < 0.5
    parts = [rng.random((n, d)), rng.random(n) + 0.5, rng.random((m, d)), rng.random(m) + 0.5]
    change = [rng.standard_normal(each.shape) for each in parts]
    if balanced:
        for k in (1, 3):
            parts[k] /= parts[k].sum()
            change[k] -= change[k].mean()
    options = {"blur": float(rng.uniform(0.25, 0.5)), "reach": None if balanced else 0.6,
               "max_iter": 20_000}  # fmt: skip

    def derived(of: list, tol: float, backend: str) -> tuple:
        pair = (of[1], of[0]), (of[3], of[2])
        if divergence:
            solved = clmorph.sinkhorn_divergence(
                *pair, **options, tol=tol, gradient=True, backend=backend
            )
            return pair, solved, solved.gradient
        solved = clmorph.sinkhorn(*pair, **options, tol=tol, backend=backend)
        return pair, solved, clmorph.gradient(*pair, solved, backend=backend)

    step, wanted = 4e-4, [0.0] * 4
    # Four points, so that the difference's own error is of the step's fourth power.
    for factor, weight in ((1, 8), (-1, -8), (2, -1), (-2, 1)):
        moved = [p + factor * step * c for p, c in zip(parts, change, strict=True)]
        there = derived(moved, 1e-12, "numpy")[2]
        for k, name in enumerate(FIELDS):
            wanted[k] = wanted[k] + weight * getattr(there, name) / (12 * step)
    size = max(np.abs(each).max() for each in wanted)
    errors = {}
    for backend, tol, allowed in (("numpy", 1e-12, 1e-6), (device, 1e-6, 1e-3)):
        pair, solved, _ = derived(parts, tol, backend)
        found = clmorph.hessian_product(*pair, solved, clmorph.Gradient(*change))
        error = max(np.abs(getattr(found, name) - wanted[k]).max() for k, name in enumerate(FIELDS))
        errors[f"from {'NumPy' if backend == 'numpy' else 'the device'}"] = error / size / allowed
    return errors


KINDS: dict[str, Callable[[np.random.Generator, str], Errors]] = {
    "assignments": assignments, "grids": fields, "barycenters": means, "reaches": masses,
    "second": seconds,
}  # fmt: skip


def worst(kind: str, count: int, device: str, seed: int = 0) -> dict[str, tuple[float, int]]:
    """Return the largest share of what is allowed, and the number of its problem, by error."""
    found: dict[str, tuple[float, int]] = {}
    for number in range(seed, seed + count):
        with warnings.catch_warnings(action="ignore", category=clmorph.ConvergenceWarning):
            try:
                errors = KINDS[kind](np.random.default_rng(number), device)
            except clmorph.ClmorphError as error:
                errors = {f"refused ({error})": np.inf}
        for name, error in errors.items():
            share = np.inf if np.isnan(error) else float(error)
            found[name] = max(found.get(name, (-np.inf, number)), (share, number))
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="auto", help="a backend [default: auto]")
    parser.add_argument("--count", type=int, default=200, help="of problems of each kind")
    parser.add_argument("--seed", type=int, default=0, help="of the first problem")
    parser.add_argument("--only", choices=KINDS, nargs="+", default=list(KINDS))
    given = parser.parse_args()
    failed = False
    for kind in given.only:
        began = time.perf_counter()
        found = worst(kind, given.count, given.device, given.seed)
        print(f"{kind}: {given.count} problems, {time.perf_counter() - began:.0f} s")
        for name, (share, number) in found.items():
            print(f"  {name}: at most {max(share, 0.0):.2g} of what is allowed (seed {number})")
            failed |= share > 1
    return int(failed)


if __name__ == "__main__":
    raise SystemExit(main())
