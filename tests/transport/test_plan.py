import dataclasses
from functools import partial

import numpy as np
import pytest
from plain import lift, reference, sinkhorn

from clmorph import InputError, WeightedPoints, displacement_statistics, particles, transport_plan
from clmorph.transport.plan_building import check_reachable


@pytest.fixture(scope="module")
def pair():
    rng = np.random.default_rng(3)
    source, target = lift(rng.random((9, 8, 3))), lift(rng.random((7, 11, 3)))
    potentials = sinkhorn(source, target, 0.1, 0.4, backend="numpy")
    return source, target, potentials, reference.transport_plan(source, target, potentials)


def test_against_the_dense_plan(device, pair):
    source, target, potentials, dense = pair
    plan = transport_plan(source, target, potentials, relative=1e-3, backend=device)
    sparse = plan.to_scipy()
    assert sparse.shape == dense.shape
    got = sparse.toarray()
    kept = got > 0
    assert np.allclose(got[kept], dense[kept], rtol=1e-4)
    # Kept: at least a thousandth of the largest of its row or of its column.
    wanted = np.minimum(dense.max(axis=1, keepdims=True), dense.max(axis=0, keepdims=True))
    assert np.all(dense[~kept] <= wanted[~kept] * 1e-3 * (1 + 1e-3))
    assert np.all(dense[kept] >= wanted[kept] * 1e-3 * (1 - 1e-3))
    assert plan.total_mass == pytest.approx(dense.sum(), rel=1e-5)
    assert plan.dropped_mass == pytest.approx(1 - dense[kept].sum() / dense.sum(), abs=1e-5)
    assert np.allclose(plan.row_mass, got.sum(axis=1))
    assert np.allclose(plan.column_mass, got.sum(axis=0))


def test_faint_points_keep_their_pairs(device):
    """A threshold on the global maximum would silence them."""
    rng = np.random.default_rng(0)
    weights = 10 ** rng.uniform(-10, 0, (8, 8))
    source, target = lift(rng.random((8, 8, 3)), weights=weights), lift(rng.random((8, 8, 3)))
    potentials = sinkhorn(source, target, 0.2, 0.5, backend=device)
    plan = transport_plan(source, target, potentials, backend=device)
    assert np.all(np.diff(plan.indptr) > 0)
    assert np.all(plan.column_mass > 0)


def test_a_threshold_that_no_pair_exceeds(device, pair):
    source, target, potentials, dense = pair
    largest = f"{np.log(dense).max():.4g}"
    for function in (partial(transport_plan, backend=device), reference.transport_plan):
        with pytest.raises(InputError, match=f"the largest log pi is {largest}; lower it"):
            function(source, target, potentials, log_threshold=5.0)


