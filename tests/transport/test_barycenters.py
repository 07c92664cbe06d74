"""Barycenters, against closed forms and other libraries."""

import numpy as np
import ot
import pytest
from scipy.optimize import brentq
from scipy.special import ndtri

import clmorph
from clmorph.errors import ConvergenceWarning, InputError
from clmorph.transport.barycenters import free_support

#: A line of points for fixed supports, and widths of two bells on it.
LINE = np.linspace(-1.2, 1.2, 121)
WIDTHS, SHARES = (0.1, 0.25), (0.6, 0.4)


def _quantiles(mean: float, width: float) -> tuple[np.ndarray, np.ndarray]:
    """A Gaussian as points of equal masses."""
    q = ndtri((np.arange(100) + 0.5) / 100)
    return np.full(100, 0.01), mean + width * q / np.sqrt((q**2).mean())


def _bell(mean: float, width: float) -> tuple[np.ndarray, np.ndarray]:
    density = np.exp(-0.5 * ((LINE - mean) / width) ** 2)
    return density / density.sum(), LINE


def _moments(found: clmorph.Barycenter) -> tuple[float, float]:
    weights = found.weights / found.mass
    mean = weights @ found.points[:, 0]
    return float(mean), float(np.sqrt(weights @ (found.points[:, 0] - mean) ** 2))


def _cross(one: float, other: float, epsilon: float) -> float:
    """Covariance c of the entropic plan between Gaussians: c^2 + epsilon c = (one other)^2."""
    return 0.5 * (np.sqrt(epsilon**2 + 4 * (one * other) ** 2) - epsilon)


def _width(kind: str, epsilon: float) -> float:
    """Width of a Gaussian barycenter, from the condition of the optimum.

    sum_k w_k c(s, s_k) = c(s, s) debiased, = s^2 for OT with free points; sum_k w_k s_k^2 / c = 1
    for projections on a fixed support.
    """

    def condition(s: float) -> float:
        crosses = [_cross(s, each, epsilon) for each in WIDTHS]
        if kind == "blurred":
            return 1 - sum(w * k * k / c for w, k, c in zip(SHARES, WIDTHS, crosses, strict=True))
        aim = s * s if kind == "narrow" else _cross(s, s, epsilon)
        return float(np.dot(SHARES, crosses)) - aim

    return float(brentq(condition, 1e-4, 3.0))


class TestGaussians:
    """Each has the mean and the width that theory gives; without blur they would be 0.16 wide."""

    @pytest.mark.parametrize("blur", [0.03, 0.1])
    @pytest.mark.parametrize("debias", [True, False])
    def test_free_support(self, any_backend, blur, debias):
        measures = [_quantiles(m, s) for m, s in zip((-0.4, 0.6), WIDTHS, strict=True)]
        found = clmorph.barycenter(
            measures, SHARES, None, blur, debias=debias, tol=1e-3, backend=any_backend
        )
        assert found.converged
        wanted = _width("debiased" if debias else "narrow", blur**2)
        np.testing.assert_allclose(_moments(found), (0.0, wanted), atol=1e-3)
        assert found.mass == pytest.approx(1.0)

    @pytest.mark.parametrize("debias", [True, False])
    def test_fixed_support(self, any_backend, debias):
        measures = [_bell(m, s) for m, s in zip((-0.2, 0.3), WIDTHS, strict=True)]
        found = clmorph.barycenter(
            measures, SHARES, LINE, 0.08, debias=debias, fixed=True, tol=1e-4, backend=any_backend
        )
        assert found.converged
        wanted = _width("debiased" if debias else "blurred", 0.08**2)
        np.testing.assert_allclose(_moments(found), (0.0, wanted), atol=1e-3)
        np.testing.assert_array_equal(found.points[:, 0], LINE)


@pytest.mark.parametrize("rho", [0.1, 1.0, 100.0])
@pytest.mark.parametrize("debias", [True, False])
@pytest.mark.parametrize("fixed", [True, False])
def test_masses_of_diracs(any_backend, rho, debias, fixed):
    """a^kappa = sum_k w_k b_k^kappa debiased; without, a (rho + epsilon m) / (rho + epsilon) is
    sum_k w_k (a b_k)^kappa, or a = sum_k w_k r_k with the mean mass u of a fixed support and
    r_k^(2 rho + epsilon) = (a b_k)^rho (u b_k)^epsilon."""
    epsilon, shares, masses = 0.01, np.array([0.25, 0.75]), np.array([1.0, 4.0])
    kappa = (rho + epsilon) / (2 * rho + epsilon)
    total = shares @ masses**kappa
    wanted = total ** (1 / kappa)
    if not debias:
        factor = (rho + epsilon) / (rho + epsilon * (shares @ masses))
        wanted = (total * factor) ** (1 / (1 - kappa))
        if fixed:
            powers = masses**kappa * (shares @ masses) ** (epsilon / (2 * rho + epsilon))
            wanted = (shares @ powers) ** (1 / kappa)
    place = np.array([[0.2, 0.3]])
    measures = [(np.array([mass]), place) for mass in masses]
    found = clmorph.barycenter(
        measures, shares, place, epsilon=epsilon, rho=rho, debias=debias, fixed=fixed, tol=1e-5,
        backend=any_backend,
    )  # fmt: skip
    assert found.mass == pytest.approx(wanted, rel=1e-4)
    np.testing.assert_allclose(found.points, [[0.2, 0.3]], atol=1e-6)


