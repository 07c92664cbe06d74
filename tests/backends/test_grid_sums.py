"""Sums over grids: devices against NumPy, and NumPy against all pairs of cells."""

from dataclasses import replace

import numpy as np
import pytest

from clmorph.backends.numpy import NumPyOperations
from clmorph.backends.opencl.backend import OpenCLOperations
from clmorph.backends.opencl.kernels.launches import LaunchBudget
from clmorph.backends.opencl.verification.fields import SIZES, STEPS, grid_case

REFERENCE = NumPyOperations()


def over_pairs(exponents, axes):
    """The sum over all pairs, in long double."""
    places, cells = (
        np.stack(np.meshgrid(*side, indexing="ij"), -1).reshape(-1, len(axes)).astype(np.longdouble)
        for side in zip(*axes, strict=True)
    )
    terms = exponents.ravel() - ((places[:, None] - cells) ** 2).sum(-1)
    largest = terms.max(axis=1)
    found = largest + np.log(np.exp(terms - largest[:, None]).sum(axis=1))
    return found.reshape([len(x) for x, _ in axes])


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("sizes", SIZES, ids=str)
def test_numpy_sums_over_all_pairs(sizes, step):
    exponents, axes = grid_case(*sizes, step)
    found = REFERENCE.grid_log_sum_exp(exponents, axes)
    want = over_pairs(exponents, axes).astype(float)
    # Exponents near one are rounded before sums whose logarithm may be near zero.
    np.testing.assert_allclose(found, want, rtol=1e-13, atol=1e-14)


def test_without_float64_precise_sums_are_those_of_numpy(device):
    pairs = OpenCLOperations(
        device.device, replace(device.constants, precise=1, float64=0), verify=False
    )
    exponents, axes = grid_case(*SIZES[2], 0.6)
    want = REFERENCE.grid_log_sum_exp(exponents, axes)
    np.testing.assert_array_equal(pairs.grid_log_sum_exp(exponents, axes, True), want)
    assert np.abs(pairs.grid_log_sum_exp(exponents, axes) - want).max() < 1e-4


def test_results_do_not_depend_on_launches(each_device, monkeypatch):
    exponents, axes = grid_case((9, 14, 17), (11, 21, 8), 0.6)
    whole = each_device.grid_log_sum_exp(exponents, axes)
    monkeypatch.setattr(LaunchBudget, "pairs", lambda self: 777)
    np.testing.assert_array_equal(each_device.grid_log_sum_exp(exponents, axes), whole)


def test_many_cells_without_mass_are_left_out(each_device):
    """One mass among far more empty cells than float32 counts beside it."""
    exponents = np.full((64, 64), -np.inf)
    exponents[3, 60] = -1.0
    x = 0.5 * np.arange(64.0)
    found = each_device.grid_log_sum_exp(exponents, [(x, x), (x, x)])
    want = -1.0 - (x[:, None] - x[3]) ** 2 - (x - x[60]) ** 2
    np.testing.assert_allclose(found, want, rtol=2e-6, atol=1e-4)
