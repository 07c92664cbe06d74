"""Noise near black is not amplified, and maps of other pictures hardly change."""

import numpy as np
import pytest
from skimage import data

import clmorph
from clmorph.pipeline import recolor as module

PHOTOGRAPHS = "astronaut", "coffee", "rocket", "chelsea"


def photograph(name, step=6):
    return getattr(data, name)()[::step, ::step, :3] / 255


def noisy(picture, level=1.5):
    noise = np.random.default_rng(0).normal(0, level / 255, picture.shape)
    return np.rint(255 * np.clip(picture + noise, 0, 1)) / 255


def steps(values):
    """How much neighbors differ: the deviation of their differences, which a gradient does not
    change."""
    return np.diff(values, axis=1).std()


@pytest.mark.parametrize("level", [0.0, 4 / 255, 8 / 255])
@pytest.mark.parametrize("other", ["coffee", "astronaut"])
def test_noise_near_black_is_not_amplified(device, level, other):
    picture = photograph("chelsea")
    picture[:25] = level
    picture = noisy(picture)
    found = clmorph.recolor(picture, photograph(other), backend=device)
    assert np.abs(found - picture)[30:].mean() > 0.05
    assert steps(found[:25]) <= 1.02 * steps(picture[:25])


def test_a_mask_that_is_soft_is_limited_too():
    picture = photograph("chelsea")
    picture[:25] = 0.0
    picture = noisy(picture)
    mask = np.full(picture.shape[:2], 0.5)
    mask[:, 40:] = 1.0
    found = clmorph.recolor(picture, photograph("coffee"), mask=mask, backend="numpy")
    assert steps(found[:25, :40]) <= 1.02 * steps(picture[:25, :40])
    assert steps(found[:25, 40:]) <= 1.02 * steps(picture[:25, 40:])


@pytest.mark.parametrize(
    "pair",
    [(0, 1), *(pytest.param(it, marks=pytest.mark.full) for it in ((1, 2), (2, 3), (3, 0)))],
)
def test_maps_of_photographs_hardly_change(monkeypatch, pair):
    a, b = (photograph(PHOTOGRAPHS[k]) for k in pair)
    limited = clmorph.recolor(a, b, backend="numpy")
    monkeypatch.setattr(module, "SLOPE_BETWEEN", 1e6)
    monkeypatch.setattr(module, "DARK", 1e-9)
    free = clmorph.recolor(a, b, backend="numpy")
    # The astronaut has a sixth of its pixels near black.
    assert 255 * np.abs(limited - free).mean() < (1.0 if pair == (0, 1) else 0.1)
    bright = a.max(axis=2) > 0.4
    np.testing.assert_array_equal(limited[bright], free[bright])


def test_the_limit_is_continuous():
    """From near black on no step between neighboring levels is steeper than 4 times a level."""
    picture = photograph("chelsea")
    picture[:25] = 0.0
    ramp = np.full((40, *picture.shape[1:]), np.arange(40)[:, None, None] / 255)
    both = np.vstack((noisy(picture), ramp))
    look = clmorph.recolor(both, photograph("coffee"), backend="numpy")[-40:, 0]
    assert 255 * np.abs(np.diff(look, axis=0)).max() < 4.01
