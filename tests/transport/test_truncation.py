"""Compare sums over near pairs with sums over all pairs: the error is within the stated bound."""

import pickle
from dataclasses import replace

import numpy as np
import plain
import pytest
from clouds import drawings, of_kind
from hypothesis import example, given, settings
from hypothesis import strategies as st
from plain import sinkhorn
from residuals import true_errors

import clmorph
from clmorph.backends.numpy import NumPyOperations
from clmorph.pipeline.budget import predict_pairs
from clmorph.transport._solver.softmin import LEAST_RESERVE, MANY_PAIRS, Softmin, many_pairs

MANY = settings(max_examples=60, deadline=None, derandomize=True)
BLURS = [0.005, 0.02, 0.05, 0.15, 0.5]
REACHES = [0.05, 0.3, 2.0, None]
CLOUDS = ["random", "picture", "equal", "line", "two far clusters", "many clusters", "ten orders"]


def pair_of(*given):
    return [(weights / weights.sum(), points) for weights, points in of_kind(*given)]


@pytest.mark.parametrize("backend", ["numpy", "auto"])
@pytest.mark.parametrize("multiscale", [False, True])
@MANY
@given(
    st.integers(0, 10**6), st.sampled_from(CLOUDS), st.sampled_from(BLURS),
    st.sampled_from(REACHES), st.sampled_from([1e-4, 1e-2]),
)  # fmt: skip
# Pairs left out and float32 powers together were above the truncation.
@pytest.mark.full
@pytest.mark.filterwarnings("ignore::clmorph.ConvergenceWarning")
@example(1, "ten orders", 0.15, None, 1e-4)
def test_everything_said_holds_over_all_pairs(backend, multiscale, seed, kind, blur, reach, budget):
    rng = np.random.default_rng(seed)
    pair = pair_of(kind, rng, *rng.integers(1, 200, 2))
    tol = 10 * budget
    got = sinkhorn(*pair, blur, reach, tol, 60, backend, truncation=budget, multiscale=multiscale)
    assert got.truncation == budget
    assert 0 <= got.truncation_error <= budget + 1e-6
    assert 0 < got.visited <= 1
    residual, certificate = true_errors(pair, got)
    # The reference's own, in float64.
    rounding = 1e-10
    assert residual <= got.residual + rounding
    # Masses are missing by no more than is said.
    missing = np.log(np.maximum(certificate.row_mass, 1e-280) / np.maximum(got.row_mass, 1e-280))
    assert missing.min() >= -got.truncation_error - rounding
    assert missing.max() <= got.truncation_error + rounding
    # Bounds stay bounds: the values of these very potentials are within.
    slack = 1e-12 * (abs(certificate.primal) + abs(certificate.dual) + got.epsilon)
    assert got.dual <= certificate.dual + slack
    assert certificate.primal <= got.primal + slack
    assert got.gap == got.primal - got.dual >= 0
    assert certificate.marginal_error <= got.marginal_error * (1 + rounding) + rounding


@pytest.mark.parametrize("kind", CLOUDS)
def test_with_and_without_agree(device, rng, kind):
    pair = pair_of(kind, rng, 700, 900)
    tol = 1e-4
    got = sinkhorn(*pair, 0.05, 0.3, tol, 5000, device, truncation=1e-5)
    want = sinkhorn(*pair, 0.05, 0.3, tol, 5000, device, truncation=None)
    assert got.converged
    assert want.converged
    # A residual r leaves potentials off by up to r / (1 - contraction).
    worst = 2 * (tol + 1e-5) / (1 - (0.09 / (0.09 + 0.0025)) ** 2)
    assert np.abs(got.f - want.f).max() <= worst * got.epsilon
    assert np.abs(got.g - want.g).max() <= worst * got.epsilon
    rounding = 2e-5 * got.epsilon * got.transported_mass
    assert max(got.dual, want.dual) - rounding <= min(got.primal, want.primal)


def test_far_pairs_are_left_out(device, rng):
    pair = pair_of("many clusters", rng, 2000, 2000)
    got = sinkhorn(*pair, 0.01, 0.05, 1e-3, 5000, device, truncation=1e-4)
    assert got.converged
    assert got.visited < 0.3


def test_verify_takes_all_pairs(device, rng):
    pair = pair_of("picture", rng, 1500, 1300)
    got = sinkhorn(*pair, 0.02, 0.3, 1e-2, backend=device, truncation=1e-3, verify=True)
    assert (got.truncation, got.visited) == (1e-3, 1.0)
    assert got.truncation_error < 1e-8
    residual, certificate = true_errors(pair, got)
    assert residual - 1e-10 <= got.residual <= residual + 1e-7
    assert got.dual == pytest.approx(certificate.dual, rel=1e-8)


