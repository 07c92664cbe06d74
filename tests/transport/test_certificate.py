"""Compare values, gap and marginals with a dense float64 primal and dual; vary regularization."""

import re

import numpy as np
import plain
import pytest
from plain import reference, sinkhorn
from residuals import true_residual

import clmorph
from clmorph import InputError
from clmorph.backends.opencl.backend import OpenCLOperations
from clmorph.backends.opencl.build.constants import apply_quirks, choose_constants
from clmorph.reference.transport import certificate
from clmorph.transport.regularization import regularization

REACHES = [0.1, 0.3, 2.0, None, (0.2, 0.9), (0.3, None), (None, 0.3)]


def clouds(rng, n=50, m=64, dimension=5, balanced=False):
    a, b = rng.random(n), rng.random(m)
    a[::7] = 0
    if balanced:
        a, b = a / a.sum(), b / b.sum()
    return (a, rng.random((n, dimension))), (b, rng.random((m, dimension)))


@pytest.mark.filterwarnings("ignore::clmorph.ConvergenceWarning")
@pytest.mark.parametrize("max_iter", [1, 4, 1000])
@pytest.mark.parametrize("reach", REACHES, ids=str)
def test_certificate_is_that_of_the_dense_plan(any_backend, rng, reach, max_iter):
    """Near the optimum and far from it."""
    pair = clouds(rng, balanced=reach is None)
    got = sinkhorn(*pair, 0.2, reach, 1e-5, max_iter, any_backend)
    measures = clmorph.measures.points.as_pair(*pair)
    want = certificate(*measures, got.f, got.g, regularization(0.2, reach))
    size = abs(want.primal) + got.epsilon * want.transported_mass
    rounding = 1e-5 * got.epsilon * want.transported_mass + 1e-9 * size
    assert got.dual == pytest.approx(want.dual, abs=rounding)
    if got.rho == np.inf or np.inf in np.ravel(got.rho):
        # Another feasible plan than the reference's: a bound of its own.
        assert got.primal >= want.dual - rounding
        if got.converged:
            assert got.gap <= 0.02 * got.primal
    else:
        assert got.primal == pytest.approx(want.primal, abs=rounding)
    assert got.marginal_error == pytest.approx(want.marginal_error, abs=1e-5 * got.transported_mass)
    assert got.transported_mass == pytest.approx(want.transported_mass, rel=1e-5)
    assert np.allclose(got.row_mass, want.row_mass, rtol=2e-5, atol=1e-30)
    assert np.allclose(got.column_mass, want.column_mass, rtol=2e-5, atol=1e-30)
    assert got.gap == got.primal - got.dual >= 0
    if not isinstance(reach, tuple) and reach is not None:
        assert got.gap == pytest.approx(want.gap, abs=rounding)


@pytest.mark.parametrize("reach", REACHES, ids=str)
def test_against_the_plain_iteration(any_backend, rng, reach):
    pair = clouds(rng, balanced=reach is None)
    got = sinkhorn(*pair, 0.15, reach, 1e-5, backend=any_backend)
    want = reference.sinkhorn(*pair, 0.15, reach, 1e-8, 20000)
    assert got.converged
    assert want.converged
    assert got.dual == pytest.approx(want.dual, abs=1e-6 * got.epsilon * got.transported_mass)
    assert got.row_mass == pytest.approx(want.row_mass, rel=1e-3)
    assert got.column_mass == pytest.approx(want.column_mass, rel=1e-3)


