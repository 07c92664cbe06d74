"""Kernel widths that come from the images or from the particles."""

import numpy as np
import pytest
import skimage.data
from plain import morph
from skimage.transform import resize

from clmorph import InputError, fit
from clmorph.analysis.metrics import hole_fraction, path_divergence
from clmorph.images.detail import auto_sigma, intrinsic_spacing
from clmorph.images.pixels import as_rgb
from clmorph.pipeline.morph import WIDTHS


def test_a_sprites_width_is_half_its_block(rng):
    sprite = rng.random((16, 12, 3))
    for zoom in (2, 5, 10):
        large = np.kron(sprite, np.ones((zoom, zoom, 1)))
        assert intrinsic_spacing(large) == zoom
        noisy = np.clip(large + 0.01 * rng.normal(size=large.shape), 0, 1)  # as a JPEG's
        assert intrinsic_spacing(noisy) == zoom
        assert auto_sigma(large) == zoom / 2


@pytest.mark.full
def test_a_photographs_width_follows_its_resolution():
    photo = as_rgb(skimage.data.astronaut())[:256, 128:384]
    assert 1 <= intrinsic_spacing(photo) < 2
    for zoom in (2, 4):
        enlarged = np.clip(resize(photo, (256 * zoom, 256 * zoom, 3), order=3), 0, 1)
        wanted = zoom * intrinsic_spacing(photo)
        assert intrinsic_spacing(enlarged) == pytest.approx(wanted, rel=0.35)


def test_images_without_detail():
    for image in (np.zeros((9, 9, 3)), np.zeros((1, 1, 3)), np.ones((300, 2, 3))):
        assert intrinsic_spacing(image) == 1
    for gray in (3 / 255, 0.3, 0.7):
        assert intrinsic_spacing(np.full((64, 64, 3), gray)) == 1
    halves = np.zeros((64, 64, 3))
    halves[:, 32:] = 1
    assert intrinsic_spacing(halves) < 4


@pytest.fixture(scope="module")
def pair():
    return [
        fit(as_rgb(picture), 24)
        for picture in (skimage.data.coffee()[:, 100:500], skimage.data.chelsea()[:, 75:375])
    ]


@pytest.mark.full
def test_optimal_widths_are_nearest_to_the_particles(device, pair):
    pair = [fit(picture, 10) for picture in pair]
    result = morph(*pair, n_frames=3, sigma="optimal", endpoints="paper", backend=device)
    _, widths = result.kernel_width.curve
    assert np.all((widths >= 0.5 * WIDTHS[0]) & (widths <= 2 * WIDTHS[-1]))
    assert result.kernel_width.at(0.5, result.canvas(0.5)) == widths[3]
    best = path_divergence(result, [0.5], "particles", max_points=4096)[0]
    for sigma in (0.8 * widths[3], 1.3 * widths[3], 1.2):
        other = morph(
            *pair, n_frames=3, splatting="fixed", sigma_start=sigma, endpoints="paper",
            backend=device,
        )  # fmt: skip
        there = path_divergence(other, [0.5], "particles", max_points=4096)[0]
        assert float(best) <= float(there) * 1.01


def test_local_widths_close_holes_without_blur(device, pair):
    """Of a few scattered particles, torn places are filled, and crowded ones stay as sharp."""
    few = {"n_frames": 2, "sample": 1, "unmatched": "drop", "endpoints": "paper", "blur": 0.05,
           "color_weight": 2.0}  # fmt: skip
    pair = [pair[0], np.kron(pair[1], np.ones((2, 2, 1)))]
    none = morph(*pair, splatting="none", backend=device, **few)
    local = morph(*pair, splatting="local", sigma_start=0.5, sigma_end=0.5, backend=device, **few)
    fixed = morph(*pair, splatting="fixed", sigma_start=0.35, backend=device, **few)
    assert hole_fraction(none.coverage(0.6)) > 0.3
    assert hole_fraction(fixed.coverage(0.6)) > 0.03
    assert hole_fraction(local.coverage(0.6)) == 0
    lowest = min(image.min() for image in pair)
    assert local.frame(0.6).min() >= lowest - 1e-3
    assert none.frame(0.6).min() == 0


def test_widths_follow_each_images_spacing(device):
    """A coarse image fades in a finer one without showing its grid."""
    coarse, fine = np.full((8, 8, 3), 0.8), np.full((64, 64, 3), 0.2)
    options = {"n_frames": 2, "reach": 0.01, "endpoints": "paper", "backend": device}
    spread = []
    for widths in ({"splatting": "local", "sigma_end": 0.5}, {"splatting": "fixed"}):
        frame = morph(coarse, fine, sigma_start=0.5, **widths, **options).frame(0.8)
        spread.append(np.ptp(frame[8:-8, 8:-8]))
    assert spread[0] < 0.3 * spread[1]


def test_wrong_combinations(pair):
    for options in (
        {"sigma": "best"}, {"sigma": 1.0}, {"sigma": "optimal", "splatting": "none"},
        {"sigma": "optimal", "reach": (0.3, None)}, {"sigma_start": "automatic"},
    ):  # fmt: skip
        with pytest.raises(InputError):
            morph(*pair, n_frames=2, backend="numpy", **options)
