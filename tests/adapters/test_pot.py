"""POT's interface against POT itself, which is dense and in float64."""

import numpy as np
import ot
import pytest

import clmorph.pot
from clmorph import InputError

UNBALANCED = [None, 0.7, (0.3, 2.0)]


def samples(rng, n=12, m=15):
    a, b = rng.uniform(0.5, 1.5, n), rng.uniform(0.5, 1.5, m)
    return rng.random((n, 2)), rng.random((m, 2)) + 0.3, a / a.sum(), b / b.sum()


def divergence(p, q):
    """KL(p | q)."""
    return np.sum(p * np.log(p / q) - p + q)


@pytest.mark.parametrize("lazy", [False, True])
@pytest.mark.parametrize("unbalanced", UNBALANCED)
def test_against_pot(any_backend, rng, unbalanced, lazy):
    given = samples(rng)
    options = {"reg": 0.2, "unbalanced": unbalanced}
    theirs = ot.solve_sample(*given, **options, tol=1e-12, max_iter=20000)
    ours = clmorph.pot.solve_sample(*given, **options, lazy=lazy, backend=any_backend)
    near = {"rtol": 1e-4, "atol": 1e-6}
    np.testing.assert_allclose(ours.lazy_plan[:], theirs.plan, **near)
    # By its definition: POT 0.9.7 returns a value of about 0 for unbalanced problems.
    cost, plan = ot.dist(*given[:2]), theirs.plan
    value = np.vdot(plan, cost) + 0.2 * divergence(plan, given[2][:, None] * given[3])
    if unbalanced is not None:
        for penalty, side, weights in zip(
            np.broadcast_to(unbalanced, 2), (plan.sum(1), plan.sum(0)), given[2:], strict=True
        ):
            value += penalty * divergence(side, weights)
    else:
        np.testing.assert_allclose(theirs.value, value, **near)
    np.testing.assert_allclose(ours.value, value, **near)
    np.testing.assert_allclose(ours.value_linear, np.vdot(plan, cost), **near)
    np.testing.assert_allclose(ours.sparse_plan.toarray(), theirs.plan, rtol=0, atol=1e-4)
    for mine, other in zip(ours.marginals, (theirs.plan.sum(1), theirs.plan.sum(0)), strict=True):
        np.testing.assert_allclose(mine, other, **near)
    u, v = ours.potentials
    reference = 1.0 if unbalanced is None else given[2][:, None] * given[3]
    again = reference * np.exp(u[:, None] + v - cost / 0.2)
    np.testing.assert_allclose(again, theirs.plan, **near)
    if unbalanced is not None:
        np.testing.assert_allclose(u, theirs.potentials[0], atol=1e-4)
    if lazy:
        with pytest.raises(InputError, match="lazy"):
            _ = ours.plan
    else:
        assert np.array_equal(ours.plan, ours.lazy_plan[:])


def test_slices(rng):
    plan = clmorph.pot.solve_sample(*samples(rng), reg=0.1, backend="numpy").lazy_plan
    whole = plan[:]
    assert np.array_equal(plan[3], whole[3:4])
    assert np.array_equal(plan[2:5, -1], whole[2:5, -1:])
    assert np.array_equal(plan[[1, 4], ::3], whole[[1, 4], ::3])
    with pytest.raises(IndexError):
        plan[0, 0, 0]


def test_uniform_weights_and_none(rng):
    x, y, *_ = samples(rng)
    found = clmorph.pot.solve_sample(x, y, reg=0.1, backend="numpy")
    np.testing.assert_allclose(found.marginal_a, 1 / len(x), rtol=1e-5)
    assert found.status == "Converged"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, "reg is missing"), ({"reg": -1}, "reg=-1"), ({"reg": 1, "metric": "cosine"}, "metric"),
        ({"reg": 1, "unbalanced_type": "TV"}, "unbalanced_type"), ({"reg": 1, "c": 1}, "c: "),
        ({"reg": 1, "unbalanced": 0}, "unbalanced=0"),
        ({"reg": 1, "unbalanced": "x"}, "unbalanced"),
        ({"reg": 1, "unbalanced": (1, 2, 3)}, "a pair"), ({"reg": 1, "reg_type": "L2"}, "reg_type"),
    ],
)  # fmt: skip
def test_wrong_options(rng, options, words):
    x, y, *_ = samples(rng)
    with pytest.raises(InputError, match=words):
        clmorph.pot.solve_sample(x, y, backend="numpy", **options)