def test_two_names_of_a_strength(rng):
    pair = clouds(rng)
    named = sinkhorn(*pair, 0.2, 0.5, backend="numpy")
    squared = sinkhorn(*pair, epsilon=0.2**2, rho=0.25, backend="numpy")
    assert squared.blur == pytest.approx(0.2)
    assert np.allclose(named.f, squared.f, rtol=0, atol=1e-12)
    pairs = sinkhorn(*pair, 0.2, rho=(0.25, np.inf), backend="numpy")
    assert pairs.reach == (0.5, None)
    for infinite in ({"rho": np.inf}, {"reach": np.inf}):
        balanced = sinkhorn(*clouds(rng, balanced=True), 0.2, **infinite, backend="numpy")
        assert balanced.reach is None
    assert sinkhorn(*pair, 0.2, (0.5, 0.5), backend="numpy").reach == 0.5


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"blur": 0.1, "epsilon": 0.01}, "two names of one strength"),
        ({"reach": 0.1, "rho": 0.01}, "two names of one strength"),
        ({"blur": 0.05, "epsilon": 0.0025}, "two names"),
        ({"epsilon": 0}, "epsilon=0"), ({"epsilon": -1.0}, "epsilon=-1"),
        ({"epsilon": np.nan}, "epsilon=nan"), ({"epsilon": "x"}, "epsilon='x'"),
        ({"epsilon": np.inf}, "epsilon=inf"), ({"epsilon": [1, 2]}, "epsilon="),
        ({"rho": 0}, "rho=0"), ({"rho": -0.1}, "rho=-0.1"), ({"rho": (1, -1)}, "rho=-1"),
        ({"rho": (1, 2, 3)}, "a pair"), ({"reach": (1,)}, "a pair"),
        ({"method": "fast"}, "method='fast'"), ({"precision": "half"}, "precision='half'"),
        ({"scaling": 1.0}, "scaling=1"), ({"start": 3}, "start=3"),
        ({"blur": 0}, "blur=0"), ({"blur": np.inf}, "blur=inf"), ({"reach": 0}, "reach=0"),
        ({"reach": "far"}, "reach='far'"), ({"tol": 0}, "tol=0"), ({"tol": np.nan}, "tol=nan"),
        ({"max_iter": 0}, "max_iter=0"), ({"max_iter": 2.5}, "max_iter=2.5"),
        ({"multiscale": "yes"}, "multiscale='yes'"), ({"multiscale": 2}, "multiscale=2"),
        ({"blur": 1e-6}, "too small"), ({"reach": 1e6}, "too large for blur"),
    ],
)  # fmt: skip
def test_wrong_strengths_and_options(rng, options, words):
    with pytest.raises(InputError, match=words) as caught:
        sinkhorn(*clouds(rng), backend="numpy", **options)
    assert "\n" not in str(caught.value)


def test_points_on_a_line_may_be_given_flat(rng):
    a, x = np.ones(5), np.linspace(0, 1, 5)
    flat = sinkhorn((a, x), (a, x + 0.1), backend="numpy")
    column = sinkhorn((a.tolist(), x[:, None].tolist()), (a, x[:, None] + 0.1), backend="numpy")
    assert np.array_equal(flat.f, column.f)


ONE = (np.ones(3), np.zeros((3, 2)))


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (np.zeros((2, 4, 5)), "expected a Measure"),
        (None, "expected a Measure"),
        ((np.ones(3),), "expected a Measure"),
        (("a", "b"), "not an array of numbers"),
        ((np.ones(4), np.zeros((3, 2))), "in this order"),
        ((np.zeros((3, 2)), np.ones(3)), "in this order"),
        ((np.ones(0), np.zeros((0, 2))), "N > 0"),
        ((np.ones(3), np.zeros((3, 9))), "dimensions"),
        ((np.ones(3), np.zeros((3, 0))), "dimensions"),
        ((np.ones(3), np.full((3, 2), np.nan)), "coordinates"),
        ((np.ones(3), np.full((3, 2), 1e9)), "coordinates"),
        ((np.array([1, -1, 1]), np.zeros((3, 2))), "at least 0"),
        ((np.zeros(3), np.zeros((3, 2))), "positive sum"),
        ((np.full(3, np.inf), np.zeros((3, 2))), "positive sum"),
        ((np.ones(3), np.zeros((3, 3))), "dimensions, target in"),
    ],
)
def test_wrong_points(wrong, words):
    for pair in ((wrong, ONE), (ONE, wrong)):
        if words == "dimensions, target in" and pair[0] is ONE:
            continue
        with pytest.raises(InputError, match=words) as caught:
            sinkhorn(*pair, backend="numpy")
        assert "\n" not in str(caught.value)


def test_a_measure_and_plain_points_of_the_same_space(rng):
    image = plain.lift(rng.random((6, 7, 3)))
    got = sinkhorn(image, (image.weights, image.points), backend="numpy")
    assert np.abs(got.f - got.g).max() < 1e-3 * got.epsilon


