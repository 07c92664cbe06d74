"""Unmatched mass that grows out of, and shrinks into, what travels beside it."""

import numpy as np
import pytest

import clmorph
from clmorph import InputError
from clmorph.frames.growth import grown_ends

FAR = {"blur": 0.05, "reach": 0.08, "n_frames": 3, "detail": "particles", "preset": "photo"}


@pytest.fixture(scope="module")
def pair():
    """A spot that stays, and beside it a wide bar that only the second image has."""
    rng = np.random.default_rng(3)
    first = np.full((24, 24, 3), 0.5) + 0.02 * rng.random((24, 24, 3))
    second = first.copy()
    second[8:16, 10:24] = (0.9, 0.1, 0.1)
    return first, second


def test_mass_is_as_with_fading(device, pair):
    grown, faded = (
        clmorph.morph(*pair, backend=device, unmatched=way, color_weight=2.0, **FAR)
        for way in ("grow", "fade")
    )
    for t in (0.0, 0.3, 1.0):
        assert grown.particles.mass(t) == pytest.approx(faded.particles.mass(t))
    assert len(grown.particles) == len(faded.particles)
    assert np.abs(grown.frame(0.0) - pair[0]).max() < 1e-5
    assert np.abs(grown.frame(1.0) - pair[1]).max() < 1e-5
    assert np.abs(grown.frame(0.5) - faded.frame(0.5)).max() > 0.05


def test_births_start_where_their_nearest_traveling_neighbor_comes_from(device, pair):
    morph = clmorph.morph(*pair, backend=device, unmatched="grow", color_weight=2.0, **FAR)
    source, target, plan = morph.source, morph.target, morph.plan
    starts = grown_ends(source, target, plan)[1]
    received = plan.marginals[1] / target.weights
    travels = np.flatnonzero(received >= 0.5 * min(1.0, received.max()))
    back = plan.mean_destinations(source.positions, target.positions)[1]
    born = np.flatnonzero(received < 0.3 * received.max())
    assert len(born) > 20
    for pixel in born[::7]:
        away = np.linalg.norm(target.positions[travels] - target.positions[pixel], axis=1)
        nearest = travels[away <= away.min() + 1e-9]
        assert np.abs(back[nearest] - starts[pixel]).max(axis=1).min() < 1e-12
    moving = morph.particles
    n = len(source)
    grown = moving.links[:, 0] >= n + len(target)
    assert grown.any()
    assert not moving.weights[grown, 0].any()
    first, last = moving.links[grown].T
    assert np.allclose(moving.table[first, :2], starts[last - n])
    # They keep their own color all the way.
    assert np.allclose(moving.table[first, 2:5], moving.table[last, 2:5])


def test_opacity(device):
    """What grows has its pixel's opacity; sums of areas are those of fading."""
    y, x = np.mgrid[:20, :20]
    first = np.dstack((np.full((20, 20, 3), 0.4), np.hypot(x - 5, y - 5) < 4))
    second = np.dstack((np.full((20, 20, 3), 0.4), 0.5 * (np.hypot(x - 6, y - 6) < 9)))
    morph = clmorph.morph(first, second, backend=device, unmatched="grow", **FAR)
    for t, image in ((0.0, first), (1.0, second)):
        assert np.abs(morph.frame(t)[..., 3] - image[..., 3]).max() < 1e-5
    assert 0 <= morph.frame(0.5).min() <= morph.frame(0.5).max() <= 1


@pytest.mark.parametrize("given", [{"barycentric": True}, {"sample": 2}, {"detail": "layers"}])
def test_all_ways(device, pair, given):
    morph = clmorph.morph(*pair, backend=device, unmatched="grow", **(FAR | given))
    for t in (0.0, 0.5, 1.0):
        assert np.all(np.isfinite(morph.frame(t)))


def test_nothing_travels(device):
    black, white = np.zeros((2, 9, 9, 3))
    white += 1.0
    options = {"unmatched": "grow", "reach": 1e-3, "preset": "photo", "n_frames": 3}
    morph = clmorph.morph(black, white, backend=device, **options)
    assert np.all(np.isfinite(morph.frame(0.5)))


def test_the_reference_refuses(pair):
    with pytest.raises(InputError, match="'fade' and 'drop'"):
        clmorph.reference.morph(*(image[:6, :6] for image in pair), unmatched="grow")
