"""The debiased divergence: a distance-like value with a certain interval."""

import numpy as np
import plain
import pytest
from plain import reference, sinkhorn_divergence

import clmorph
from clmorph import InputError

REACHES = [0.1, 0.5, 3.0, None]


def clouds(rng, balanced=False):
    a, b = rng.random(40), 2 * rng.random(55)
    if balanced:
        a, b = a / a.sum(), b / b.sum()
    return (a, rng.random((40, 3))), (b, 0.3 + rng.random((55, 3)))


def dense_divergence(source, target, blur, reach):
    """From converged dense solves, by the definition."""

    def value(one, other):
        return reference.sinkhorn(one, other, blur, reach, 1e-11, 10**5).dual

    masses = source[0].sum(), target[0].sum()
    cross = value(source, target) + 0.5 * blur**2 * (masses[0] - masses[1]) ** 2
    return cross - 0.5 * (value(source, source) + value(target, target))


@pytest.mark.parametrize("reach", REACHES)
def test_against_the_definition(any_backend, rng, reach):
    pair = clouds(rng, balanced=reach is None)
    got = sinkhorn_divergence(*pair, 0.3, reach, 1e-4, backend=any_backend)
    want = dense_divergence(*pair, 0.3, reach)
    assert got.converged
    assert got.interval[0] <= want <= got.interval[1]
    assert got.interval[0] <= got.value <= got.interval[1]
    assert float(got) == got.value == pytest.approx(want, rel=2e-5)


@pytest.mark.parametrize("reach", REACHES)
def test_zero_for_equal_measures_only(any_backend, rng, reach):
    source, _ = clouds(rng, balanced=reach is None)
    same = sinkhorn_divergence(source, source, 0.2, reach, backend=any_backend)
    assert same.value == 0.0
    assert same.interval[0] == 0.0
    # The same measure, told otherwise: points in another order, one split in two.
    a, x = source
    order = rng.permutation(len(a))
    split = np.concatenate((a[order], [a[0] / 2])), np.concatenate((x[order], x[:1]))
    split[0][np.flatnonzero(order == 0)] /= 2
    again = sinkhorn_divergence(source, split, 0.2, reach, 1e-5, backend=any_backend)
    assert again.interval[0] <= 0.0
    assert again.value < 2e-6
    moved = sinkhorn_divergence(source, (a, x + 0.1), 0.2, reach, 1e-5, backend=any_backend)
    assert moved.interval[0] > again.interval[1]


def test_comparisons_are_proven_or_open(rng):
    (a, x), _ = clouds(rng)
    near = sinkhorn_divergence((a, x), (a, x + 0.1), 0.2, 0.5, backend="numpy")
    far = sinkhorn_divergence((a, x), (a, x + 0.5), 0.2, 0.5, backend="numpy")
    assert near.closer_than(far) is True
    assert far.closer_than(near) is False
    assert near.closer_than(near) is None
    assert "certainly within" in repr(near)


def test_even_an_unfinished_solve_is_certain(rng):
    pair = clouds(rng)
    want = dense_divergence(*pair, 0.2, 1.0)
    for max_iter in (1, 2, 4, 8):
        with pytest.warns(clmorph.ConvergenceWarning) as told:
            got = sinkhorn_divergence(*pair, 0.2, 1.0, 1e-9, max_iter, "numpy")
        assert {each.filename for each in told} == {plain.__file__}  # which calls it
        assert not got.converged
        assert got.interval[0] <= want <= got.interval[1]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"reach": (0.1, 0.2)}, "one number for both"),
        ({"rho": (0.1, 0.2)}, "one number for both"),
        ({"blur": -1}, "blur=-1"), ({"tol": 0}, "tol=0"), ({"precision": "x"}, "precision"),
        ({"reach": None}, "masses"), ({"blur": 0.1, "epsilon": 0.1}, "give one of them"),
    ],
)  # fmt: skip
def test_wrong_options(rng, options, words):
    with pytest.raises(InputError, match=words):
        sinkhorn_divergence(*clouds(rng), backend="numpy", **options)


def test_progress(rng):
    shares = []
    sinkhorn_divergence(*clouds(rng), backend="numpy", progress=shares.append)
    assert shares == sorted(shares)
    assert shares[-1] == 1


def two_groups(rng, n):
    """Balanced clouds of two groups ten apart; 5e-5 of the mass has to travel between them."""
    sides = [np.sort(0.1 * rng.normal(size=(2 * n, 1)) * (n > 1), axis=0) for _ in range(2)]
    for x in sides:
        x[n:] += 10.0
    weights = np.full(2 * n, 1 / (2 * n))
    return (weights * np.repeat([1.0001, 0.9999], n), sides[0]), (weights, sides[1])


@pytest.mark.parametrize("n", [1, 20])
@pytest.mark.parametrize("how", ["alone", "batch", "matrix"])
def test_mass_between_groups_far_apart_counts(any_backend, rng, how, n):
    """Its residual is below the tolerance long before the potentials know of it."""
    pair, options = two_groups(rng, n), {"backend": any_backend}
    if how == "alone":
        got = clmorph.sinkhorn_divergence(*pair, 0.1, **options, gradient=True)
    elif how == "batch":
        lists = [[each] for each in pair]
        (got,) = clmorph.sinkhorn_divergence_batch(*lists, 0.1, **options, gradient=True)
    else:
        got = clmorph.divergence_matrix(pair, 0.1, **options)[0, 1]
    assert got.converged
    if n == 1:
        # The cost of the way, 10^2 / 2, less what the entropy gains.
        assert got.value == pytest.approx(5e-5 * 50, rel=0.005)
    else:
        want = sinkhorn_divergence(*pair, 0.1, None, 1e-8, 20000, "numpy")
        assert got.interval[0] <= want.value <= got.interval[1] < 1.2 * want.value
        assert got.value == pytest.approx(want.value, rel=1e-3)
    if how != "matrix":
        # A little more in the first group: it has to travel as well.
        slopes = got.gradient.source_weights
        assert slopes[:n].mean() - slopes[n:].mean() == pytest.approx(50, rel=0.1)
