"""Search for counterexamples to properties that must hold for any measures."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plain import sinkhorn

pytestmark = pytest.mark.filterwarnings("ignore::clmorph.ConvergenceWarning")

MANY = settings(max_examples=30, deadline=None, derandomize=True)
seeds = st.integers(0, 10**6)
sizes = st.integers(1, 25)
orders = st.sampled_from([0, 3, 10])
blurs = st.sampled_from([0.02, 0.05, 0.1, 0.3, 1.0])
reaches = st.sampled_from([0.05, 0.3, 1.0, (0.1, 0.7), (0.3, None)])


def problem(seed, n, m, order, dimension=3):
    """Random clouds whose masses cover so many orders of magnitude."""
    rng = np.random.default_rng(seed)
    a, b = 10 ** rng.uniform(-order, 0.5, n), 10 ** rng.uniform(-order, 0.5, m)
    return (a, rng.random((n, dimension))), (b, rng.random((m, dimension)))


def solve(pair, *arguments, **options):
    return sinkhorn(*pair, *arguments, **({"backend": "numpy"} | options))


@MANY
@given(seeds, sizes, sizes, orders, blurs, reaches)
def test_the_order_of_points_means_nothing(seed, n, m, order, blur, reach):
    (a, x), (b, y) = problem(seed, n, m, order)
    rng = np.random.default_rng(seed)
    p, q = rng.permutation(n), rng.permutation(m)
    one = solve(((a, x), (b, y)), blur, reach, 1e-6)
    other = solve(((a[p], x[p]), (b[q], y[q])), blur, reach, 1e-6)
    assert np.abs(one.f[p] - other.f).max() < 1e-3 * one.epsilon
    assert np.abs(one.g[q] - other.g).max() < 1e-3 * one.epsilon


@MANY
@given(seeds, sizes, sizes, blurs, reaches, st.floats(-5, 5))
def test_translating_both_changes_nothing(seed, n, m, blur, reach, by):
    (a, x), (b, y) = problem(seed, n, m, 0)
    one = solve(((a, x), (b, y)), blur, reach, 1e-6)
    other = solve(((a, x + by), (b, y + by)), blur, reach, 1e-6)
    assert np.abs(one.f - other.f).max() < 1e-3 * one.epsilon


@MANY
@given(seeds, sizes, sizes, orders, blurs, reaches, st.floats(-3, 3))
def test_costs_scale_as_lengths_squared(seed, n, m, order, blur, reach, log_scale):
    """epsilon, rho and C times s^2: the plan stays, potentials and values scale."""
    s = 10.0**log_scale
    (a, x), (b, y) = problem(seed, n, m, order)
    pair = np.broadcast_to(np.array(reach, dtype=object), 2)
    scaled = tuple(None if value is None else s * value for value in pair)
    one = solve(((a, x), (b, y)), blur, reach, 1e-6)
    other = solve(((a, s * x), (b, s * y)), s * blur, scaled, 1e-6)
    assert np.abs(s**2 * one.f - other.f).max() < 1e-3 * other.epsilon
    assert other.dual == pytest.approx(s**2 * one.dual, rel=1e-6, abs=1e-9 * s**2)
    assert other.transported_mass == pytest.approx(one.transported_mass, rel=1e-4)


@pytest.mark.full
@MANY
@given(seeds, sizes, sizes, orders, blurs)
def test_values_grow_with_both_strengths(seed, n, m, order, blur):
    """Each term is a penalty: a larger factor cannot make the optimum cheaper."""
    pair = problem(seed, n, m, order)
    by_reach = [solve(pair, blur, reach, 1e-6) for reach in (0.1, 0.3, 1.0, 3.0)]
    by_blur = [solve(pair, factor * blur, 0.5, 1e-6) for factor in (1.0, 1.5, 2.5)]
    for smaller, larger in [*pairwise(by_reach), *pairwise(by_blur)]:
        assert larger.primal >= smaller.dual - 1e-12


@MANY
@given(seeds, sizes, sizes, orders, blurs, reaches)
def test_the_dual_never_falls(seed, n, m, order, blur, reach):
    pair = problem(seed, n, m, order)
    duals = [solve(pair, blur, reach, 1e-12, max_iter).dual for max_iter in range(1, 16)]
    size = abs(duals[-1]) + blur**2 * pair[0][0].sum() * pair[1][0].sum()
    assert np.all(np.diff(duals) >= -1e-12 * size)
