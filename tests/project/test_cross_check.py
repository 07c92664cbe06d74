"""The judge of ``tools/cross_check.py`` is correct and detects errors; a part of the check runs."""

import re
import sys
from dataclasses import replace
from types import SimpleNamespace

import cross_check
import numpy as np
import pytest
from crosscheck import claims, exact, judge
from crosscheck.exact import Dense, make_side
from crosscheck.numbers import EXTENDED, NUMBER
from findings import Findings

SEED = 20261122
#: Seconds of work for one solve.
PATIENCE = 20.0
#: Relative, in long double or in float64.
CLOSE = 1e-17 if EXTENDED else 1e-13
INF = float("inf")


def dense(a, x, b, y, blur, rho):
    sides = [
        make_side(np.array(weights, float), np.array(points, float), None, strength)
        for weights, points, strength in zip((a, b), (x, y), rho, strict=True)
    ]
    return Dense(*sides, NUMBER(blur**2))


def kl(p, q):
    return p * np.log(p / q) - p + q


RHOS = [(0.09, 0.09), (1e-4, 25.0), (INF, 0.3), (2.0, INF), (INF, INF)]


@pytest.mark.parametrize("rho", RHOS, ids=str)
@pytest.mark.parametrize(
    ("masses", "blur"), [((1.0, 1.0), 0.5), ((3e-12, 4e-9), 0.0078125), ((2e15, 5e3), 0.5)]
)
def test_two_diracs(rho, masses, blur):
    """Log m = (rho_1 log a + rho_2 log b + epsilon log(a b) - C) / (rho_1 + rho_2 + epsilon)."""
    a, b = map(NUMBER, masses)
    if rho == (INF, INF):
        b = a
    problem = dense([float(a)], [[0.0, 1.0]], [float(b)], [[0.75, 0.0]], blur, rho)
    cost, epsilon = NUMBER(0.5 * (0.75**2 + 1)), problem.epsilon
    strengths = [NUMBER(one) for one in rho]
    if np.isinf(rho[0]):
        m = a
    elif np.isinf(rho[1]):
        m = b
    else:
        m = strengths[0] * np.log(a) + strengths[1] * np.log(b) + epsilon * np.log(a * b) - cost
        m = np.exp(m / (strengths[0] + strengths[1] + epsilon))
    value = cost * m + epsilon * kl(m, a * b)
    for strength, mass in zip(strengths, (a, b), strict=True):
        value += 0 if np.isinf(strength) else strength * kl(m, mass)
    found, rounding = judge.solve(problem), 20 * CLOSE * abs(value)
    assert found.settled
    assert found.low - rounding <= value <= found.high + rounding


def above(value):
    return float(np.nextafter(float(value), np.inf))


def honest(rho, sigma=0.0):
    """A result with the true errors of potentials, which may differ from the optimum."""
    rng = np.random.default_rng(11)
    a, b = rng.integers(0, 9, 12) / 8, rng.integers(0, 9, 15) / 8
    a[:2], b[:2] = 1.0, 0.0
    if rho == (INF, INF):
        b = np.append(a / 2, a / 2)
    problem = dense(a, rng.random((12, 2)), b, rng.random((len(b), 2)), 0.125, rho)
    optimum = judge.solve(problem)
    f, g = np.zeros(len(a)), np.zeros(len(b))
    f[problem.source.places] = optimum.f + sigma * rng.normal(size=len(optimum.f))
    g[problem.target.places] = optimum.g
    truth = exact.evaluate(problem, f[problem.source.places], g[problem.target.places])
    rows, columns = np.zeros(len(a)), np.zeros(len(b))
    rows[problem.source.places] = np.exp(truth.rows)
    columns[problem.target.places] = np.exp(truth.columns)
    dual = float(truth.dual.low) - 1e-12
    balanced = problem.source.balanced, problem.target.balanced
    primal = None if any(balanced) else float(truth.dual.high + truth.gap.high) + 1e-12
    result = SimpleNamespace(
        f=f, g=g, dual=dual, primal=primal, gap=None if primal is None else primal - dual,
        residual=above(truth.residual.high), status="max_iter", truncation=None,
        truncation_error=1e-12, row_mass=rows, column_mass=columns,
        transported_mass=float(truth.mass.value), marginal_error=above(truth.marginal_error.high),
    )  # fmt: skip
    return claims.Told(result, problem, truth, optimum, 1e-3)


