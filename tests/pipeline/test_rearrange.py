"""Rearranging the pixels of one image to form another."""

import numpy as np
import pytest

from clmorph.errors import InputError
from clmorph.pipeline.rearrange import rearrange


def _images() -> tuple[np.ndarray, np.ndarray]:
    y, x = np.mgrid[0:12, 0:14] / 14
    return np.stack([x, y, x * y], axis=2), np.stack([1 - x, y * y, y], axis=2)


def test_last_frame_has_the_very_pixels_of_a(device):
    a, b = _images()
    found = rearrange(a, b, n_frames=4, backend=device)
    assert len(found) == 4
    np.testing.assert_array_equal(found.frame(0.0), a)
    last = found.frame(1.0).reshape(-1, 3)
    np.testing.assert_array_equal(last[found.assignment], a.reshape(-1, 3))
    assert sorted(found.assignment) == list(range(len(last)))
    assert 0 < found.lower_bound <= found.cost <= 1.02 * found.lower_bound


def test_same_image_stays():
    a, _ = _images()
    found = rearrange(a, a, backend="numpy")
    assert found.cost == 0.0
    np.testing.assert_array_equal(found.frame(0.5), a)


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (7, 3)])
def test_b_takes_the_size_of_a(shape):
    found = rearrange(
        np.linspace(0, 1, shape[0] * shape[1]).reshape(shape), _images()[1], backend="numpy"
    )
    assert found.frame(0.3).shape == (*shape, 3)
    assert np.isfinite(found.frame(0.3)).all()


@pytest.mark.parametrize(
    "wrong", [{"n_frames": 1}, {"seconds": np.nan}, {"seed": -1}, {"a": np.full((2, 2, 4), 0.5)}]
)
def test_mistakes_are_named(wrong):
    a, b = _images()
    with pytest.raises(InputError):
        rearrange(**{"a": a, "b": b, "backend": "numpy"} | wrong)
