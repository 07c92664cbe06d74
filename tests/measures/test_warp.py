"""The warp through landmarks: it takes all sets that are right, and names those that are not."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

import clmorph
from clmorph import InputError
from clmorph.measures.landmarks import guided
from clmorph.measures.warp import warp

SIDE = 64
FLAT = clmorph.lift(np.ones((SIDE, SIDE)))


def plausible(rng):
    """Return 1 to 30 landmarks that a smooth field without folds moves by up to 25 % of a side."""
    while True:
        width = rng.uniform(0.06, 0.25) * SIDE
        noise = rng.standard_normal((2, SIDE, SIDE))
        field = gaussian_filter(noise, (0, width, width), mode="nearest")
        field *= rng.uniform(0.02, 0.25) / np.abs(field).max()
        down, right = np.gradient(field, 1 / (SIDE - 1), axis=(1, 2))
        if np.min((1 + right[0]) * (1 + down[1]) - right[1] * down[0]) > 0.02:
            break
    count = int(rng.integers(1, 31))
    starts, ends = [], []
    while len(starts) < count:
        place = rng.random(2)
        at = [[place[1] * (SIDE - 1)], [place[0] * (SIDE - 1)]]
        end = place + [map_coordinates(each, at, order=1)[0] for each in field]
        if np.all((end >= 0) & (end <= 1)):
            starts.append(place)
            ends.append(end)
    return np.array(starts), np.array(ends)


@pytest.mark.full
def test_all_of_200_plausible_sets_are_taken(rng):
    """None is refused, none folds, and none is missed."""
    for _ in range(200):
        found = warp(*plausible(rng), FLAT, FLAT)
        assert found.areas.min() > 0.0
        assert found.misses.max() < 1e-9


def test_landmarks_of_whole_pixels_are_missed_by_less_than_one(rng):
    """Rounding can bring two landmarks to one place."""
    for _ in range(50):
        starts, ends = (np.round(places * 39) / 39 for places in plausible(rng))
        found = warp(starts, ends, FLAT, FLAT)
        assert found.areas.min() > 0.0
        assert found.misses.max() < 1 / 39


def test_two_that_are_exchanged_are_named(rng):
    """While the others stay where they are."""
    tried = 0
    while tried < 100:
        starts, _ = plausible(rng)
        if len(starts) < 3:
            continue
        first, second = sorted(rng.choice(len(starts), 2, replace=False))
        if np.hypot(*(starts[first] - starts[second])) < 0.05:
            continue
        ends = starts.copy()
        ends[[first, second]] = ends[[second, first]]
        with pytest.raises(InputError, match=f"landmarks {first + 1} and {second + 1} contradict"):
            warp(starts, ends, FLAT, FLAT)
        tried += 1


def test_one_and_two_landmarks_are_a_shift_and_a_similarity():
    shifted = warp(np.array([[0.5, 0.5]]), np.array([[0.7, 0.4]]), FLAT, FLAT)
    assert np.allclose(shifted.positions - FLAT.positions, [0.2, -0.1])
    starts, ends = np.array([[0.4, 0.5], [0.6, 0.5]]), np.array([[0.5, 0.3], [0.5, 0.6]])
    turned = warp(starts, ends, FLAT, FLAT)
    assert np.allclose(turned.areas, 1.0)
    # Three halves as large, and turned by a quarter about the middle of the landmarks.
    offset = FLAT.positions - (0.5, 0.5)
    wanted = (0.5, 0.45) + 1.5 * np.stack((-offset[:, 1], offset[:, 0]), axis=1)
    assert np.allclose(turned.positions, wanted)


def test_a_picture_that_is_turned_as_a_whole(rng):
    """Upside down, every pair is reversed, but none contradicts another one."""
    starts = rng.uniform(0.1, 0.9, (12, 2))
    found = warp(starts, 1.0 - starts, FLAT, FLAT)
    assert np.abs(found.positions - (1.0 - FLAT.positions)).max() < 1e-6
    assert found.misses.max() < 1e-9


def test_a_woman_and_a_cat():
    """Eyes and nose of two close-ups, which no warp from border to border joins without folds."""
    pairs = [((112, 95), (165, 148)), ((152, 92), (317, 170)), ((136, 112), (262, 275))]
    woman, cat = clmorph.lift(np.ones((260, 260))), clmorph.lift(np.ones((300, 451)))
    source, _, missed = guided(woman, cat, pairs)
    assert missed.max() < 1e-6
    for (x, y), partner in pairs:
        there = source.warped[y * 260 + x] - cat.positions.min(axis=0)
        assert there * 450 == pytest.approx(partner, abs=0.2)  # a spline between 128 positions


def test_points_at_one_place_are_missed_and_reported():
    """Between two goals that are near each other, the warp goes to their middle."""
    pairs = [((20, 20), (22, 20)), ((20, 20), (23, 20)), ((40, 40), (40, 40))]
    missed = guided(FLAT, FLAT, pairs).misses
    assert missed[:2] == pytest.approx([0.5, 0.5], abs=0.1)
    assert missed[2] < 0.1


def test_landmarks_on_one_line(rng):
    """A line determines no affine map; the border helps, or the similarity."""
    x = np.sort(rng.uniform(0.1, 0.9, 7))
    starts = np.stack((x, np.full(7, 0.5)), axis=1)
    ends = np.stack((x**1.5, np.full(7, 0.4)), axis=1)
    found = warp(starts, ends, FLAT, FLAT)
    assert found.misses.max() < 1e-9
    assert found.areas.min() > 0.0