def test_a_start_saves_iterations_and_changes_nothing(rng):
    pair = clouds(rng, 60, 60)
    cold = sinkhorn(*pair, 0.05, 1.0, backend="numpy")
    warm = sinkhorn(*pair, 0.05, 1.0, backend="numpy", start=cold)
    assert warm.n_iter <= 2
    assert warm.dual == pytest.approx(cold.dual, abs=cold.gap)
    near = sinkhorn(*pair, 0.045, 1.0, backend="numpy", start=cold)
    assert near.n_iter < sinkhorn(*pair, 0.045, 1.0, backend="numpy").n_iter
    with pytest.raises(InputError, match="expected 60 and 64"):
        sinkhorn(*clouds(rng, 60, 64), 0.05, 1.0, backend="numpy", start=cold)


@pytest.mark.filterwarnings("ignore::clmorph.ConvergenceWarning")
def test_the_blur_that_is_proposed_is_enough(rng):
    (a, x), (b, y) = clouds(rng)
    with pytest.raises(InputError, match="too small") as caught:
        sinkhorn((a, 3 * x), (b, 3 * y), 1e-6, backend="numpy")
    proposed = float(str(caught.value).split("at least ")[1].split(";")[0])
    assert 1e-6 < proposed < 1e-5
    assert sinkhorn((a, 3 * x), (b, 3 * y), proposed, max_iter=1, backend="numpy").n_iter == 1


@pytest.fixture(params=["float64", "pairs of float32"])
def wide_device(request, device):
    """Each device with float64, and without."""
    if request.param == "float64":
        return device
    constants = apply_quirks(choose_constants(device.device), frozenset({"no_float64"}))
    return OpenCLOperations(device.device, constants, verify=False)


@pytest.mark.parametrize("reach", [None, 2.0, 1e3])
@pytest.mark.parametrize("layout", ["two groups", "three groups", "one point away", "a line"])
def test_points_as_far_apart_as_the_device_allows(wide_device, rng, reach, layout):
    """Groups in one tile; a blur that is a little smaller is refused, with one that is enough."""
    farthest = np.sqrt(2 * wide_device.max_spread)
    pair = []
    for _ in range(2):
        x = rng.random((60, 2))
        place = {
            "two groups": np.arange(60) >= 30, "three groups": np.arange(60) // 20 / 2,
            "one point away": np.arange(60) == 59, "a line": rng.permutation(60) / 59,
        }[layout]  # fmt: skip
        x[:, 0] += place * (farthest - 3.0)
        pair.append((np.full(60, 1 / 60), x))
    got = sinkhorn(*pair, 1.0, reach, 0.1, backend=wide_device)
    assert got.converged
    assert np.isfinite(got.gap)
    want = sinkhorn(*pair, 1.0, reach, 1e-3, 10**4, backend="numpy")
    assert max(got.dual, want.dual) <= min(got.primal, want.primal)
    with pytest.raises(
        InputError, match=r"blur=0\.9 is too small .*, or use backend='numpy'"
    ) as told:
        sinkhorn(*pair, 0.9, reach, 0.1, backend=wide_device)
    enough = float(re.search(r"at least ([\d.e+-]+)", str(told.value))[1])
    assert np.isfinite(sinkhorn(*pair, enough, reach, 0.1, backend=wide_device).gap)


@pytest.mark.parametrize("mass", [1e-20, 1e15, 1e29])
@pytest.mark.parametrize("multiscale", [False, True])
@pytest.mark.parametrize("seed", [1, 4])
def test_balanced_transport_of_any_mass(any_backend, mass, multiscale, seed):
    """As many iterations as for a mass of one, and the residual that is told."""
    rng = np.random.default_rng(seed)
    n, m, dimension = *rng.integers(20, 300, 2), rng.integers(1, 6)
    a, b = rng.random(n), rng.random(m)
    pair = (a / a.sum(), rng.random((n, dimension))), (b / b.sum(), rng.random((m, dimension)))
    plain = sinkhorn(*pair, 0.02, None, backend=any_backend, multiscale=multiscale)
    pair = [(mass * weights, points) for weights, points in pair]
    got = sinkhorn(*pair, 0.02, None, backend=any_backend, multiscale=multiscale)
    assert plain.converged
    assert got.converged
    assert got.n_iter <= 2 * plain.n_iter
    assert true_residual(pair, got) <= got.residual * (1 + 1e-9) <= 1e-3
    assert np.abs(got.row_mass - pair[0][0]).sum() <= got.marginal_error


