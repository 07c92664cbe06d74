"""How much memory a morph will take, and how it is made within some memory."""

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

#: Draws from a row below which its mean destination serves better.
FEWEST_DRAWS = 4


@dataclass(frozen=True)
class MemoryModel:
    """Constants of the estimate, as measured; in bytes unless another unit is named.

    Attributes
    ----------
    base : int
        On the host, whatever the size.
    solver_point : int
        On the host for a point, while potentials are sought.
    morph_point, morph_pair : int
        On the host for a point and for a pair, while a morph is made and drawn.
    alpha_pair : int
        On the host for a pair of images with opacity, whose particles are stored twice.
    barycentric_point : int
        On the host for a source point whose mean destination is computed.
    tile, level_pairs : int
        Points of a tile, and pairs of tiles whose levels (three times 8 bytes) are computed at a
        time.
    coordinate, point, particle : int
        On the device for a coordinate of a point, for a point besides, and for a particle.
    held_particle, held_pixel, most_held : int
        Released buffers that a device keeps for the next: for a particle, for a pixel, at most.
    block, blocks : int
        Entries of a block of the NumPy backend, 8 bytes each, and blocks that it holds at a time.
    numpy_particle : int
        What the NumPy backend takes to move a particle.
    """

    base: int = 500_000
    solver_point: int = 380
    morph_point: int = 300
    morph_pair: int = 92
    alpha_pair: int = 120
    barycentric_point: int = 400
    tile: int = 32
    level_pairs: int = 1 << 22
    coordinate: int = 8
    point: int = 16
    particle: int = 95
    held_particle: int = 40
    held_pixel: int = 5000
    most_held: int = 1 << 28
    block: int = 1 << 24
    blocks: int = 4
    numpy_particle: int = 280


MODEL = MemoryModel()


class Memory(NamedTuple):
    """Memory that a morph takes at its peak, estimated.

    Attributes
    ----------
    host : int
        Bytes of arrays, without Python and its libraries (about 150 MB).
    device : int
        Bytes of buffers.
    shared : bool
        Whether the device's memory is the host's, as it is with CPUs.
    """

    host: int
    device: int
    shared: bool

    @property
    def ram(self) -> int:
        """Bytes of the host's memory, the device's included if that is the same."""
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
) -> Memory:
    """Estimate the memory that a morph takes, without doing any of it.

    A model of what is held at the peak, O(points + kept pairs), with constants measured on CPU
    runtimes for images from 64 x 64 on; within a factor of two there. Frames are drawn one by
    one: those that are kept come on top. So do, while potentials are sought at blurs of a few
    pixels, the pairs that the solver stores (`_solver.coarse_grid`): up to 128 for each point,
    or 2^24 of few points, 18 bytes each, but never more than a quarter of the device's memory.

    Parameters
    ----------
    source_shape, target_shape : (height, width)
    pairs : float, optional
        Kept pairs of the plan, counted or predicted (`clmorph.pipeline.pair_count`). None: the
        transport alone, as if nothing came after the potentials.
    sample : int, optional
        Draws a pixel in place of kept pairs, see `clmorph.sample_plan`; `pairs` may then be None.
    barycentric : bool
        One particle for each source pixel in their place.
    alpha : bool
        Whether one of the images is not opaque.
    dimension : int
        Of the lifted points: 5, or 11 with a color metric for each source pixel.
    backend : str or Operations
        See `clmorph.get_backend`.

    Returns
    -------
    Memory

    Raises
    ------
    InputError
        If an argument cannot be used.
    DeviceError
        If there is no such device.
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
    levels = min(MODEL.level_pairs, (-(-n // MODEL.tile)) * (-(-m // MODEL.tile)))
    host = MODEL.base + MODEL.solver_point * (n + m) + 24 * levels
    on_device = (MODEL.coordinate * dimension + MODEL.point) * (n + m)
    pixels = max(source_shape[0], target_shape[0]) * max(source_shape[1], target_shape[1])
    if drawn is not None:
        # Unmatched mass rests at points of its own.
        particles = drawn + n + m
        morph = MODEL.base + MODEL.morph_point * (n + m) + MODEL.morph_pair * drawn + 24 * levels
        morph += MODEL.alpha_pair * drawn if alpha else 0
        morph += MODEL.barycentric_point * n if barycentric else 0
        host = max(host, int(morph))
        held = MODEL.held_particle * particles + MODEL.held_pixel * pixels
        # A second set of particles stays, the rest is used again.
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
    """Choose how a morph is made within some memory.

    Parameters
    ----------
    max_memory : float
        For host and device together where they share memory, else for each of them.
    source_shape, target_shape, pairs, alpha, dimension, backend
        As in `estimate`.

    Returns
    -------
    dict
        Options of `clmorph.morph`: none, if the kept pairs fit; ``{"sample": k}`` with as many
        draws as fit, a power of two; ``{"barycentric": True}`` rather than 2 or 1.

    Raises
    ------
    InputError
        If not even that fits.
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
    # Fewer draws are grainier than means are smooth, but take less.
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
    """Return how many pairs are drawn between so many pixels."""
    by_row, by_column = n_draws(sample)
    return by_row * n + by_column * m


def _points(name: str, shape: tuple[int, int]) -> int:
    """Return the number of pixels of an image of this shape."""
    if len(shape) != 2:
        raise InputError(f"{name}_shape={shape!r}: expected (height, width)")
    height, width = (check_integer(f"{name}_shape", side, 1, 1 << 24) for side in shape)
    return height * width
