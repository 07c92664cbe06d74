"""The timing of frames: easing, holds at the pictures, loops."""

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from clmorph._shared.typing import Array, BoolArray
from clmorph.errors import InputError
from clmorph.output.options import FPS, Ease, Loop, PlaybackOptions

#: The frame rate from which nobody sees that a hold is rounded to whole frames.
SMOOTH = 30


def eased(times: Array, ease: Ease) -> Array:
    """Return the times of the morph that frames at even times show; 0 and 1 are unchanged."""
    PlaybackOptions.checked("ease", ease)
    if ease == "smooth":
        return times**2 * (3.0 - 2.0 * times)
    if ease == "in":
        return times**2
    return times * (2.0 - times) if ease == "out" else times


@dataclass(frozen=True)
class Motion:
    """The timing of a recording: frame rate, holds and loop."""

    #: Frames per second.
    fps: float = FPS
    #: Seconds by which the pictures themselves are shown longer than other frames: the first, the
    #: last, and those between in a chain.
    hold: float = PlaybackOptions.hold
    loop: Loop = PlaybackOptions.loop

    def __post_init__(self) -> None:
        for name in ("fps", "hold", "loop"):
            object.__setattr__(self, name, PlaybackOptions.checked(name, getattr(self, name)))

    @property
    def rate(self) -> Fraction:
        """Frames per second as a fraction, as files store them."""
        return Fraction(self.fps).limit_denominator(1001)

    def rate_for(self, seconds: list[float]) -> Fraction:
        """Return `rate`, or a multiple at which no duration (s) is off by over half a frame."""
        frames = np.array(seconds) * float(self.rate)
        if np.all(np.abs(frames - np.round(frames)) < 0.01):
            return self.rate
        return self.rate * max(1, math.ceil(SMOOTH / self.rate))

    def played(self, holds: BoolArray) -> list[tuple[int, float]]:
        """Return the frames of one round and their seconds; `holds` (n,) marks the pictures."""
        even, order = 1.0 / self.fps, list(range(len(holds)))
        order += order[-2:0:-1] if self.loop == "ping-pong" else []
        return [(index, even + self.hold * holds[index]) for index in order]


def motion_of(options: PlaybackOptions, holds: BoolArray) -> Motion:
    """Return the motion that options ask for; `holds` (n,) marks the frames that are pictures."""
    duration, hold, loop = options.duration, options.hold, options.loop
    if duration is None:
        return Motion(FPS if options.fps is None else options.fps, hold, loop)
    trial = Motion(1.0, hold, loop).played(holds)
    held = sum(seconds - 1.0 for _, seconds in trial)
    if duration <= held:
        raise InputError(
            f"duration={duration:g} is no longer than the holds at the pictures, "
            f"{held:g} s: raise it, or lower hold"
        )
    fps = len(trial) / (duration - held)
    if not 0.1 <= fps <= 240.0:
        raise InputError(
            f"duration={duration:g} means {fps:.3g} frames a second: expected 0.1 to 240; "
            "change it, or the number of frames"
        )
    return Motion(fps, hold, loop)


def whole_units(seconds: list[float], per_second: int | Fraction) -> list[int]:
    """Round durations (s) to a file's unit, at least 1 each, so that their sums stay true."""
    # Halves, which are frequent with holds, are all rounded up, whatever the rounding errors of the
    # sums, so that equal durations side by side stay equal.
    ends = np.floor(np.cumsum(seconds) * float(per_second) + (0.5 + 1e-6)).astype(int)
    return [max(1, int(units)) for units in np.diff(ends, prepend=0)]


def held_frames(n_images: int, n_frames: int) -> BoolArray:
    """Return which frames of a chain, neighbors sharing one, are pictures: (n,) array of bool."""
    holds = np.zeros((n_images - 1) * (n_frames - 1) + 1, bool)
    holds[:: n_frames - 1] = True
    return holds
