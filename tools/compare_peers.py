"""Compare clmorph's transport with that of POT and OTT-JAX, each in its own conventions.

    python tools/compare_peers.py --device numpy --device 0:0
    python tools/compare_peers.py --seed 0 --only 17

Random problems, balanced, unbalanced, on one side and with two reaches, are solved by each method
of each library to a small threshold, and by clmorph. The cost is |x - y|^2 / 2, so epsilon and rho
are the same numbers everywhere. POT takes the entropy against a x b as clmorph does, or, by its
``reg_type="entropy"``, against the counting measure, as OTT-JAX always does: then epsilon log a and
epsilon log b are added to the cost. POT's balanced log u is f / epsilon + log a. A plan may differ
by `TOLERANCE` of its mass, and so may its potentials in units of epsilon. GeomLoss's own results
stand in the tests (`geomloss_reference.py`). A library that is not installed is left out (``pip
install -e ".[bench]"``). Exit codes: 0 all agree; 1 something does not; 2 a mistake in the command
line, or no library.
"""

import argparse
import importlib.util
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from benching import line, print_head
from findings import Findings

import clmorph

#: Largest difference, and the tolerance of clmorph, in units of epsilon; a device's sums have more.
TOLERANCE, TOL, ROUNDINGS = 1e-5, 1e-9, 16.0
#: Iterations and threshold of the others.
ITERATIONS, THRESHOLD = 100_000, 1e-12
INF = float("inf")


@dataclass(frozen=True)
class Problem:
    """Two clouds of points with masses, epsilon, and rho of both sides (infinite: balanced)."""

    a: np.ndarray
    x: np.ndarray
    b: np.ndarray
    y: np.ndarray
    epsilon: float
    rho: tuple[float, float]

    @property
    def cost(self) -> np.ndarray:
        """|x_i - y_j|^2 / 2."""
        return 0.5 * ((self.x[:, None] - self.y) ** 2).sum(axis=2)

    @property
    def balanced(self) -> bool:
        """Whether both marginals are prescribed."""
        return self.rho == (INF, INF)


#: Potentials in units of epsilon (f and g) and the plan; None: not a problem of this method.
Answer = tuple[np.ndarray, np.ndarray, np.ndarray]
Solver = Callable[[Problem], Answer | None]


def make(seed: int, number: int) -> Problem:
    """Return the problem of a number."""
    rng = np.random.default_rng([seed, number])
    n, m, d = rng.integers(2, 30), rng.integers(2, 30), rng.integers(1, 5)
    a, b = rng.uniform(0.1, 2, n), rng.uniform(0.1, 2, m)
    rho = [(INF, INF), (0.25, 0.25), (0.1, 1.5), (0.5, INF)][number % 4]
    if rho == (INF, INF):
        a, b = a / a.sum(), b / b.sum()
    return Problem(a, rng.random((n, d)), b, rng.random((m, d)), rng.uniform(0.05, 0.4), rho)


def ours(problem: Problem, backend: Any, counting: bool) -> Answer:
    """Solve by clmorph, with the entropy against a x b or against the counting measure."""
    sides = (problem.a, problem.x), (problem.b, problem.y)
    pair = [
        clmorph.WeightedPoints(points, weights, problem.epsilon * np.log(weights) * counting)
        for weights, points in sides
    ]
    found = clmorph.sinkhorn(
        *pair, epsilon=problem.epsilon, rho=problem.rho, max_iter=ITERATIONS, backend=backend,
        tol=max(TOL, ROUNDINGS * backend.sum_roundoff),
    )  # fmt: skip
    plan = clmorph.transport_plan(*pair, found, log_threshold=-1e4, backend=backend)
    return found.f / problem.epsilon, found.g / problem.epsilon, plan.to_scipy().toarray()


def pot(method: str, reg_type: str = "kl") -> Solver:
    """Return a method of POT."""
    import ot

    def solve(problem: Problem) -> Answer | None:
        given = {"numItermax": ITERATIONS, "stopThr": THRESHOLD, "log": True, "method": method}
        first = problem.a, problem.b, problem.cost, problem.epsilon
        if problem.balanced and reg_type == "kl" and "invariant" not in method:
            plan, log = ot.sinkhorn(*first, **given)
            if "logu" in log:
                u, v = log["logu"], log["logv"]
            else:
                u, v = np.log(log["u"]), np.log(log["v"])
            return u - np.log(problem.a), v - np.log(problem.b), plan
        # Beside two strengths POT 0.9.7's translation-invariant solver is 1.6 % off its others.
        if INF in problem.rho or ("invariant" in method and len(set(problem.rho)) > 1):
            return None
        plan, log = ot.unbalanced.sinkhorn_unbalanced(
            *first, problem.rho, reg_type=reg_type, **given
        )
        return log["logu"], log["logv"], plan

    return solve


