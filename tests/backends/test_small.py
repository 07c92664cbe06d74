"""Every operation, and one solve, divergence and morph, at sizes for a simulator or a slow device.

``oclgrind pytest --device Oclgrind tests/backends/test_small.py`` runs them in a simulator.
"""

import numpy as np
import pytest
from exercise_kernels import exercise

from clmorph import lift, morph, sinkhorn, sinkhorn_divergence
from clmorph.reference import NumPyOperations

pytestmark = pytest.mark.small


def pictures(side):
    y, x = np.mgrid[:side, :side] / side
    one = np.stack([x, 0.5 + 0.5 * np.sin(7 * y), (x + y > 0.9) * 0.8], axis=-1)
    two = np.stack([y, (x - 0.5) ** 2, 0.5 + 0.5 * np.cos(9 * x)], axis=-1)
    return one, two[:, : side - 2]


def test_every_operation(each_device):
    for ours, theirs in zip(exercise(each_device), exercise(NumPyOperations()), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-5)


def test_a_solve(each_device):
    source, target = (lift(picture) for picture in pictures(9))
    ours, theirs = (sinkhorn(source, target, backend=backend) for backend in (each_device, "numpy"))
    assert ours.converged
    assert np.abs(ours.f - theirs.f).max() <= 0.03 * ours.epsilon


def test_a_divergence(each_device):
    source, target = (lift(picture) for picture in pictures(8))
    ours, theirs = (
        sinkhorn_divergence(source, target, backend=backend) for backend in (each_device, "numpy")
    )
    assert ours.value == pytest.approx(theirs.value, rel=1e-4, abs=1e-7)


def test_a_morph(each_device):
    ours, theirs = (
        morph(*pictures(9), n_frames=3, backend=backend) for backend in (each_device, "numpy")
    )
    for got, want in zip(ours.frames, theirs.frames, strict=True):
        assert np.abs(got - want).max() <= 1 / 255
