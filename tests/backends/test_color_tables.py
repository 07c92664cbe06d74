"""Colors after a table: devices against NumPy, and NumPy against the formula."""

import numpy as np
import pytest

from clmorph.backends.numpy import NumPyOperations
from clmorph.backends.opencl.kernels.launches import LaunchBudget
from clmorph.backends.opencl.verification.fields import colors_of, table_of

REFERENCE = NumPyOperations()


def by_formula(table, color):
    """One color, corner by corner, in float64."""
    n = len(table)
    place = np.clip(color.astype(float), 0, 1) * (n - 1)
    corner = np.minimum(place.astype(int), n - 2)
    rest = place - corner
    before, total = 1.0, np.zeros(3)
    for axis in sorted(range(3), key=lambda axis: -rest[axis]):
        total += (before - rest[axis]) * table[tuple(corner)]
        before = rest[axis]
        corner[axis] += 1
    return total + before * table[tuple(corner)]


@pytest.mark.parametrize("nodes", [2, 3, 33])
def test_numpy_is_the_formula(nodes):
    table, colors = table_of(nodes), colors_of(100, nodes)
    want = [by_formula(table, color) for color in colors]
    got = REFERENCE.apply_table(REFERENCE.upload_table(table), colors)
    np.testing.assert_allclose(got, want, rtol=0, atol=1e-6)


@pytest.mark.parametrize("nodes", [2, 17, 33, 65])
def test_a_table_of_its_own_colors_changes_nothing(each_device, nodes):
    levels = np.linspace(0, 1, nodes)
    table = np.stack(np.meshgrid(levels, levels, levels, indexing="ij"), axis=-1)
    colors = np.random.default_rng(0).integers(0, 256, (5000, 3)) / np.float32(255)
    for backend in (each_device, REFERENCE):
        on_device = backend.upload_table(table.astype(np.float32))
        got = backend.apply_table(on_device, colors.astype(np.float32))
        assert np.abs(got - colors).max() < 1e-6


def test_results_do_not_depend_on_launches(each_device, monkeypatch):
    table, colors = table_of(33), colors_of(2000, 33)
    on_device = each_device.upload_table(table)
    whole = each_device.apply_table(on_device, colors)
    monkeypatch.setattr(LaunchBudget, "pairs", lambda self: 77)
    np.testing.assert_array_equal(each_device.apply_table(on_device, colors), whole)
    alone = [each_device.apply_table(on_device, color[None])[0] for color in colors[:20]]
    np.testing.assert_array_equal(alone, whole[:20])
