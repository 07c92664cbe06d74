"""Estimate the memory of a morph, and choose the form of a morph that fits into a limit."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.validation import check_integer, check_number
from clmorph.backends.select import Backend, get_backend
from clmorph.errors import InputError
from clmorph.transport.options import MAX_DRAWS
from clmorph.transport.plan_sampling import n_draws

Array = NDArray[np.float64]

#: Number of draws from a row below which the mean destination gives a better result.
FEWEST_DRAWS = 4


@dataclass(frozen=True)
class MemoryModel:
    """Measured constants of the estimate, in bytes unless another unit is named."""

    #: Host memory that does not depend on the size.
    base: int = 500_000
    #: Host memory for each point while potentials are computed.
    solver_point: int = 380
    #: Host memory for each point, and for each pair, while a morph is made and drawn.
    morph_point: int = 300
    morph_pair: int = 92
    #: Host memory for each pair of images with opacity, whose particles are stored twice.
    alpha_pair: int = 120
    #: Host memory for each source point whose mean destination is computed.
    barycentric_point: int = 400
    #: Number of points of a tile, and number of pairs of tiles whose levels (three times 8 bytes)
    #: are computed at a time.
    tile: int = 32
    level_pairs: int = 1 << 22
    #: Device memory for each coordinate of a point, each point in addition, and each particle.
    coordinate: int = 8
    point: int = 16
    particle: int = 95
    #: Released buffers that a device keeps for reuse: bytes for each particle, bytes for each
    #: pixel, and the largest total.
    held_particle: int = 40
    held_pixel: int = 5000
    most_held: int = 1 << 28
    #: Number of entries of a block of the NumPy backend, 8 bytes each, and number of blocks that it
    #: holds at a time.
    block: int = 1 << 24
    blocks: int = 4
    #: Memory of the NumPy backend for each particle that it moves.
    numpy_particle: int = 280
    #: Host memory for each pixel of pictures that are larger than what is lifted.
    carried_pixel: int = 150


MODEL = MemoryModel()


class Memory(NamedTuple):
    """The estimated peak memory of a morph, in bytes."""

    #: Arrays on the host, without Python and its libraries (about 150 MB).
    host: int
    #: Buffers on the device.
    device: int
    #: Whether the device uses the host's memory, as CPUs do.
    shared: bool

    @property
    def ram(self) -> int:
        """Bytes of the host's memory, including the device's buffers if memory is shared."""
        return self.host + self.device if self.shared else self.host


def estimate(
    source_shape: tuple[int, int],
    target_shape: tuple[int, int],
    pairs: float | None = None,
    *,
    sample: int | None = None,
    barycentric: bool = False,
    alpha: bool = False,
    dimension: int = 5,
    backend: Backend = "auto",
    carried_pixels: int = 0,
) -> Memory:
    """Estimate the memory that a morph takes, without computing the morph.

    The estimate is a model of the peak memory, O(points + kept pairs). Its constants were measured
    on CPU runtimes for images of at least 64 x 64 pixels, where it is right within a factor of two.
    Frames are drawn one by one; the estimate does not include frames that are kept. It also does
    not include the pairs that the solver stores (`_solver.coarse_grid`) while potentials are
    computed at blurs of a few pixels: up to 160 for each point, or 320 but at most 2^27 in all, or
    2^24 of few points, 18 bytes each, but never more than a quarter of the device's memory; with
    them the device holds 540 bytes for each point of a side. Nor does it include the solver's lists
    of near pairs. These take 12 bytes for each pair of tiles on the host and, on a CPU, 32 bytes on
    the device, which is 0.7 GB for each side at 1024 x 1024 pixels and a blur of 0.05.

    Shapes are (height, width). `pairs` are the kept pairs of the plan, counted or predicted
    (`clmorph.pipeline.pair_count`); None estimates the computation of the potentials alone.
    `sample` draws for each pixel, or one particle for each source pixel (`barycentric`), replace
    them. `dimension` is that of the lifted points: 5, or 11 with a color metric for each source
    pixel. `carried_pixels` counts those of both pictures if frames carry the detail of pictures
    with more pixels than are lifted (`clmorph.pipeline.prepare.small_copies`).
    """
    n, m = (_points(name, s) for name, s in (("source", source_shape), ("target", target_shape)))
    operations = get_backend(backend)
    drawn: float | None
    if barycentric:
        drawn = n
    elif sample is not None:
        drawn = _n_drawn(check_integer("sample", sample, 1, MAX_DRAWS), n, m)
    else:
        drawn = None if pairs is None else check_number("pairs", pairs, 0.0, 1e18)
    carried = MODEL.carried_pixel * check_integer("carried_pixels", carried_pixels, 0, 1 << 40)
    levels = min(MODEL.level_pairs, (-(-n // MODEL.tile)) * (-(-m // MODEL.tile)))
    host = MODEL.base + MODEL.solver_point * (n + m) + 24 * levels
    on_device = (MODEL.coordinate * dimension + MODEL.point) * (n + m)
    pixels = max(source_shape[0], target_shape[0]) * max(source_shape[1], target_shape[1])
    if drawn is not None:
        # Unmatched mass has n + m further particles, which do not move.
        particles = drawn + n + m
        morph = MODEL.base + MODEL.morph_point * (n + m) + MODEL.morph_pair * drawn + 24 * levels
        morph += MODEL.alpha_pair * drawn if alpha else 0
        morph += MODEL.barycentric_point * n if barycentric else 0
        host = max(host, int(morph) + carried)
        held = MODEL.held_particle * particles + MODEL.held_pixel * pixels
        # A second set of particles stays in memory; the other buffers are reused.
        on_device += int(
            MODEL.particle * particles * (1.2 if alpha else 1.0) + min(held, MODEL.most_held)
        )
    if operations.memory_bytes is not None:
        return Memory(host, on_device, operations.shares_host_memory)
    host += MODEL.blocks * 8 * min(MODEL.block, n * m)
    return Memory(
        int(host + (MODEL.numpy_particle * particles if drawn is not None else 0)), 0, True
    )


def affordable(
    max_memory: float,
    source_shape: tuple[int, int],
    target_shape: tuple[int, int],
    pairs: float,
    *,
    alpha: bool = False,
    dimension: int = 5,
    backend: Backend = "auto",
) -> dict[str, Any]:
    """Choose the form of a morph that fits into a limit of memory, in bytes, if there is one.

    The limit holds for host and device together if they share memory, else for each of them. The
    form is given by options of `clmorph.morph`: ``{}`` if the kept pairs fit; else ``{"sample":
    k}`` with the largest power of two that fits; ``{"barycentric": True}`` is preferred to k = 2 or
    1.
    """
    limit = check_number("max_memory", max_memory, 1.0, 1e18)
    operations = get_backend(backend)

    def need(**way: Any) -> int:
        memory = estimate(
            source_shape, target_shape, alpha=alpha, dimension=dimension, backend=operations, **way
        )
        return max(memory.ram, memory.device)

    if need(pairs=pairs) <= limit:
        return {}
    n, m = _points("source", source_shape), _points("target", target_shape)
    draws = [k for k in 2 ** np.arange(13) if _n_drawn(int(k), n, m) < pairs]
    ways: list[dict[str, Any]] = [{"sample": int(k)} for k in draws[::-1]]
    # Fewer draws look worse, by their grain, than means, by their smoothness, but take less memory.
    ways.insert(sum(int(k) >= FEWEST_DRAWS for k in draws), {"barycentric": True})
    for way in ways:
        if need(**way) <= limit:
            return way
    least = min(need(**way) for way in ways)
    raise InputError(
        f"max_memory={limit / 1e9:.3g} GB: expected at least {least / 1e9:.2g} GB for images of "
        "these sizes; raise it, or use smaller images"
    )


def _n_drawn(sample: int, n: int, m: int) -> int:
    """Return the number of drawn pairs between n source pixels and m target pixels."""
    by_row, by_column = n_draws(sample)
    return by_row * n + by_column * m


def _points(name: str, shape: tuple[int, int]) -> int:
    """Return the number of pixels of an image with this shape."""
    if len(shape) != 2:
        raise InputError(f"{name}_shape={shape!r}: expected (height, width)")
    height, width = (check_integer(f"{name}_shape", side, 1, 1 << 24) for side in shape)
    return height * width