def test_lists_serve_until_potentials_have_moved_too_far(rng, monkeypatch):
    """The bound holds on the way, and lists are made anew only when it must be."""
    backend = clmorph.get_backend("numpy")
    (a, x), (b, y) = pair_of("picture", rng, 200, 300)
    clouds, epsilon, budget = (backend.upload(x, a), backend.upload(y, b)), 0.0004, 1e-3
    softmin = Softmin(backend, *clouds, (a, b), budget)
    g = backend.softmin(*clouds[::-1], np.zeros(200), epsilon)
    made, near_pairs = [], backend.near_pairs
    monkeypatch.setattr(backend, "near_pairs", lambda *a: made.append(1) or near_pairs(*a))
    direction = rng.normal(size=300)
    for step in np.concatenate((np.zeros(2), np.linspace(0, 20, 60))):
        potential = g + step * epsilon * direction
        got = softmin(potential, epsilon)
        want = backend.softmin(*clouds, potential, epsilon)
        assert 0 <= softmin.left_out <= budget
        missing = (got - want) / epsilon
        assert missing.min() >= -1e-12
        assert missing.max() <= softmin.left_out + 1e-12
    assert 2 <= len(made) < 30
    count = len(made)
    softmin(potential, epsilon)  # the same again: nothing moved
    assert len(made) == count


def test_settled_potentials_have_fewer_near_pairs(rng):
    """Pairs for far moves are chosen anew once, for near ones; both leave out what they say."""
    backend = clmorph.get_backend("numpy")
    (a, x), (b, y) = pair_of("picture", rng, 300, 400)
    clouds, epsilon, budget = (backend.upload(x, a), backend.upload(y, b)), 0.0004, 1e-3
    g = backend.softmin(*clouds[::-1], np.zeros(300), epsilon)
    want = backend.softmin(*clouds, g, epsilon)
    softmin = Softmin(backend, *clouds, (a, b), budget)
    softmin.reserve = LEAST_RESERVE
    counts = []
    for residual in (1.0, 0.5, 0.01, 0.001):
        got = softmin(g, epsilon)
        missing = (got - want) / epsilon
        assert -1e-12 <= missing.min() <= missing.max() <= softmin.left_out + 1e-12
        assert softmin.left_out <= budget
        assert softmin.near is not None
        counts.append(softmin.near.n_pairs)
        softmin.settle(residual)
    assert counts[0] == counts[1] == counts[2] > counts[3]
    softmin(g, epsilon)
    assert softmin.near.n_pairs == counts[3]  # not again


def plans(pair, potentials, backend):
    """The plan, draws from it and its means."""
    return (
        clmorph.transport_plan(*pair, potentials, backend=backend),
        clmorph.sample_plan(*pair, potentials, 4, backend=backend),
        clmorph.barycentric_plan(*pair, potentials, backend=backend),
    )


def test_plans_of_truncated_potentials(device, monkeypatch):
    """The same pairs as without, up to those at the threshold; draws and means alike."""
    monkeypatch.setattr("clmorph.backends.opencl.kernels.plan_rows.LISTED_FROM", 0)
    pair = [plain.lift(each) for each in drawings(40)]
    potentials = sinkhorn(*pair, 0.05, 0.3, backend=device, truncation=1e-6)
    plan, draws, means = plans(pair, potentials, device)
    whole, other_draws, other_means = plans(pair, replace(potentials, truncation=None), device)
    difference = np.abs(plan.toarray() - whole.toarray())
    assert difference.max() <= 2e-4 * whole.mass.max()
    assert difference.sum() <= 1e-4 * whole.mass.sum()
    assert np.abs(means.positions - other_means.positions).max() <= 1e-4
    assert np.allclose(means.column_mass, other_means.column_mass, rtol=1e-4)
    places = [measure.positions for measure in pair]
    ends = [each.mean_destinations(*places)[0] for each in (draws, other_draws)]
    assert np.mean(np.abs(ends[0] - ends[1])) <= 0.01


