"""Hessian-vector products against finite differences of gradients."""

import numpy as np
import pytest

import clmorph
from clmorph.errors import InputError

FIELDS = ("source_points", "source_weights", "target_points", "target_weights")


def _problem(seed: int, balanced: bool):
    rng = np.random.default_rng(seed)
    n, m = 6, 8
    x, y = rng.random((n, 2)), rng.random((m, 2))
    a, b = rng.random(n) + 0.5, rng.random(m) + 0.5
    change = [rng.standard_normal(each.shape) for each in (x, a, y, b)]
    if balanced:
        a, b = a / a.sum(), b / b.sum()
        change[1], change[3] = (each - each.mean() for each in (change[1], change[3]))
    return (x, a, y, b), change


def _gradient(parts, divergence, reach, tol=1e-11):
    x, a, y, b = parts
    options = {"blur": 0.3, "reach": reach, "tol": tol, "max_iter": 20_000, "backend": "numpy"}
    pair = (a, x), (b, y)
    if divergence:
        found = clmorph.sinkhorn_divergence(*pair, **options, gradient=True)
        return found, found.gradient
    found = clmorph.sinkhorn(*pair, **options)
    return found, clmorph.gradient(*pair, found, backend="numpy")


@pytest.mark.parametrize("divergence", [False, True])
@pytest.mark.parametrize("reach", [0.5, None])
@pytest.mark.filterwarnings("ignore::clmorph.ConvergenceWarning")
def test_products_are_differences_of_gradients(divergence, reach):
    for seed in range(3):
        parts, change = _problem(seed, reach is None)
        solved, _ = _gradient(parts, divergence, reach)
        pair = (parts[1], parts[0]), (parts[3], parts[2])
        found = clmorph.hessian_product(*pair, solved, clmorph.Gradient(*change))
        step, wanted = 2e-4, [0.0] * 4
        # Four points, so that the difference's own error is of the step's fourth power.
        for factor, weight in ((1, 8), (-1, -8), (2, -1), (-2, 1)):
            moved = [p + factor * step * c for p, c in zip(parts, change, strict=True)]
            _, there = _gradient(moved, divergence, reach)
            wanted = [
                so_far + weight * getattr(there, name) / (12 * step)
                for so_far, name in zip(wanted, FIELDS, strict=True)
            ]
        for name, want in zip(FIELDS, wanted, strict=True):
            error = np.abs(getattr(found, name) - want).max()
            assert error <= 1e-6 * np.abs(want).max(), name


@pytest.mark.filterwarnings("ignore::clmorph.ConvergenceWarning")
def test_product_is_symmetric_and_linear():
    parts, one = _problem(5, False)
    other = _problem(6, False)[1]
    solved, _ = _gradient(parts, True, 0.5)
    pair = (parts[1], parts[0]), (parts[3], parts[2])
    products = [
        clmorph.hessian_product(*pair, solved, clmorph.Gradient(*each)) for each in (one, other)
    ]
    forth, back = (
        sum(np.vdot(getattr(product, name), part) for name, part in zip(FIELDS, each, strict=True))
        for product, each in zip(products, (other, one), strict=True)
    )
    assert forth == pytest.approx(back, rel=1e-8)


def test_mistakes_are_named():
    parts, change = _problem(0, False)
    pair = (parts[1], parts[0]), (parts[3], parts[2])
    solved = clmorph.sinkhorn(*pair, blur=0.3, reach=0.5, backend="numpy")
    good = clmorph.Gradient(*change)
    for arguments, words in (
        ((*pair, None, good), "solved"),
        ((*pair, solved, None), "direction"),
        ((*pair, solved, clmorph.Gradient(*change[::-1])), "direction: source_points"),
        (((0 * parts[1] + [0, 1, 1, 1, 1, 1], parts[0]), pair[1], solved, good), "positive"),
    ):
        with pytest.raises(InputError, match=words) as caught:
            clmorph.hessian_product(*arguments)
        assert "\n" not in str(caught.value)
