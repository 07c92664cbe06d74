"""The per-channel baseline is exact where it must be, and has the errors the paper describes."""

import numpy as np
import pytest

from clmorph import InputError
from clmorph.analysis.channel_baseline import channel_morph


def test_equal_images_stay(device):
    y, x = np.mgrid[:9, :12] / 12
    image = np.stack([0.5 + 0.3 * np.sin(4 * x + k * y) for k in (1, 2, 3)], -1)
    for reach in (None, 0.3):
        result = channel_morph(
            image, image, n_frames=3, blur=0.02, reach=reach, sigma_start=0.3, sigma_end=0.3,
            gamma=0, backend=device,
        )  # fmt: skip
        for frame in result.frames:
            assert frame.shape == (9, 12, 3)
            assert np.abs(frame - image).max() < 0.05


def test_ends_have_the_images_light(device, rng):
    images = rng.random((9, 12, 3)), 0.5 * rng.random((14, 7, 3))
    result = channel_morph(*images, n_frames=2, backend=device)
    for frame, image in zip(result.frames, images, strict=True):
        assert frame.shape == image.shape
        assert np.allclose(frame.mean(axis=(0, 1)), image.mean(axis=(0, 1)), rtol=0.05)


def test_a_red_object_turns_blue_through_purple(device):
    """Paper, 1: in between there is a color that neither image has."""
    source, target = np.zeros((16, 16, 3)), np.zeros((16, 16, 3))
    source[4:12, 4:12, 0] = 1
    target[4:12, 4:12, 2] = 1
    result = channel_morph(source, target, n_frames=3, backend=device)
    middle = result.frame(0.5)[6:10, 6:10]
    assert middle[..., 0].min() > 0.2
    assert middle[..., 2].min() > 0.2


def test_black_channels_and_wrong_options(device):
    black = np.zeros((6, 6, 3))
    result = channel_morph(black, black + 0.5, n_frames=3, backend=device)
    assert np.all(np.isfinite(result.frames))
    for options in ({"n_frames": 1}, {"blur": 0}, {"extent": "x"}, {"gamma": -1}, {"max_iter": 0}):
        with pytest.raises(InputError):
            channel_morph(black, black, backend=device, **options)
