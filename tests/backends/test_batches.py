"""Soft minima of many problems at once, on each device against the NumPy twin."""

from dataclasses import replace

import numpy as np
import pytest
from clouds import PAIRS
from count_transfers import TransferCount

from clmorph.backends.numpy import NumPyOperations
from clmorph.backends.opencl.backend import OpenCLOperations
from clmorph.backends.opencl.build.variants import Variant
from clmorph.backends.opencl.kernels.launches import LaunchBudget
from clmorph.backends.opencl.verification.bench import log_sum_exp_tolerance
from clmorph.backends.opencl.verification.table import first_failure

REFERENCE = NumPyOperations()


def _upload(operations, pairs):
    return [
        operations.upload_batch(
            np.concatenate([pair[side][0] for pair in pairs]),
            np.concatenate([pair[side][1] for pair in pairs]),
            np.array([len(pair[side][1]) for pair in pairs]),
        )
        for side in range(2)
    ]


def _split(values, pairs, side):
    return np.split(values, np.cumsum([len(pair[side][1]) for pair in pairs])[:-1])


@pytest.mark.parametrize("blur", [0.3, 0.05, 0.01])
def test_a_batch_of_all_kinds_of_clouds(variant, rng, blur):
    """Each problem is within the tolerance of its own size, and within its own bound."""
    pairs, epsilon = [make(rng) for make in PAIRS.values()], blur**2
    g = np.concatenate(
        [0.2 * rng.random() + epsilon * rng.normal(size=len(b)) for _, (_, b) in pairs]
    )
    want, errors = REFERENCE.bounded_softmin(*_upload(REFERENCE, pairs), g, epsilon)
    ours = _upload(variant, pairs)
    for precise in (False, True):
        got = variant.softmin(*ours, g, epsilon, precise)
        parts = zip(PAIRS, pairs, _split(got, pairs, 0), _split(want, pairs, 0), strict=True)
        for name, pair, mine, exact in parts:
            tolerance = log_sum_exp_tolerance(variant, *pair, epsilon, precise)
            assert np.abs(mine - exact).max() / epsilon <= tolerance, name
    got, bounds = variant.bounded_softmin(*ours, g, epsilon)
    off = [np.abs(each).max() / epsilon for each in _split(got - want, pairs, 0)]
    assert np.all(off <= bounds + errors)
    # Other problems of the batch, far away or not, do not widen a bound.
    for number, pair in enumerate(pairs):
        clouds = [variant.upload(*cloud) for cloud in pair]
        own = _split(g, pairs, 1)[number]
        _, alone = variant.bounded_softmin(*clouds, own, epsilon)
        assert bounds[number] == pytest.approx(alone, rel=0.2)


def test_the_twin_does_what_single_problems_do(rng):
    pairs = [make(rng) for make in PAIRS.values()]
    g = rng.normal(size=sum(len(b) for _, (_, b) in pairs))
    got, errors = REFERENCE.bounded_softmin(*_upload(REFERENCE, pairs), g, 0.01)
    assert np.array_equal(got, REFERENCE.softmin(*_upload(REFERENCE, pairs), g, 0.01))
    parts = zip(pairs, _split(got, pairs, 0), _split(g, pairs, 1), errors, strict=True)
    for pair, mine, potential, error in parts:
        clouds = [REFERENCE.upload(*cloud) for cloud in pair]
        want, bound = REFERENCE.bounded_softmin(*clouds, potential, 0.01)
        assert np.array_equal(mine, want)
        assert error == bound


@pytest.mark.in_turns  # each dimension is a build of its own
@pytest.mark.parametrize("dimension", [1, 3, 6, 8, 10])  # others: `test_operations.py`
def test_in_any_dimension(variant, dimension):
    for kind in ((False, False, 0), (False, True, 0), (True, True, 0), (True, True, 1)):
        assert first_failure(variant, Variant("log_sum_exp.cl", dimension, *kind)) == ""


def test_offsets_add_to_the_cost(variant, rng):
    counts = np.array([70, 3, 1]), np.array([5, 130, 2])
    clouds = [
        (rng.random((count.sum(), 3)), rng.random(count.sum()), count, rng.normal(size=count.sum()))
        for count in counts
    ]
    g = rng.normal(size=counts[1].sum())
    got, want = (
        backend.softmin(*(backend.upload_batch(*cloud) for cloud in clouds), g, 0.1)
        for backend in (variant, REFERENCE)
    )
    assert np.abs(got - want).max() / 0.1 < 1e-4


def test_numbers_without_a_bound_are_told_for_their_problem_alone(variant, rng):
    counts = np.array([20, 20])
    points = np.concatenate((rng.random((20, 3)), 1e6 * rng.random((20, 3))))
    batch = variant.upload_batch(points, np.ones(40), counts)
    _, bounds = variant.bounded_softmin(batch, batch, np.zeros(40), 1e-2)
    assert bounds[0] < 1e-6 < bounds[1]


def _large(rng, operations):
    counts = np.full(40, 100)
    batches = [
        operations.upload_batch(rng.random((4000, 5)), np.full(4000, 0.01), counts)
        for _ in range(2)
    ]
    return batches, 0.1 * rng.random(4000)


def test_one_launch_for_all_problems(device, rng, monkeypatch):
    # After a slow launch, as on a busy machine, the next ones would be cut.
    monkeypatch.setattr(LaunchBudget, "pairs", lambda budget: 1 << 22)
    (rows, columns), g = _large(rng, device)
    device.softmin(rows, columns, g, 0.01)
    for call in (
        lambda: device.softmin(rows, columns, g, 0.01),
        lambda: device.bounded_softmin(rows, columns, g, 0.01),
        lambda: device.take_batch(rows, np.array([1, 5])),
    ):
        with TransferCount() as count:
            call()
        assert count.n_launches <= 1


def test_launches_are_cut_without_changing_a_bit(variant, monkeypatch, rng):
    (rows, columns), g = _large(rng, variant)
    whole = variant.softmin(rows, columns, g, 0.01)
    monkeypatch.setattr(LaunchBudget, "pairs", lambda self: 1)
    assert np.array_equal(variant.softmin(rows, columns, g, 0.01), whole)


@pytest.mark.one_device
def test_where_loops_end_early(device, rng):
    """Columns of a row are then taken in several launches."""
    short = OpenCLOperations(
        device.device, replace(device.constants, longest_loop=3000), verify=False
    )
    pairs = [
        tuple((rng.random((n, 3)), np.full(n, 1 / n)) for n in sizes)
        for sizes in ((70, 900), (1, 1), (300, 65))
    ]
    g = 0.01 * rng.normal(size=966)
    got = short.softmin(*_upload(short, pairs), g, 0.01)
    want = REFERENCE.softmin(*_upload(REFERENCE, pairs), g, 0.01)
    assert np.abs(got - want).max() / 0.01 < 1e-4