def test_no_rounding_decides_about_the_papers_threshold(device, pair):
    """Pairs whose log pi is the threshold itself, or next to it, are on the side of float64."""
    source, target, potentials, dense = pair
    order = np.argsort(dense, axis=None)
    for place in (order.size // 3, order.size // 2, order.size - 20):
        i, j = np.unravel_index(order[place], dense.shape)
        cost = 0.5 * np.sum((source.points[i] - target.points[j]) ** 2)
        exactly = (potentials.f[i] + potentials.g[j] - cost) / potentials.epsilon
        exactly += np.log(source.weights[i]) + np.log(target.weights[j])
        for tau in (exactly, np.nextafter(exactly, -np.inf), exactly + 1e-9):
            plan = transport_plan(source, target, potentials, log_threshold=tau, backend=device)
            want = reference.transport_plan(source, target, potentials, log_threshold=tau)
            assert np.array_equal(plan.to_scipy().toarray() > 0, want > 0)
            assert (want[i, j] > 0) == (tau < exactly)


def test_a_threshold_of_a_cost_with_a_map_of_metrics(device, rng):
    """Such a cost has offsets beside the distance of points."""
    metrics = np.eye(3) + 0.3 * rng.random((6, 7, 1, 1)) * np.ones((3, 3))
    source, target = lift(rng.random((6, 7, 3)), color_metric=metrics), lift(rng.random((5, 8, 3)))
    potentials = sinkhorn(source, target, 0.2, 0.4, backend=device)
    plan = transport_plan(source, target, potentials, log_threshold=-8.0, backend=device)
    want = reference.transport_plan(source, target, potentials, log_threshold=-8.0)
    assert 20 < (want > 0).sum() < want.size - 20
    assert np.array_equal(plan.to_scipy().toarray() > 0, want > 0)


def test_what_no_pair_can_exceed_is_known_beforehand(rng):
    """For any masses and strengths: log pi stays below the bound, and gets near it."""
    nearness = []
    for reach in (0.05, 1.0, None, (0.1, None), (None, 0.1)):
        for factor in (1.0, 0.1, 30.0):
            points, weights = rng.random((5, 2)), rng.random((2, 5))
            measures = [WeightedPoints(points, factor * part / part.sum()) for part in weights]
            potentials = sinkhorn(*measures, 0.02, reach, 1e-6, 10_000, backend="numpy")
            dense = reference.transport_plan(*measures, potentials)
            largest = np.log(dense.max())
            check_reachable(largest - 1e-6, *measures)
            masses = [np.log(measure.weights.max()) for measure in measures]
            bound = max(*masses, sum(masses))
            assert largest < bound + 1e-6
            nearness.append(bound - largest)
            with pytest.raises(InputError, match=r"log pi is below .*; lower it"):
                check_reachable(bound + 1e-9, *measures)
    assert min(nearness) < 0.3


def test_relative_to_the_whole_plan(device, pair):
    """The paper's code: one threshold, so bright rows silence faint ones."""
    source, target, potentials, dense = pair
    options = {"relative": 1e-2, "relative_to": "plan", "backend": device}
    got = transport_plan(source, target, potentials, **options).toarray() > 0
    share = dense / dense.max()
    clear = np.abs(np.log(share / 1e-2)) > 1e-3
    assert np.array_equal(got[clear], (share > 1e-2)[clear])


def test_reports(device, pair):
    source, target, potentials, dense = pair
    plan = transport_plan(source, target, potentials, relative=0.05, backend=device)
    kept = plan.to_scipy().toarray()
    rows = 1 - kept.sum(axis=1) / dense.sum(axis=1)
    assert np.allclose(plan.dropped_row_mass, rows, atol=1e-4)
    assert plan.worst_dropped_row_mass == pytest.approx(rows.max(), abs=1e-4)
    assert plan.worst_dropped_row_mass > plan.dropped_mass > 1e-3
    assert np.allclose(plan.whole_row_mass, dense.sum(axis=1), rtol=1e-4)
    assert np.allclose(plan.whole_column_mass, dense.sum(axis=0), rtol=1e-4)
    assert plan.nbytes == 12 * len(plan) + 8 * (len(source) + 1)
    assert "dropped" in repr(plan)


def test_too_many_pairs_are_refused_before_they_are_written(device, pair, monkeypatch):
    source, target, potentials, _ = pair
    plan = transport_plan(source, target, potentials, backend=device)
    exactly = 12 * len(plan)
    again = transport_plan(source, target, potentials, max_bytes=exactly, backend=device)
    assert len(again) == len(plan)
    monkeypatch.setattr(device, "plan_rows", None)
    with pytest.raises(InputError, match=f"would keep {len(plan)} pairs.*max_bytes") as caught:
        transport_plan(source, target, potentials, max_bytes=exactly - 1, backend=device)
    assert "\n" not in str(caught.value)


def test_displacements(device, pair):
    source, target, potentials, dense = pair
    plan = transport_plan(source, target, potentials, relative=1e-9, backend=device)
    got = displacement_statistics(source, target, plan)
    mass = dense.sum(axis=1)
    field = (dense @ target.positions / mass[:, None] - source.positions) * 8  # 9 x 8 pixels
    assert np.allclose(got.field.reshape(-1, 2), field, atol=1e-3)
    length = np.hypot(*field.T)
    assert got.max == pytest.approx(length.max(), rel=1e-3)
    assert got.mean == pytest.approx(length.mean(), rel=1e-3)
    assert got.mass_weighted_mean == pytest.approx((length * mass).sum() / mass.sum(), rel=1e-3)
    assert got.source_mass.shape == got.destroyed.shape == (9, 8)
    assert got.target_mass.shape == got.created.shape == (7, 11)
    assert np.allclose(got.destroyed.ravel(), np.maximum(source.weights - mass, 0), atol=1e-6)
    columns = dense.sum(axis=0)
    assert np.allclose(got.created.ravel(), np.maximum(target.weights - columns, 0), atol=1e-6)
    assert "pixels" in repr(got)


def test_the_mask_of_table_1(pair):
    source, target, potentials, _ = pair
    plan = transport_plan(source, target, potentials, backend="numpy")
    cut = float(np.median(plan.whole_row_mass))
    got = displacement_statistics(source, target, plan, mask=cut)
    rests = plan.whole_row_mass.reshape(source.shape) <= cut
    assert 0 < rests.sum() < rests.size
    assert np.all(got.length[rests] == 0)
    assert np.all(got.length[~rests] > 0)
    assert displacement_statistics(source, target, plan, mask=1.0).max == 0
    everything = displacement_statistics(source, target, plan)
    assert everything.max >= got.max


def test_stretched_axes_count_as_the_paper_does(rng):
    source, target = (lift(rng.random((4, 6, 3)), extent="unit") for _ in range(2))
    potentials = sinkhorn(source, target, 0.1, 0.4, backend="numpy")
    plan = transport_plan(source, target, potentials, backend="numpy")
    got = displacement_statistics(source, target, plan)
    dense = plan.to_scipy().toarray()
    field = dense @ target.positions / dense.sum(axis=1)[:, None] - source.positions
    assert np.allclose(got.field.reshape(-1, 2), field * [6, 4])


def test_displacements_need_images_and_their_plan(pair):
    source, target, potentials, _ = pair
    plan = transport_plan(source, target, potentials, backend="numpy")
    with pytest.raises(InputError, match="build it for these"):
        displacement_statistics(target, source, plan)
    with pytest.raises(InputError, match="mask"):
        displacement_statistics(source, target, plan, mask=-1)


def test_wrong_options(pair):
    source, target, potentials, _ = pair
    for relative in (0, -1, 2, np.nan):
        with pytest.raises(InputError, match="relative"):
            transport_plan(source, target, potentials, relative=relative, backend="numpy")
    for options in ({"relative_to": "columns"}, {"max_bytes": 0}, {"max_bytes": np.nan}):
        with pytest.raises(InputError, match=next(iter(options))):
            transport_plan(source, target, potentials, backend="numpy", **options)


def shifted(potentials, nats):
    """Potentials of plans with so many more nats of mass."""
    certificate = potentials.certificate._replace(row_mass=potentials.row_mass * np.exp(nats))
    f = potentials.f + nats * potentials.epsilon
    return dataclasses.replace(potentials, f=f, certificate=certificate)


def test_potentials_far_from_a_solution_are_refused(pair):
    source, target, potentials, _ = pair
    with pytest.raises(InputError, match="too far from a solution"):
        transport_plan(source, target, shifted(potentials, 100), backend="numpy")


def test_a_plan_without_mass_is_empty(device, pair):
    source, target, potentials, _ = pair
    plan = transport_plan(source, target, shifted(potentials, -1000), backend=device)
    assert len(plan) == 0
    assert plan.total_mass == 0
    assert plan.dropped_mass == 0
    assert plan.to_scipy().nnz == 0
    moving = particles(source, target, plan)
    assert moving.mass(0.0) == pytest.approx(source.mass)
    with pytest.raises(InputError, match="nothing travels"):
        particles(source, target, plan, unmatched="drop")
