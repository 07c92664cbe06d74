"""Estimate the memory of a morph, and the number of particles that fits into a limit.

The estimate is linear in pixels, blocks and particles. Its constants are fitted to the peak memory
of processes on CPUs: sprites and photographs of 48 to 3000 pixels, Intel's runtime, PoCL and NumPy.
"""

from collections.abc import Sequence
from math import ceil
from pathlib import Path
from typing import NamedTuple

from clmorph.backends.interface import Operations
from clmorph.measures.pixel_blocks import block_side
from clmorph.pipeline.maps import NO_MAPS, Maps
from clmorph.pipeline.options import MorphOptions
from clmorph.pipeline.prepare import lifted_shapes
from clmorph.transport.plan_sampling import n_draws
from clmorph.transport.regularization import regularization

#: Bytes on the host: for each lifted pixel, for each block or pixel between which transport is
#: solved, for each particle that travels, and for each particle of a picture with opacity besides.
PIXEL, BLOCK, PARTICLE, ALPHA = 250, 500, 70, 60
#: Bytes on the host for each pixel of pictures of which smaller copies are lifted.
CARRIED = 85
#: Bytes on the device: for each block and coordinate, for each block besides, for each particle.
COORDINATE, POINT, DRAWN = 8, 500, 75
#: Buffers that drawing particles holds on the device: bytes for each pixel of a frame, and at most.
HELD, MOST_HELD = 5000, 1 << 28
#: Entries of 8 bytes in the NumPy backend's matrices of a block of rows; it holds two.
MATRIX = 1 << 24
#: Bytes of a driver's threads and compiled kernels, which come with the first use of a device.
FIRST_USE = 40_000_000
#: Share of all pairs that a plan keeps, in units of blur^2: the disk of three blurs.
KEPT = 28.0
#: Share of a morph's memory that the process still holds while the next morph of a chain is made.
LEFT = 0.6


class Memory(NamedTuple):
    """The estimated memory of a morph, in bytes."""

    #: Arrays on the host.
    host: int
    #: Buffers on the device.
    device: int
    #: Whether the device uses the host's memory, as CPUs do.
    shared: bool
    #: What the process has in use before the morph, and the most that it had.
    before: int = 0
    peak: int = 0

    @property
    def needs(self) -> tuple[int, ...]:
        """Bytes that the morph takes of the host's memory, and of a device's own."""
        return (self.host + self.device,) if self.shared else (self.host, self.device)

    @property
    def ram(self) -> int:
        """The most bytes of the host's memory that the process takes."""
        return max(self.peak, self.before + self.needs[0])


def process_memory(operations: Operations) -> tuple[int, int]:
    """Return bytes of this process, with a device's first use and at most until now; else zeros."""
    try:
        text = Path("/proc/self/status").read_text("utf-8", "replace")
        found = dict(line.split(":", 1) for line in text.splitlines())
        now, most = (1024 * int(found[name].split()[0]) for name in ("VmRSS", "VmHWM"))
    except (OSError, KeyError):  # not Linux
        return 0, 0
    return now + (0 if operations.memory_bytes is None else FIRST_USE), most


def estimate(
    pixels: int,
    blocks: tuple[int, int],
    particles: float,
    operations: Operations,
    *,
    alpha: bool = False,
    dimension: int = 5,
    frame: int = 0,
    carried: int = 0,
) -> Memory:
    """Estimate the memory of a morph with this number of lifted pixels of both pictures."""
    points = sum(blocks)
    host = PIXEL * pixels + BLOCK * points + CARRIED * carried
    host += int((PARTICLE + (ALPHA if alpha else 0)) * particles)
    if operations.memory_bytes is None:
        host += int(DRAWN * particles) + 16 * min(MATRIX, blocks[0] * blocks[1])
        return Memory(host, 0, True)
    device = (COORDINATE * dimension + POINT) * points + int(DRAWN * (particles + pixels))
    return Memory(host, device + min(HELD * frame, MOST_HELD), operations.shares_host_memory)


def most_particles(limit: float, none: Memory, alpha: bool) -> float:
    """Return the particles with which a morph takes `limit` bytes; `none` is it without any."""
    on_host = PARTICLE + (ALPHA if alpha else 0)
    each = (on_host + DRAWN,) if none.shared else (on_host, DRAWN)
    return min((limit - need) / size for need, size in zip(none.needs, each, strict=True))


def expected(
    shapes: Sequence[tuple[int, int, int]],
    options: MorphOptions,
    operations: Operations,
    maps: Maps = NO_MAPS,
    *,
    process: tuple[int, int],
    particles: float | None = None,
    chained: bool = False,
) -> Memory:
    """Estimate the memory of a morph of fitted pictures (H, W, C), one of several if `chained`."""
    lifted = lifted_shapes(shapes, options, maps)
    carried = sum(height * width for height, width, _ in shapes) if lifted != list(shapes) else 0
    sides = [block_side(shape[:2], options.solve_size) for shape in lifted]
    pixels = [height * width for height, width, _ in lifted]
    first, second = (
        ceil(shape[0] / side) * ceil(shape[1] / side)
        for shape, side in zip(lifted, sides, strict=True)
    )
    if particles is None:
        particles = _predicted(options, pixels, first * second * max(sides) ** 2)
    before, peak = process
    need = estimate(
        sum(pixels), (first, second), particles, operations,
        alpha=any(shape[2] == 4 for shape in shapes),
        frame=max(pixels) if options.detail == "particles" else 0, carried=carried,
    )  # fmt: skip
    before += int(LEFT * need.needs[0]) if chained else 0
    return need._replace(before=before, peak=peak)


def _predicted(options: MorphOptions, pixels: Sequence[int], pairs: int) -> float:
    """Predict the number of particles that travel, of all pairs of pixels of near blocks."""
    if options.barycentric:
        return pixels[0]
    if options.sample is not None:
        by_row, by_column = n_draws(options.sample)
        return by_row * pixels[0] + by_column * pixels[1]
    blur = regularization(options.blur, options.reach, options.epsilon, options.rho).blur
    kept = min(1.0, KEPT * blur**2) * pairs
    if options.max_particles is None or kept <= options.max_particles:
        return kept
    return max(options.max_particles, sum(pixels))
