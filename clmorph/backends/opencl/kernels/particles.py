"""Particles on the device."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

#: Launches of more work-items than this take a multiple of it.
WHOLE_GROUPS = 64


@dataclass(frozen=True)
class ParticleSet:
    """Particles that move, on the device; weights are divided by `unit`."""

    count: int
    unit: float
    table: cl.Buffer  # (points, 6) float32
    links: cl.Buffer  # (count, 2) uint32
    weights: cl.Buffer  # (count, 2) float32


@dataclass(frozen=True)
class Splats:
    """Particles at rest, on the device; weights are divided by `unit`."""

    count: int
    unit: float
    positions: cl.Buffer  # (count, 2) float32, pixels
    samples: cl.Buffer  # (count, 4) float32: weight, color
    spacings: cl.Buffer  # (count,) float32, pixels
    width_levels: cl.Buffer | None = None  # (count,) uint8, if widths differ


class SortedSplats(NamedTuple):
    """Splats by width level and bin, see `records.Bins`; `order` is on the device."""

    shape: tuple[int, int]
    side: float  # of a bin, in pixels
    margin: int  # bins around the canvas; particles farther out fall into these
    starts: NDArray[np.int64]  # (levels, bins + 1); one level if all have the same width
    order: cl.Buffer
    positions: cl.Buffer
    samples: cl.Buffer


def whole_groups(items: int) -> int:
    """Return how many items to launch together: drivers make groups of 1 for prime numbers."""
    return items // WHOLE_GROUPS * WHOLE_GROUPS or items