@pytest.mark.small
def test_a_fixed_support_without_debiasing_is_blurred(any_backend):
    """Of Diracs at y_k it is a ~ exp(-sum_k w_k C(x, y_k) / epsilon)."""
    x, shares = np.array([0.0, 1.0, 2.0]), np.array([0.25, 0.75])
    found = clmorph.barycenter(
        [([1.0], [0.0]), ([1.0], [2.0])], shares, x, epsilon=0.5, fixed=True, debias=False,
        tol=1e-6, backend=any_backend,
    )  # fmt: skip
    wanted = np.exp(-(0.5 * (x[:, None] - [0.0, 2.0]) ** 2) @ shares / 0.5)
    np.testing.assert_allclose(found.weights, wanted / wanted.sum(), atol=1e-6)


@pytest.mark.small
def test_two_points_meet_at_their_weighted_mean(any_backend):
    measures = [(np.ones(1), np.array([[x, 1 - x]])) for x in (0.0, 1.0)]
    found = clmorph.barycenter(measures, [3, 1], blur=0.1, backend=any_backend)
    np.testing.assert_allclose(found.points, [[0.25, 0.75]], atol=1e-6)
    assert found.status == "converged"


def _cloud(seed: int, n: int = 40) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    weights = rng.random(n) + 0.5
    return weights / weights.sum(), 0.2 * rng.normal(size=(n, 2)) + 0.5


@pytest.mark.parametrize("reach", [None, 0.4])
def test_one_measure_is_its_own_barycenter(any_backend, reach):
    weights, points = _cloud(0)
    found = clmorph.barycenter(
        [(weights, points)], None, (weights, points), 0.05, reach, backend=any_backend
    )
    np.testing.assert_allclose(found.points, points, atol=1e-4)
    np.testing.assert_allclose(found.weights, weights, atol=1e-4 / 40)


@pytest.mark.full
def test_gradient_of_the_divergences_vanishes(device):
    """Masses differ, and so do the measures' numbers of points."""
    measures = [_cloud(2, 30), (1.5 * _cloud(3, 45)[0], _cloud(3, 45)[1] + 0.2)]
    found = clmorph.barycenter(
        measures, [0.3, 0.7], 25, 0.1, 0.5, tol=1e-3, max_iter=400, backend=device
    )
    totals = np.zeros(25), np.zeros((25, 2))
    for share, measure in zip((0.3, 0.7), measures, strict=True):
        each = clmorph.sinkhorn_divergence(
            found, measure, 0.1, 0.5, tol=1e-5, gradient=True, backend=device
        ).gradient
        totals = totals[0] + share * each.source_weights, totals[1] + share * each.source_points
    assert np.abs(totals[0]).max() < 2e-3
    assert np.abs(totals[1] / found.weights[:, None]).max() < 2e-3


def test_measures_beyond_the_reach_keep_their_places(device):
    """The mass of each is a^kappa = w_k b_k^kappa, as if the others did not exist."""
    measures = [(np.full(6, 1 / 6), 0.1 * _cloud(seed, 6)[1]) for seed in (8, 9)]
    measures[1] = (measures[1][0], measures[1][1] + 50.0)
    found = clmorph.barycenter(
        measures, [0.5, 0.5], 12, 0.5, 1.0, tol=1e-3, max_iter=400, backend=device
    )
    kappa = (1 + 0.25) / (2 + 0.25)
    near = found.points[:, 0] < 25
    np.testing.assert_allclose(found.weights[near].sum(), 0.5 ** (1 / kappa), rtol=0.03)
    np.testing.assert_allclose(found.weights[~near].sum(), 0.5 ** (1 / kappa), rtol=0.03)


@pytest.mark.parametrize("debias", [True, False])
def test_a_long_reach_on_a_fixed_support_is_balanced(any_backend, debias):
    """Shapes are alike; masses, which balanced transport scales to 1, are so to the tolerance."""
    measures = [_bell(m, s) for m, s in zip((-0.2, 0.3), WIDTHS, strict=True)]
    options = {"support": LINE, "blur": 0.08, "fixed": True, "debias": debias, "tol": 1e-4}
    found, want = (
        clmorph.barycenter(measures, SHARES, reach=reach, backend=any_backend, **options)
        for reach in (3000.0, None)
    )
    assert found.n_iter == want.n_iter
    # Both iterations round the sums of devices in their own ways: a tenth of the tolerance.
    np.testing.assert_allclose(found.weights / found.mass, want.weights, rtol=1e-5, atol=1e-8)
    assert found.mass == pytest.approx(1.0, abs=1e-4)


