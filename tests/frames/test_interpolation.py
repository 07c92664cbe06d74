import numpy as np
import pytest
from plain import lift, sinkhorn

from clmorph import InputError, particles, transport_plan


@pytest.fixture(scope="module", params=[0.05, 0.3, 1.0, None])
def parts(request):
    rng = np.random.default_rng(5)
    source, target = lift(rng.random((9, 8, 3))), lift(rng.random((7, 11, 3)))
    potentials = sinkhorn(source, target, 0.1, request.param, backend="numpy")
    plan = transport_plan(source, target, potentials, backend="numpy")
    return source, target, plan, particles(source, target, plan)


def test_both_ends_have_the_images_masses(parts):
    source, target, _, moving = parts
    for column, measure, offset in ((0, source, 0), (1, target, len(source))):
        points = moving.links[:, column].astype(int)
        here = moving.weights[:, column] > 0
        mass = np.bincount(points[here] - offset, moving.weights[here, column], len(measure))
        assert np.allclose(mass, measure.weights, rtol=1e-9)
        assert moving.mass(float(column)) == pytest.approx(measure.mass)
    assert np.all(moving.weights >= 0)


def test_both_ends_stand_on_the_pixels(parts):
    source, target, plan, moving = parts
    starts, ends = (moving.table[each] for each in moving.links[: len(plan)].T)
    assert np.array_equal(starts[:, :2], source.positions[plan.rows])
    assert np.array_equal(starts[:, 2:5], source.colors[plan.rows])
    assert np.array_equal(ends[:, 2:5], target.colors[plan.indices])


def test_unmatched_mass_rests(parts):
    *_, plan, moving = parts
    assert np.array_equal(moving.links[len(plan) :, 0], moving.links[len(plan) :, 1])


def test_dropping_unmatched_mass_leaves_the_plan(parts):
    source, target, plan, _ = parts
    moving = particles(source, target, plan, unmatched="drop")
    assert len(moving) == len(plan)
    assert np.array_equal(moving.weights, np.column_stack((plan.mass, plan.mass)))
    with pytest.raises(InputError, match="fade"):
        particles(source, target, plan, unmatched="forget")