def test_divergences_of_many_points_are_truncated_and_stay_bounded(device, monkeypatch, rng):
    pair = pair_of("picture", rng, 500, 600)
    want = plain.sinkhorn_divergence(*pair, 0.05, 0.3, 1e-4, backend=device)
    assert want.cross.truncation is want.source_self.truncation is None
    monkeypatch.setattr("clmorph.transport._solver.softmin.MANY_PAIRS", 0)
    got = plain.sinkhorn_divergence(*pair, 0.05, 0.3, 1e-4, backend=device)
    for part in (got.cross, got.source_self, got.target_self):
        assert part.truncation == pytest.approx(1e-5)
        assert part.truncation_error <= part.truncation + 1e-8
        assert part.converged
    assert max(got.interval[0], want.interval[0]) <= min(got.interval[1], want.interval[1])


@pytest.mark.parametrize(
    ("rate", "factor"), [(0.0, 1), (4e9, 1), (1e11, 8), (3e11, 64), (1.2e12, 64), (1e14, 64)]
)
def test_a_fast_card_sums_more_pairs_without_truncation(monkeypatch, rng, rate, factor):
    """By its recorded rate; a processor, whatever its rate is, does as before."""
    operations = NumPyOperations()
    operations.pairs_per_second = rate
    assert many_pairs(operations) == MANY_PAIRS
    operations.on_processor = False
    assert many_pairs(operations) == factor * MANY_PAIRS
    monkeypatch.setattr("clmorph.transport._solver.softmin.MANY_PAIRS", 301)
    source, target = pair_of("picture", rng, 40, 60)
    found = sinkhorn(source, target, 0.2, 0.3, 1e-2, backend=operations)
    assert (found.truncation is None) == (factor > 1)


@pytest.mark.parametrize("value", ["much", -1.0, 0.0, 0.5, np.nan, [1e-4], 1e-3, 0.09])
def test_wrong_options(value):
    one = plain.lift(np.zeros((2, 2)))
    with pytest.raises(clmorph.InputError, match="truncation"):
        sinkhorn(one, one, backend="numpy", truncation=value)


def test_a_plan_takes_over_the_pairs_of_the_solve(device, monkeypatch, rng):
    """Nothing is chosen again, results agree, and other measures are still noticed."""
    pair = pair_of("picture", rng, 500, 600)
    kept = sinkhorn(*pair, 0.05, 0.3, backend=device, multiscale=True, truncation=1e-5, tol=1e-4)
    fresh = pickle.loads(pickle.dumps(kept))
    assert kept.passes is not None
    assert fresh.passes is None
    want = plans(pair, fresh, device)
    chosen, near_pairs = [], device.near_pairs
    monkeypatch.setattr(device, "near_pairs", lambda *a: chosen.append(1) or near_pairs(*a))
    got = plans(pair, kept, device)
    assert not chosen
    for one, other in zip(got, want, strict=True):
        np.testing.assert_allclose(one.column_mass, other.column_mass, rtol=1e-3, atol=1e-5)
    np.testing.assert_allclose(got[0].toarray(), want[0].toarray(), rtol=1e-3, atol=1e-9)
    np.testing.assert_allclose(got[2].positions, want[2].positions, rtol=1e-3, atol=1e-3)
    plans(pair, fresh, device)
    plans(pair, replace(kept, g=kept.g.copy()), device)  # other potentials than of the solve
    assert len(chosen) == 12
    with pytest.raises(clmorph.InputError, match="other measures"):
        clmorph.sample_plan(pair[0], (pair[1][0], pair[1][1] + 0.1), kept, 4, backend=device)


def test_clouds_of_a_large_solve_are_uploaded_once(device, monkeypatch, rng):
    """The number of pairs and the plan take those of the solve; other measures have their own."""
    pair, backend = pair_of("picture", rng, 500, 600), clmorph.get_backend(device)
    uploaded, upload = [], backend.upload
    monkeypatch.setattr(backend, "upload", lambda x, *a: uploaded.append(len(x)) or upload(x, *a))
    found = clmorph.sinkhorn(*pair, 0.05, 0.3, truncation=1e-4, backend=backend)
    count = predict_pairs(*pair, found, rows=10, backend=backend)
    plan = clmorph.transport_plan(*pair, found, backend=backend)
    assert uploaded == [500, 600, 10, 10]
    assert count > 0
    copies = [(weights, points.copy()) for weights, points in pair]
    again = clmorph.transport_plan(*copies, found, backend=backend)
    assert np.array_equal(again.mass, plan.mass)
    assert len(uploaded) == 4  # equal points are the same measures
    alone = clmorph.transport_plan(*pair, replace(found, passes=None), backend=backend)
    assert uploaded[4:] == [500, 600]
    assert np.allclose(alone.mass.sum(), plan.mass.sum(), rtol=1e-3)