def broken(told):
    return {outcome.check for outcome in claims.check(told) if outcome.broken}


MASSES = {"row_mass", "column_mass", "transported_mass"}
UNBALANCED, ONE_SIDED, BALANCED = (0.25, 1.0), (INF, 0.25), (INF, INF)


@pytest.mark.parametrize(
    ("rho", "sigma", "changed", "expected"),
    [
        (UNBALANCED, 0.0, {"dual": 1e-9}, {"dual <= optimum", "dual <= D(f, g)", "gap"}),
        (ONE_SIDED, 0.0, {"dual": 1e-9}, {"dual <= optimum", "dual <= D(f, g)"}),
        (BALANCED, 0.0, {"dual": 1e-9}, {"dual <= optimum", "dual <= D(f, g)"}),
        (UNBALANCED, 0.0, {"primal": -1e-9}, {"optimum <= primal", "P(f, g) <= primal", "gap"}),
        (UNBALANCED, 0.01, {"primal": -1e-9}, {"P(f, g) <= primal", "gap"}),
        (UNBALANCED, 0.0, {"gap": 1e-9}, {"gap"}),
        (UNBALANCED, 0.0, {"gap": None}, {"gap"}),
        (UNBALANCED, 0.0, {"primal": None}, {"optimum <= primal", "gap"}),
        (UNBALANCED, 0.0, {"primal": 1e-3, "gap": 1e-3}, {"widening"}),
        (UNBALANCED, 0.0, {"dual": -1e-3, "gap": 1e-3}, {"widening"}),
        (UNBALANCED, 0.01, {"residual": -1e-9}, {"residual"}),
        (BALANCED, 0.01, {"residual": -1e-9}, {"residual"}),
        (UNBALANCED, 0.01, {"status": "converged"}, {"converged"}),
        (UNBALANCED, 0.0, {"row_mass": 1e-9}, {"row_mass"}),
        (UNBALANCED, 0.0, {"column_mass": -1e-9}, {"column_mass"}),
        (UNBALANCED, 0.0, {"transported_mass": 1e-9}, {"transported_mass"}),
        # Float64 itself rounds so much.
        *([(UNBALANCED, 0.0, {"truncation_error": -1e-12}, MASSES)] if EXTENDED else []),
        (ONE_SIDED, 0.01, {"marginal_error": -1e-9}, {"marginal_error"}),
        (BALANCED, 0.01, {"marginal_error": -1e-9}, {"marginal_error"}),
        (UNBALANCED, 0.0, {"primal": np.nan}, {"finite"}),
        (BALANCED, 0.0, {"residual": np.inf}, {"finite"}),
    ],
)
def test_what_is_wrong_is_found(rho, sigma, changed, expected):
    told = honest(rho, sigma)
    values = dict(vars(told.result))
    for name, change in changed.items():
        if name.endswith("mass"):
            values[name] = values[name] * (1 + change)
        elif isinstance(change, float):
            values[name] = values[name] + change
        else:
            values[name] = change
    found = broken(replace(told, result=SimpleNamespace(**values)))
    assert found & expected
    assert found <= expected


@pytest.mark.parametrize("share", range(4))
def test_what_is_told_is_true(any_backend, share, capsys, monkeypatch):
    """A dozen problems a share, on each backend."""
    monkeypatch.setattr(sys, "argv", ["cross_check.py"])  # what lines tell to repeat
    findings = Findings(["--seed", str(SEED)])
    numbers = range(12 * share, 12 * share + 12)
    lines = cross_check.run([any_backend], SEED, numbers, findings, 1 << 16, PATIENCE)
    unsettled = re.search(r"(\d+) not settled", "\n".join(lines))
    assert unsettled is None or int(unsettled[1]) <= 2
    assert findings.end() == 0, capsys.readouterr().out


def test_what_is_told_of_grids_is_true(any_backend, capsys, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["cross_check.py"])
    findings = Findings(["--seed", str(SEED)])
    cross_check.run([any_backend], SEED, range(15), findings, patience=PATIENCE, grids=True)
    assert findings.end() == 0, capsys.readouterr().out
