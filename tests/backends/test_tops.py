"""On cards tiles that cannot raise a row's maximum are summed without looking for it."""

import numpy as np
import pytest

from clmorph.backends.opencl.backend import OpenCLOperations
from clmorph.backends.opencl.build import program
from clmorph.backends.opencl.build.constants import apply_quirks, gpu_constants
from clmorph.backends.opencl.build.variants import Variant
from clmorph.backends.opencl.devices.quirks import find_quirks
from clmorph.backends.opencl.verification.table import first_failure
from clmorph.backends.rounding import rounding_error
from clmorph.reference import NumPyOperations

BELOW = "few = sum_of(few, power_above(exponent(u, staged, columns[c]), m));"


def operations(device):
    """The build of cards, on any device."""
    constants = apply_quirks(gpu_constants(256), find_quirks(device.device))
    made = OpenCLOperations(device.device, constants, verify=False)
    assert constants.stacks(5, False) > 1
    return made


def with_source(monkeypatch, change):
    real = program.source
    monkeypatch.setattr(program, "source", lambda file: change(real(file)))
    monkeypatch.setenv("PYOPENCL_NO_CACHE", "1")


@pytest.mark.parametrize("blur", [0.005, 0.05, 2.0])
@pytest.mark.parametrize("dimension", [1, 5])
def test_sums_have_the_bits_of_those_with_a_running_maximum(
    each_device, monkeypatch, rng, dimension, blur
):
    """Of clusters far apart, equal points, masses of 12 decades, and tiles without any."""
    places = rng.random((12, dimension))
    points = np.repeat(places, 60, axis=0) + 0.02 * rng.normal(size=(720, dimension))
    points[:200] = points[0]
    others = np.concatenate((rng.random((500, dimension)), points[-333:]))
    masses = 10 ** rng.uniform(-12, 0, len(others))
    masses[64:192] = 0
    g = 10 * blur**2 * rng.normal(size=len(others))
    g[::50] += 0.5  # tiles that raise the maximum by far stand among others

    def result(backend):
        rows = backend.upload(points, np.full(len(points), 1 / len(points)))
        columns = backend.upload(others, masses)
        return backend.softmin(rows, columns, g, blur**2)

    ours = result(operations(each_device))
    macros = Variant.macros
    monkeypatch.setattr(Variant, "macros", lambda *given: macros(*given) | {"TOPS": 0})
    np.testing.assert_array_equal(ours, result(operations(each_device)))
    largest = 0.5 * (np.ptp(np.concatenate((points, others)), axis=0) ** 2).sum()
    rounding = rounding_error(each_device, len(others), largest / blur**2, False)
    assert np.abs(ours - result(NumPyOperations())).max() <= rounding * blur**2


def test_most_tiles_are_below(device, monkeypatch):
    """Of columns far from most rows; those tiles are left out here."""
    points = np.sort(np.random.default_rng(0).random((1500, 1)), axis=0)
    masses = np.full(1500, 1 / 1500)

    def result():
        backend = operations(device)
        cloud = backend.upload(points, masses)
        return backend.softmin(cloud, cloud, np.zeros(1500), 0.01)

    wanted = result()
    with_source(monkeypatch, lambda text: text.replace(BELOW, ""))
    assert np.mean(result() > wanted + 1e-6) > 0.4


def test_sums_below_the_maximum_are_verified(device, monkeypatch):
    """Before the first use of the program."""
    with_source(monkeypatch, lambda text: text.replace(BELOW, "few = NAN;"))
    reason = first_failure(operations(device), Variant("log_sum_exp.cl", 5))
    assert "softmin" in reason
