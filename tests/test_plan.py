import dataclasses

import numpy as np
import pytest

from clmorph import InputError, lift, particles, reference, sinkhorn, transport_plan


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


def test_the_papers_threshold(device, pair):
    source, target, potentials, dense = pair
    plan = transport_plan(source, target, potentials, log_threshold=-9.0, backend=device)
    got = plan.to_scipy().toarray() > 0
    clear = np.abs(np.log(dense) + 9) > 1e-3
    assert np.array_equal(got[clear], (np.log(dense) > -9)[clear])
    with pytest.raises(InputError, match="lower it"):
        transport_plan(source, target, potentials, log_threshold=5.0, backend=device)


def test_wrong_options(pair):
    source, target, potentials, _ = pair
    with pytest.raises(InputError, match="potentials are for"):
        transport_plan(target, source, potentials, backend="numpy")
    for relative in (0, -1, 2, np.nan):
        with pytest.raises(InputError, match="relative"):
            transport_plan(source, target, potentials, relative=relative, backend="numpy")


def test_the_default_threshold_drops_little(device, pair):
    source, target, potentials, _ = pair
    plan = transport_plan(source, target, potentials, backend=device)
    assert plan.dropped_mass < 1e-3
    assert len(plan) < len(source) * len(target)


def test_potentials_far_from_a_solution_are_refused(pair):
    source, target, potentials, _ = pair
    wrong = dataclasses.replace(potentials, f=potentials.f + 100 * potentials.epsilon)
    with pytest.raises(InputError, match="too far from a solution"):
        transport_plan(source, target, wrong, backend="numpy")


def test_a_plan_without_mass_is_empty(device, pair):
    source, target, potentials, _ = pair
    nothing = dataclasses.replace(potentials, f=potentials.f - 1000 * potentials.epsilon)
    plan = transport_plan(source, target, nothing, backend=device)
    assert len(plan) == 0
    assert plan.total_mass == 0
    assert plan.dropped_mass == 0
    assert plan.to_scipy().nnz == 0
    moving = particles(source, target, plan)
    assert moving.mass(0.0) == pytest.approx(source.mass)
    with pytest.raises(InputError, match="nothing travels"):
        particles(source, target, plan, unmatched="drop")
