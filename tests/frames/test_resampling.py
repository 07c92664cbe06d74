"""Images on coarser and finer grids over the same extent."""

import numpy as np
import pytest

from clmorph._shared.enlarging import enlarged
from clmorph.frames.canvas import canvas_at
from clmorph.frames.resampling import reduced

SHAPES = [
    ((7, 5), (20, 31)),
    ((1, 4), (9, 4)),
    ((3, 1), (3, 8)),
    ((1, 1), (5, 2)),
    ((6, 6), (6, 6)),
]


@pytest.mark.parametrize(("few", "many"), SHAPES)
def test_ramps_stay_ramps_between_the_centers(few, many):
    """What lies at a position of the common frame stays there."""
    fine = canvas_at(0.0, many, many)
    y, x = (np.arange(many[axis]) for axis in (0, 1))
    ramp = (2.0 * y[:, None] + 3.0 * x)[..., None]
    small = reduced(ramp, few)
    assert small.shape == (*few, 1)
    assert small.mean() == pytest.approx(ramp.mean())
    large = enlarged(small, many)
    inner = np.ones(many, bool)
    for axis, (n, m) in enumerate(zip(few, many, strict=True)):
        edge = (m / n - 1) / 2  # beyond the outermost centers it is constant
        index = np.arange(m).reshape((-1, 1) if axis == 0 else (1, -1))
        inner &= (index >= edge - 1e-9) & (index <= m - 1 - edge + 1e-9)
    # Pixels that a border divides count in both means with their own value.
    whole = all(m % n == 0 for n, m in zip(few, many, strict=True))
    np.testing.assert_allclose(large[inner], ramp[inner], atol=1e-9 if whole else 0.1)
    assert large.shape == (*fine.shape, 1)


@pytest.mark.parametrize(("few", "many"), SHAPES)
def test_rows_are_rows_of_the_whole(rng, few, many):
    image = rng.random((*few, 2)).astype(np.float32)
    whole = enlarged(image, many)
    assert whole.dtype == np.float32
    for first in range(many[0]):
        part = enlarged(image, many, first, first + 2)
        np.testing.assert_array_equal(part[:1], whole[first : first + 1])
    assert image.min() - 1e-6 <= whole.min() <= whole.max() <= image.max() + 1e-6


def test_the_same_grid_keeps_the_bits(rng):
    image = rng.random((5, 8, 3))
    np.testing.assert_array_equal(enlarged(image, (5, 8)), image)
    np.testing.assert_array_equal(reduced(image, (5, 8)), image)
