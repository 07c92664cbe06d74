"""Pictures sampled where a motion says: devices against NumPy, and NumPy against SciPy."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates, spline_filter

from clmorph.backends.numpy import NumPyOperations
from clmorph.backends.records import Motion
from clmorph.backends.verification.splines import motions, sample_tolerance

REFERENCE = NumPyOperations()
SHAPES = [(1, 1), (1, 9), (6, 1), (2, 3), (45, 70), (300, 33)]


@pytest.mark.small
@pytest.mark.parametrize("shape", SHAPES)
def test_devices_sample_as_numpy_does(each_device, rng, shape):
    coefficients = rng.normal(size=(*shape, 3)).astype(np.float32)
    splines = [backend.upload_spline(coefficients) for backend in (each_device, REFERENCE)]
    for name, motion in motions(shape).items():
        got, want = (
            backend.sample_spline(spline, motion, 1, motion.shape[0])
            for backend, spline in zip((each_device, REFERENCE), splines, strict=True)
        )
        assert got.shape == want.shape == (motion.shape[0] - 1, motion.shape[1], 3)
        assert got.dtype == np.float32
        assert np.abs(got - want).max() <= sample_tolerance(coefficients, motion), name


def test_numpy_samples_where_the_motion_says(rng):
    """By the definition, at the points of the grid of displacements."""
    picture = rng.random((20, 30))
    coefficients = spline_filter(picture, order=3, mode="mirror")
    spline = np.repeat(coefficients[..., None], 3, axis=2).astype(np.float32)
    moved = rng.normal(0, 2, (7, 11, 2))
    motion = Motion((7, 11), (1.5, -2.0), (2.0, 3.0), moved)
    got = REFERENCE.sample_spline(spline, motion, 2, 7)
    rows, columns = np.mgrid[2:7, :11]
    places = 1.5 + 2.0 * rows + moved[2:, :, 0], -2.0 + 3.0 * columns + moved[2:, :, 1]
    want = map_coordinates(picture, places, order=3, mode="mirror")
    assert np.abs(got - want[..., None]).max() < 1e-5


def test_launches_are_cut_without_changing_a_bit(each_device, rng):
    coefficients = rng.normal(size=(40, 50, 3)).astype(np.float32)
    motion = motions((40, 50))["near"]
    spline = each_device.upload_spline(coefficients)
    whole = each_device.sample_spline(spline, motion, 0, motion.shape[0])
    rows = [each_device.sample_spline(spline, motion, row, row + 1) for row in range(45)]
    assert np.array_equal(whole, np.concatenate(rows))
