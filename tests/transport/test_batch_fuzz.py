"""Random problems in batches against a solve of each one alone: values, gradients, statuses."""

import warnings
from typing import Any

import numpy as np
import pytest
from residuals import true_residual

import clmorph
from clmorph import ConvergenceWarning

GRADIENTS = ("source_weights", "source_points", "target_weights", "target_points")


def drawn(rng: np.random.Generator, hard: bool) -> tuple[list[Any], list[Any], dict[str, Any]]:
    """Ten random pairs, sources and targets, with options in common.

    Pairs are of any shape, some of them of equal measures; hard ones are solved at small blurs, and
    have masses over up to twelve decades.
    """
    reach = rng.choice([None, 0.05, 0.3, 1.0] if hard else [None, None, 0.05, 0.3, 1.0, 30.0])
    pairs = []
    for _ in range(10):
        dimension, spread = int(rng.integers(1, 6)), 10 ** rng.uniform(-1, 0.5)
        decades, pair = 12 * rng.random() ** 2, []
        for _ in range(2):
            n = int(rng.integers(1, 50 if hard else 70))
            a, x = rng.random(n) + 0.05, rng.random((n, dimension))
            if hard:
                a = 10 ** rng.uniform(-decades, 0, n)
            else:
                x *= spread
                a[rng.random(n) < rng.choice([0.0, 0.2])] = 0.0
                a[0] = 1.0
                if rng.random() < 0.2:
                    x[n // 2 :, 0] += 3.0 * spread  # two groups
            pair.append((a / a.sum() * (1.0 if reach is None else 10 ** rng.uniform(-1, 1)), x))
        pairs.append(tuple(pair))
    if hard:
        options = {"blur": 10 ** rng.uniform(-2.3, -0.5), "max_iter": 400}
    else:
        pairs[1] = (pairs[0][0], pairs[0][0])  # equal measures
        pairs[2] = (pairs[0][1], pairs[0][0])  # the same problem, turned round
        options = {"blur": 10 ** rng.uniform(-1.5, -0.3), "max_iter": 5000}
        options["tol"] = 10 ** rng.uniform(-8, -2)
    sources, targets = map(list, zip(*pairs, strict=True))
    return sources, targets, options | {"reach": reach}


@pytest.mark.full
@pytest.mark.parametrize("seed", range(30))
def test_certificates_of_hard_problems_enclose_one_optimum(any_backend, seed):
    """Three hundred problems on each device in turn, against NumPy's certificates."""
    sources, targets, options = drawn(np.random.default_rng(1000 + seed), hard=True)
    with warnings.catch_warnings(action="ignore", category=ConvergenceWarning):
        wanted = clmorph.sinkhorn_batch(sources, targets, **options, backend="numpy")
        found = clmorph.sinkhorn_batch(sources, targets, **options, backend=any_backend)
        for number, pair in enumerate(zip(sources, targets, strict=True)):
            ours, theirs = found[number], wanted[number]
            alone = clmorph.sinkhorn(*pair, **options, backend=any_backend)
            assert ours.status == alone.status, number
            assert ours.n_iter == alone.n_iter, number
            for other in (theirs, alone):
                assert max(ours.dual, other.dual) <= min(ours.primal, other.primal), number
            residual = true_residual(pair, ours)
            assert residual <= ours.residual * (1 + 1e-9), number


@pytest.mark.full
@pytest.mark.parametrize("seed", range(20))
def test_batches_are_as_single_solves(any_backend, seed):
    """Two hundred problems on each device in turn, and on NumPy."""
    sources, targets, options = drawn(np.random.default_rng(seed), hard=False)
    options["backend"] = any_backend
    tol, epsilon = options["tol"], options["blur"] ** 2
    with warnings.catch_warnings(action="ignore", category=ConvergenceWarning):
        plain = clmorph.sinkhorn_batch(sources, targets, **options)
        found = clmorph.sinkhorn_divergence_batch(sources, targets, **options, gradient=True)
        for number, pair in enumerate(zip(sources, targets, strict=True)):
            alone = clmorph.sinkhorn(*pair, **options)
            assert plain[number].status == alone.status, number
            assert plain[number].n_iter == alone.n_iter, number
            assert max(plain[number].dual, alone.dual) <= min(plain[number].primal, alone.primal)
            one, other = found[number], clmorph.sinkhorn_divergence(*pair, **options, gradient=True)
            for part in ("cross", "source_self", "target_self"):
                assert getattr(one, part).status == getattr(other, part).status, (number, part)
            assert one.interval[0] <= other.interval[1]
            assert other.interval[0] <= one.interval[1]
            mass = max(pair[0][0].sum(), pair[1][0].sum())
            # Their duals miss the optimum by the square of the residuals.
            assert abs(one.value - other.value) <= 0.01 * tol * epsilon * mass, number
            for name in GRADIENTS:
                # Derivatives by weights are potentials, which slow modes move by many residuals.
                size = 1e3 * epsilon if name.endswith("weights") else 20 * options["blur"] * mass
                got, want = (getattr(each.gradient, name) for each in (one, other))
                assert np.abs(got - want).max() <= tol * size, (number, name)