def ott() -> Solver:
    """Return OTT-JAX in float64: tau is rho / (rho + epsilon)."""
    import jax
    from ott.geometry.geometry import Geometry
    from ott.solvers import linear

    jax.config.update("jax_enable_x64", True)

    def solve(problem: Problem) -> Answer:
        epsilon = problem.epsilon
        taus = [1.0 if rho == INF else rho / (rho + epsilon) for rho in problem.rho]
        out = linear.solve(
            Geometry(jax.numpy.asarray(problem.cost), epsilon=epsilon), problem.a, problem.b,
            tau_a=taus[0], tau_b=taus[1], threshold=1e-9, max_iterations=ITERATIONS,
        )  # fmt: skip
        f, g, plan = (np.asarray(each, float) for each in (out.f, out.g, out.matrix))
        return f / epsilon, g / epsilon, plan

    return solve


#: Package, what makes the solver, and whether its entropy is against the counting measure.
PEERS: dict[str, tuple[str, Callable[[], Solver], bool]] = {
    "POT sinkhorn": ("ot", lambda: pot("sinkhorn"), False),
    "POT sinkhorn, entropy": ("ot", lambda: pot("sinkhorn", "entropy"), True),
    "POT stabilized": ("ot", lambda: pot("sinkhorn_stabilized"), False),
    "POT translation invariant": ("ot", lambda: pot("sinkhorn_translation_invariant"), False),
    "OTT-JAX": ("ott", ott, True),
}


def differences(one: Answer, other: Answer, balanced: bool) -> tuple[float, float]:
    """Return how far plans are apart, as a share of the mass, and potentials, in epsilon."""
    plans = np.abs(one[2] - other[2]).sum() / other[2].sum()
    apart = [ours - theirs for ours, theirs in zip(one[:2], other[:2], strict=True)]
    if balanced:  # a constant may be shifted from one to the other
        apart = [each - each.mean() for each in apart]
    return float(plans), float(max(np.abs(each).max() for each in apart))


def compare(seed: int, numbers: list[int], device: str, findings: Findings) -> None:
    """Solve problems on a device and by all peers that are there, and print a table."""
    backend = clmorph.get_backend(device)
    print(f"\n{backend.description}\n")
    print_head("solver", "problems", "plans", "potentials, ε")
    for name, (package, maker, counting) in PEERS.items():
        if importlib.util.find_spec(package) is None:
            print(line(name, "not installed", "", ""))
            continue
        solver, worst, count = maker(), np.zeros(2), 0
        for number in numbers:
            problem = make(seed, number)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of the others
                theirs = solver(problem)
            if theirs is None:
                continue
            findings.trial(name)
            found = differences(ours(problem, backend, counting), theirs, problem.balanced)
            worst, count = np.maximum(worst, found), count + 1
            if not max(found) <= TOLERANCE:
                what = f"{number}: plans {found[0]:.2g}, potentials {found[1]:.2g} apart"
                findings.add(name, what, ["--only", str(number), "--device", device])
        print(line(name, count, f"{worst[0]:.1e}", f"{worst[1]:.1e}"), flush=True)


def main(given: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=100, help="problems [default: 100]")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", type=int, metavar="NUMBER", help="this one problem")
    parser.add_argument("--device", action="append", help="such as numpy or 0:0; repeatable")
    options = parser.parse_args(given)
    if not any(importlib.util.find_spec(package) for package, _, _ in PEERS.values()):
        parser.error("none of the libraries is installed: pip install -e '.[bench]'")
    numbers = list(range(options.count)) if options.only is None else [options.only]
    findings = Findings(["--seed", str(options.seed)])
    for device in options.device or ["numpy"]:
        compare(options.seed, numbers, device, findings)
    return findings.end()


if __name__ == "__main__":
    raise SystemExit(main())
