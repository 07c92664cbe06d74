"""Measures of films, on films whose values are known."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from clmorph import InputError
from clmorph.analysis.metrics import (
    crossfade_share,
    crumbs,
    film_measures,
    flicker,
    ghost,
    low_band_distance,
    relative_crumbs,
    relative_sharpness,
    unevenness,
)

TIMES = (0.25, 0.5, 0.75)


def texture(seed, shape=(128, 128)):
    """A random texture of details of a few pixels, with colors."""
    noise = np.random.default_rng(seed).normal(size=(*shape, 3))
    smooth = gaussian_filter(noise, (2.5, 2.5, 0))
    return np.clip(0.5 + 0.2 * smooth / smooth.std(), 0, 1)


def crossfade(a, b, count):
    return [(1 - t) * a + t * b for t in np.linspace(0, 1, count)]


def wipe(a, b, count):
    """The border between both pictures goes from left to right; nothing moves."""
    there = np.arange(a.shape[1])[None, :, None] / a.shape[1]
    return [np.where(there < t, b, a) for t in np.linspace(0, 1, count)]


@pytest.fixture(scope="module")
def pictures():
    return texture(1), texture(2)


def test_a_crossfade_shows_both_pictures_everywhere(pictures):
    film = crossfade(*pictures, 9)
    found = film_measures(film, film)
    assert found.ghost == pytest.approx(1)
    assert found.ghost_absolute == pytest.approx(found.ghost_of_crossfade)
    assert ghost(film[4], *pictures) > 0.15 > found.ghost_absolute > 0.1
    assert found.crossfade_share == pytest.approx(1)
    assert found.unevenness == pytest.approx(1)
    assert found.low_band_distance == (0, 0, 0)
    assert found.flicker is None
    # Unlike textures that are added are as soft as the root of the sum of their squares says.
    assert found.relative_sharpness == pytest.approx(np.hypot(TIMES, TIMES[::-1]), rel=0.08)


def test_a_wipe_shows_one_picture_at_each_place(pictures):
    film = wipe(*pictures, 9)
    found = film_measures(film, crossfade(*pictures, 9), times=[0.25, 0.5])
    assert abs(found.ghost) < 0.1
    assert found.crossfade_share == pytest.approx(0.5, abs=0.1)
    assert found.relative_sharpness == pytest.approx([1, 1], abs=0.05)
    assert min(found.low_band_distance) > 3
    assert ghost(film[4], *pictures) == pytest.approx(0, abs=0.02)


def test_a_moved_picture_is_no_ghost(pictures):
    a, b = pictures
    moved = np.roll(a, (5, -7), (0, 1))
    assert ghost(moved, a, b) == pytest.approx(0, abs=0.02)
    assert crossfade_share(moved, a, b) < 0.1


@pytest.mark.full
def test_each_function_says_what_film_measures_says(pictures):
    a, b = pictures
    film = [*wipe(a, b, 25)[:-1], b]
    below = crossfade(a, b, 25)
    times = (0.25, 0.5)
    found = film_measures(film, below, times)
    middle = [film[round(24 * t)] for t in times]
    assert found.ghost_absolute == pytest.approx(np.mean([ghost(each, a, b) for each in middle]))
    assert found.ghost == pytest.approx(found.ghost_absolute / found.ghost_of_crossfade)
    assert found.crossfade_share == pytest.approx(crossfade_share(middle[1], a, b))
    for number, (frame, t) in enumerate(zip(middle, times, strict=True)):
        assert found.relative_sharpness[number] == pytest.approx(relative_sharpness(frame, a, b, t))
        assert found.relative_crumbs[number] == pytest.approx(relative_crumbs(frame, a, b, t))
        distance = low_band_distance(frame, below[round(24 * t)])
        assert found.low_band_distance[number] == pytest.approx(distance)
    assert found.unevenness == pytest.approx(unevenness(film[::3]))
    assert found.flicker == pytest.approx(flicker(film))


def test_the_values_do_not_change():
    """Those of the script in which the measures were defined, at first."""
    a, b = texture(3, (90, 120)), texture(4, (90, 120))
    frame = 0.4 * a + 0.4 * b + 0.2 * np.random.default_rng(5).random((90, 120, 1))
    b = b[:, :-20]
    assert ghost(frame, a, b) == pytest.approx(0.06100035, abs=1e-6)
    assert crossfade_share(frame, a, b) == pytest.approx(0.34138618, abs=1e-6)
    assert relative_sharpness(frame, a, b, 0.25) == pytest.approx(1.42658278, abs=1e-6)
    assert relative_crumbs(frame, a, b, 0.25) == pytest.approx(63.63932292, abs=0.2)
    assert low_band_distance(frame, b) == pytest.approx(15.48121818, abs=1e-6)
    assert unevenness([a, frame, b]) == pytest.approx(1.17164849, abs=1e-6)
    assert flicker([a, frame, b]) == pytest.approx(1.29634185, abs=1e-6)


def test_equal_frames(pictures):
    film = [pictures[0]] * 9
    assert unevenness(film) == flicker(film) == 0
    found = film_measures(film)
    assert found.ghost_absolute == found.ghost_of_crossfade == found.ghost == 0
    assert found.crossfade_share == pytest.approx(1)
    assert found.relative_sharpness == pytest.approx([1, 1, 1], abs=0.05)
    assert found.low_band_distance is None


def test_flat_frames_have_no_ghost():
    found = film_measures([np.full((40, 30, 3), level) for level in (0.0, 0.5, 1.0)])
    assert found.ghost == found.ghost_of_crossfade == 0
    assert found.relative_sharpness == found.relative_crumbs == (0, 0, 0)
    assert found.unevenness == pytest.approx(1)


def test_a_hard_cut_is_as_uneven_as_there_are_steps(pictures):
    a, b = pictures
    assert unevenness([a] * 5 + [b] * 4) == pytest.approx(8)
    assert unevenness([a, b, b]) == pytest.approx(2)


def test_frames_that_jump_back_and_forth_flicker(pictures):
    a, b = pictures
    there = [(1 - t) * a + t * b for t in (0, 0.3, 0.1, 0.4, 0.2)]
    assert flicker(there) == pytest.approx(1.0 / 0.2)
    assert flicker(crossfade(a, b, 25)) == pytest.approx(1)
    assert film_measures([PICTURE] * 26, times=[0.5]).flicker is None


def test_softer_and_torn_frames(pictures):
    a, b = pictures
    soft = gaussian_filter(a, (2, 2, 0))
    assert relative_sharpness(soft, a, b, 0) < 0.7
    torn = a.copy()
    torn[::4, ::4] = 1 - torn[::4, ::4]
    assert relative_crumbs(soft, a, b, 0) <= 1 < 3 < relative_crumbs(torn, a, b, 0)
    # Of gray pictures of 128 pixels they are the specks of all frames.
    gray = np.repeat(torn[..., :1], 3, axis=2)
    assert relative_crumbs(gray, gray, b, 0) == pytest.approx(1 / (1 + 1e-3 / crumbs(gray)))


@pytest.mark.full
def test_opacity_is_over_gray(pictures):
    a, b = pictures
    alpha = np.clip(texture(7)[..., :1] * 2 - 0.5, 0, 1)
    clear = [np.dstack((each, alpha)) for each in crossfade(a, b, 5)]
    opaque = [each * alpha + 0.5 * (1 - alpha) for each in crossfade(a, b, 5)]
    found, wanted = (film_measures(each, each, [0.5]) for each in (clear, opaque))
    for value, other in zip(found, wanted, strict=True):
        assert value == pytest.approx(other)
    nothing = np.dstack((a, np.zeros_like(alpha)))
    assert low_band_distance(nothing, np.full((9, 9, 3), 0.5)) == pytest.approx(0, abs=1e-9)


@pytest.mark.full
def test_sizes_and_kinds_of_numbers_may_differ(pictures):
    """A picture with every pixel doubled is the same picture, nearly; bytes are parts of 255."""
    a, b = pictures
    big = np.kron(b, np.ones((2, 2, 1)))
    middle = crossfade(a, b, 3)[1]
    film = [a, middle, big]
    assert film_measures(film, times=[0.5]).ghost == pytest.approx(1, abs=0.15)
    assert crossfade_share(middle, a, big) == pytest.approx(1, abs=0.02)
    assert unevenness(film) == pytest.approx(1, abs=0.02)
    rounded = np.rint(255 * middle).astype(np.uint8)
    assert low_band_distance(middle, rounded) < 0.1
    for shape in ((1, 1), (3, 200), (300, 40)):
        picture = texture(8, shape)
        assert ghost(picture, picture, b) == pytest.approx(0, abs=0.2)
        assert low_band_distance(picture, a) > 0


PICTURE = np.full((8, 8, 3), 0.5)
HOLE = np.where(np.arange(8)[:, None, None] == 3, np.nan, PICTURE)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: film_measures([PICTURE] * 2), "frames hold 2 pictures"),
        (lambda: film_measures([PICTURE, HOLE, PICTURE]), r"frames\[1\] holds NaN"),
        (lambda: film_measures(PICTURE), r"frames\[0\] has shape \(8, 3\)"),
        (lambda: film_measures(None), "frames=None"),
        (lambda: film_measures([PICTURE] * 3, [PICTURE]), "particles hold 1 pictures"),
        (lambda: film_measures([PICTURE] * 3, times=[0.5, 1.5]), r"times=1.5: .*\[0, 1\]"),
        (lambda: film_measures([PICTURE] * 3, times=[]), "times have shape"),
        (lambda: ghost(HOLE, PICTURE, PICTURE), "frame holds NaN"),
        (lambda: ghost(PICTURE, PICTURE[..., 0], PICTURE), r"image_a has shape \(8, 8\)"),
        (lambda: crossfade_share(PICTURE, PICTURE, HOLE), "image_b holds NaN"),
        (lambda: crossfade_share(np.zeros((8, 8, 2)), PICTURE, PICTURE), "frame has shape"),
        (lambda: relative_sharpness(PICTURE, PICTURE, PICTURE, 2.0), "t=2"),
        (lambda: relative_sharpness(3 * PICTURE, PICTURE, PICTURE, 0.5), "frame holds values"),
        (lambda: relative_crumbs(PICTURE, PICTURE, PICTURE, np.nan), "t=nan"),
        (lambda: relative_crumbs(np.zeros((0, 8, 3)), PICTURE, PICTURE, 0.5), "frame has shape"),
        (lambda: low_band_distance(PICTURE, HOLE), "particles holds NaN"),
        (lambda: low_band_distance("a.png", PICTURE), "frame"),
        (lambda: unevenness([PICTURE] * 2), "frames hold 2 pictures"),
        (lambda: unevenness([PICTURE, PICTURE, HOLE]), r"frames\[2\] holds NaN"),
        (lambda: flicker([PICTURE] * 4), "frames hold 4 pictures: expected an odd number"),
        (lambda: flicker([PICTURE]), "at least 3"),
    ],
)
def test_wrong_use(call, words):
    with pytest.raises(InputError, match=words):
        call()