@pytest.mark.full
def test_order_and_zero_shares_do_not_matter(device):
    measures = [_cloud(seed) for seed in (4, 5, 6)]
    start = _cloud(7)
    ways = (measures[:2], [0.3, 0.7]), (measures[::-1], [0, 7, 3])
    fixed = {"support": start[1], "blur": 0.2, "fixed": True}
    for options in ({"support": start, "blur": 0.1}, fixed, fixed | {"debias": False}):
        one, other = (clmorph.barycenter(*way, backend=device, **options) for way in ways)
        np.testing.assert_allclose(one.points, other.points, atol=1e-5)
        np.testing.assert_allclose(one.weights, other.weights, atol=1e-5)


def test_inexact_solves_are_told(monkeypatch):
    """Points that rest by solves that were stopped are not converged; one warning says so."""
    measures = [_cloud(0, 6), _cloud(1, 6)]
    options = {"blur": 0.05, "tol": 1e-3, "max_iter": 300, "backend": "numpy"}
    assert clmorph.barycenter(measures, **options).converged
    monkeypatch.setattr(free_support, "INNER_ITERATIONS", 3)
    with pytest.warns(ConvergenceWarning) as warned:
        found = clmorph.barycenter(measures, **options)
    assert len(warned) == 1
    assert found.status in ("precision", "max_iter")
    assert found.residual > options["tol"]


def test_same_seed_same_points():
    measures = [_cloud(4), _cloud(5)]
    options = {"blur": 0.2, "tol": 0.1, "backend": "numpy"}
    draws = [clmorph.barycenter(measures, None, 9, seed=s, **options) for s in (0, 0, 1)]
    np.testing.assert_array_equal(draws[0].points, draws[1].points)
    assert not np.array_equal(draws[0].points, draws[2].points)


class TestPeers:
    def test_fixed_support_without_debiasing(self):
        """POT's default method begins wrongly if shares are unequal (its pull request 870)."""
        x, shares = np.linspace(0, 1, 15)[:, None], np.array([0.5, 0.3, 0.2])
        histograms = np.random.default_rng(0).random((15, 3)) + 0.05
        histograms /= histograms.sum(axis=0)
        theirs = ot.bregman.barycenter(
            histograms, ot.dist(x, x), 2 * 0.1**2, weights=shares, method="sinkhorn_log",
            stopThr=1e-15, numItermax=10**5,
        )  # fmt: skip
        ours = clmorph.barycenter(
            [(each, x) for each in histograms.T], shares, x, 0.1, fixed=True, debias=False,
            tol=1e-13, max_iter=10**5, backend="numpy",
        )  # fmt: skip
        np.testing.assert_allclose(ours.weights, theirs, rtol=0, atol=1e-12)

    def test_free_support_of_exact_transport(self, device):
        """With a small blur points are where exact transport puts them."""
        rng = np.random.default_rng(3)
        clouds = [rng.random((8, 2)), rng.random((8, 2)) + np.array([1.0, 0.0])]
        even = np.full(8, 1 / 8)
        start = 0.5 * (clouds[0] + clouds[1][rng.permutation(8)])
        theirs = ot.lp.free_support_barycenter(clouds, [even, even], start, numItermax=100)
        ours = clmorph.barycenter(
            [(even, cloud) for cloud in clouds], None, theirs, 0.01, backend=device
        )
        np.testing.assert_allclose(ours.points, theirs, atol=5e-3)


class TestMistakes:
    @pytest.mark.parametrize(
        ("arguments", "words"),
        [
            ({"weights": [1]}, "one for each measure"),
            ({"weights": [0, 0]}, "not all 0"),
            ({"weights": [1, -1]}, "at least 0"),
            ({"weights": [1, np.nan]}, "finite"),
            ({"support": np.zeros((3, 3))}, "dimensions"),
            ({"support": 0}, "support=0"),
            ({"support": np.full((3, 2), 90.0), "reach": 0.2}, "no mass travels"),
            ({"fixed": True}, "needs its points"),
            ({"fixed": True, "support": np.full((3, 2), 90.0), "reach": 0.1}, "no mass travels"),
            ({"reach": (0.1, 0.2)}, "one number"),
            ({"blur": -1}, "blur"),
            ({"tol": 0}, "tol"),
            ({"max_iter": 0}, "max_iter"),
            ({"measures": []}, "the list is empty"),
            ({"measures": [_cloud(0), (np.ones(2), np.zeros((2, 2)))]}, "differ"),
            ({"measures": [_cloud(0), (np.ones(2) / 2, np.zeros((2, 3)))]}, "dimensions"),
        ],
    )
    def test_arguments(self, arguments, words):
        given = {"measures": [_cloud(0), _cloud(1)], "blur": 0.1, "backend": "numpy"} | arguments
        with pytest.raises(InputError, match=words):
            clmorph.barycenter(**given)

    def test_a_limit_of_iterations_is_reported(self):
        for fixed in (False, True):
            with pytest.warns(ConvergenceWarning, match="barycenter"):
                found = clmorph.barycenter(
                    [_cloud(0), _cloud(1)], None, _cloud(2)[1], 0.1, max_iter=2, tol=1e-6,
                    fixed=fixed, backend="numpy",
                )  # fmt: skip
            assert (found.status, found.n_iter, len(found.residuals)) == ("max_iter", 2, 2)
            assert np.isfinite(found.weights).all()
