"""Test the timing of frames: easing, holds, loops, durations."""

from fractions import Fraction
from typing import get_args

import numpy as np
import plain
import pytest

from clmorph import InputError
from clmorph.output.options import Ease, PlaybackOptions
from clmorph.output.playback import Motion, eased, held_frames, motion_of, whole_units


@pytest.mark.parametrize("ease", get_args(Ease))
def test_easing_is_monotone_and_keeps_both_ends(ease):
    times = eased(np.linspace(0, 1, 11), ease)
    assert times[0] == 0
    assert times[-1] == 1
    assert np.all(np.diff(times) > 0)
    if ease in ("linear", "smooth"):  # the same from both sides
        assert np.allclose(times + times[::-1], 1)
    first, last = times[1] - times[0], times[-1] - times[-2]
    slow = {"linear": (False, False), "smooth": (True, True)}
    slow |= {"in": (True, False), "out": (False, True)}
    assert (first < 0.09, last < 0.09) == slow[ease]


def test_a_morph_takes_it(rng):
    a, b = rng.random((2, 6, 6, 3))
    result = plain.morph(a, b, 5, ease="in")
    assert np.allclose(result.times, [0, 1 / 16, 4 / 16, 9 / 16, 1])
    assert np.array_equal(result.frames[2], result.frame(0.25))
    with pytest.raises(InputError, match="ease='bounce'"):
        plain.morph(a, b, ease="bounce")


def test_rests_of_a_chain():
    assert held_frames(2, 4).tolist() == [True, False, False, True]
    assert np.flatnonzero(held_frames(4, 5)).tolist() == [0, 4, 8, 12]
    assert len(held_frames(4, 5)) == 13


def test_rounds():
    holds = held_frames(2, 4)
    forth = Motion(10, 1.0, "loop").played(holds)
    assert forth == [(0, 1.1), (1, 0.1), (2, 0.1), (3, 1.1)]
    back = Motion(10, 1.0, "ping-pong").played(holds)
    assert [index for index, _ in back] == [0, 1, 2, 3, 2, 1]
    assert sum(seconds for _, seconds in back) == pytest.approx(2.6)
    assert [index for index, _ in Motion(loop="ping-pong").played(held_frames(2, 2))] == [0, 1]


@pytest.mark.parametrize("loop", ["loop", "ping-pong", "once"])
@pytest.mark.parametrize("n_images", [2, 3])
def test_durations_that_were_asked_for(loop, n_images):
    holds = held_frames(n_images, 10)
    motion = motion_of(PlaybackOptions(duration=7.5, hold=0.5, loop=loop), holds)
    assert sum(seconds for _, seconds in motion.played(holds)) == pytest.approx(7.5)


def test_impossible_durations():
    holds = held_frames(2, 10)
    for duration, words in (
        (1.0, "no longer than the holds"),
        (1.3001, "frames a second"),
        (1e5, "frames a second"),
        (-1, "duration=-1"),
    ):
        with pytest.raises(InputError, match=words):
            motion_of(PlaybackOptions(duration=duration, hold=0.65), holds)


def test_rounding_does_not_add_up():
    """At 30 frames a second a GIF's hundredths must not drift."""
    units = whole_units([1 / 30] * 300, 100)
    assert set(units) == {3, 4}
    assert sum(units) == 1000
    assert whole_units([1e-6] * 3, 100) == [1, 1, 1]
    assert whole_units([0.1] * 4, Fraction(25, 2)) == [1, 2, 1, 1]
    # After a rest of half a unit more every sum ends in one half, or a rounding beside it.
    assert whole_units([0.25, *[0.1] * 20], 30)[1:] == [3] * 20
    assert whole_units([0.75, *[0.1] * 20], 30)[1:] == [3] * 20


def test_rates_at_which_rests_are_frames():
    for fps, hold, rate in (
        (20, 0.65, 20), (30, 0.1, 30), (1, 0.0, 1), (1, 2.0, 1), (1, 0.4, 30), (12, 0.65, 36),
        (0.1, 0.5, 30), (29, 0.3, 58), (240, 0.001, 240), (12.5, 0.4, 12.5), (12.5, 0.3, 37.5),
    ):  # fmt: skip
        motion = Motion(fps, hold)
        lengths = [seconds for _, seconds in motion.played(held_frames(2, 4))]
        assert motion.rate_for(lengths) == rate, (fps, hold)