@pytest.mark.parametrize("how", ["alone", "batch", "divergence", "matrix"])
def test_masses_that_differ_by_more_than_the_tolerance(any_backend, rng, how):
    """No residual is smaller than their difference, so no iteration is tried."""
    (a, x), (b, y) = clouds(rng, balanced=True)
    pair = (a, x), (b * (1 + 5e-7), y)

    def solve(tol):
        options = {"blur": 0.2, "tol": tol, "backend": any_backend}
        if how == "alone":
            return clmorph.sinkhorn(*pair, **options)
        if how == "batch":
            return clmorph.sinkhorn_batch([pair[0]], [pair[1]], **options)
        if how == "divergence":
            return clmorph.sinkhorn_divergence(*pair, **options)
        return clmorph.divergence_matrix(list(pair), **options)

    assert solve(1e-5).converged
    words = r"masses 1 and 1 differ by 5\.0e-07 of the first, .* not possible to tol=5e-07: give"
    with pytest.raises(InputError, match=words):
        solve(5e-7)


@pytest.mark.filterwarnings("ignore::clmorph.ConvergenceWarning")
@pytest.mark.parametrize("mass", [1.0, 1e15])
def test_balanced_potentials_do_not_drift(any_backend, rng, mass):
    """They are free up to a constant, along which extrapolation ran off below rounding."""
    for n, m in ((1, 5), (30, 40)):
        pair = [(np.full(count, mass / count), rng.random((count, 3))) for count in (n, m)]
        got = sinkhorn(*pair, 0.1, None, 1e-10, 300, any_backend)
        size = 1.5 + got.epsilon * abs(np.log(mass))
        assert np.abs(got.f).max() <= 2 * size
        assert np.abs(got.g).max() <= 2 * size
        assert got.residual <= 1e-5


def test_the_repr_says_how_much_is_transported():
    """One line: the mass that moves, of the mass that there is."""
    near, far = ((np.ones(2) / 2, np.array(points)) for points in ([0.0, 0.1], [0.2, 3.0]))
    got = sinkhorn(near, far, 0.1, 0.3, backend="numpy")
    text = repr(got)
    assert "\n" not in text
    assert text.startswith("<Potentials for 2 and 2 points, converged in ")
    assert text.endswith(f"transported {got.transported_mass:.3g} of 1>")
    assert 0 < got.transported_mass < 1
    heavy = (3 * far[0], far[1])
    more = sinkhorn(near, heavy, 0.1, 0.3, backend="numpy")
    assert repr(more).endswith(" of 1 (source) and 3 (target)>")
    assert repr(more.swapped()).endswith(" of 3 (source) and 1 (target)>")
    assert repr(plain.reference.sinkhorn(near, far, 0.1, 0.3)).endswith(" of 1>")


@pytest.mark.filterwarnings("ignore::clmorph.ConvergenceWarning")
@pytest.mark.parametrize("dimension", range(1, 12))
def test_bounds_include_the_rounding_of_the_device(device, rng, dimension):
    """Without it a dual value is above the optimum in half of all problems."""
    for blur, reach in ((0.03, 0.3), (0.2, 0.3), (1.0, 2.0), (0.2, (0.5, 2.0))):
        n, m = rng.integers(1, 80, 2)
        pair = clouds(rng, n + 1, m + 1, dimension)
        best = sinkhorn(*pair, blur, reach, 1e-10, 5000, "numpy")
        assert best.gap <= 1e-10 * abs(best.primal) + 1e-13  # far less than a device rounds
        got = sinkhorn(*pair, blur, reach, 1e-6, 5000, device)
        assert got.dual <= best.primal
        assert best.dual <= got.primal
        exact = certificate(
            *clmorph.measures.points.as_pair(*pair), got.f, got.g, regularization(blur, reach)
        )
        assert got.gap <= exact.gap + 2e-6 * got.primal
